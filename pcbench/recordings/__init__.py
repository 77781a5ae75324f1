"""Recorded data of several formats: measurements, inputs and truth as tables, read in parts. No jax."""
