"""Gains and their proofs, in NumPy, SciPy and cvxpy: no jax here."""
