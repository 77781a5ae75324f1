"""Recorded data: measurements, inputs and truth as tables, from whatever they were recorded in, a part at a time. No jax."""
