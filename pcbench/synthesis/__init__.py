"""Gains by design, with their certificates: LMIs, Riccati equations, pole placement. NumPy, SciPy and cvxpy, no jax.

One file per method: `current_gains` chooses how the gain of `pccebo` is found, and `current_lmi` finds it by LMI. What a
designer knows of a grid point, and what a certificate says, are in `certificate`. The gain of `kf` and its relatives is not
designed beforehand: it is computed at every sample (`observers/parts/linear_filter.py`, `update`).
"""
