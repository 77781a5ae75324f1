"""Shared parts of control laws: their design context, common options and set points."""
