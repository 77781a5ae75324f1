"""Observers that live elsewhere: what every run measures as files, and estimates that others made of it as one more observer."""
