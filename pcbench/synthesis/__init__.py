"""Gains by design, with their certificates: LMIs, Riccati equations, pole placement. NumPy, SciPy and cvxpy, no jax.

One file per method. `current_gains` selects the design method of `pccebo`, and `current_lmi` is its LMI. `certificate`
contains the inputs of a design and the record of a certificate. The gain of `kf` and its variants is not designed beforehand;
it is computed at every sample (`observers/parts/linear_filter.py`, `update`).
"""
