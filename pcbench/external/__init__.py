"""Observers that live elsewhere: what runs measure as files, and estimates that others made of it as one more observer."""
