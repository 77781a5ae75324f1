"""What control laws share: what they are told of a cell, their common options, their set points."""
