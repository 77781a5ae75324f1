"""Gains by bandwidth: all poles of the error at exp(-omega T), except those of modes that decay faster without correction.

    (I - L C) Phi from one sample to the next has the required poles: L = Phi^-1 K, Phi - K C by Ackermann's formula
    K = p(Phi) [C; C Phi; ..; C Phi^(k-1)]^-1 [0; ..; 0; 1],  p(z) = (z - p_1) .. (z - p_k)        (one output)

or by `scipy.signal.place_poles` for several outputs. A mode that decays within a sample is not observable in the samples, and
only a very large gain could move its pole. So modes faster than a limit keep their poles. V is a basis of the invariant
subspace of the slow modes, with W' V = I and W' Phi = Phi_s W'. The gain is L = V l, with l for (Phi_s, C V).

Source: Gao, Scaling and bandwidth-parameterization based controller tuning, ACC 2003 (all poles at -omega); the exemption of
fast modes is this project's.
"""

import warnings
from typing import NamedTuple

import numpy as np
from scipy.linalg import schur

from pcbench.dynamics.linear import Matrix, Model
from pcbench.errors import DesignError, UserError, first_sentence

ZERO = 1e-9  # relative to the largest entry; smaller entries count as zero


class SlowModes(NamedTuple):
    """The k slow modes of a map Phi [n, n]: s = W' x, s+ = Phi s, with the output C s."""

    Phi: Matrix  # [k, k]
    C: Matrix  # [q, k]
    V: Matrix  # [n, k]
    W: Matrix  # [k, n]


def slow_modes(Phi: Matrix, C: Matrix, fastest: float) -> SlowModes:
    """Return the modes of Phi whose absolute value is at least `fastest`."""
    if fastest == 0:
        return SlowModes(Phi, C, np.eye(len(Phi)), np.eye(len(Phi)))
    M = Phi / (fastest * (1 - ZERO))  # its slow modes are those outside the unit circle
    _, Z, k = schur(M, sort="ouc")
    _, Z_left, _ = schur(M.T, sort="ouc")
    V = Z[:, :k]
    W = np.asarray(np.linalg.solve(Z_left[:, :k].T @ V, Z_left[:, :k].T), float)
    return SlowModes(W @ Phi @ V, C @ V, V, W)


def predictor_gain(Phi: Matrix, C: Matrix, poles: Matrix, where: str) -> Matrix:
    """Return K [n, q] with the real poles [n] of Phi - K C; raise DesignError if they cannot be placed."""
    n = len(Phi)
    if n == 0:
        return np.zeros((0, len(C)))
    try:
        if len(C) > 1:
            from scipy.signal import place_poles  # takes a second to import

            with warnings.catch_warnings():
                warnings.simplefilter("ignore", UserWarning)  # slow convergence; the certificate checks the result
                return np.asarray(place_poles(Phi.T, C.T, poles).gain_matrix.T, float)
        p, observability = np.eye(n), [C]
        for pole in poles:
            p = p @ (Phi - pole * np.eye(n))
        for _ in range(n - 1):
            observability.append(observability[-1] @ Phi)
        return np.asarray(p @ np.linalg.solve(np.vstack(observability), np.eye(n)[:, -1:]))
    except (ValueError, np.linalg.LinAlgError) as error:
        raise DesignError(
            f"{where}: the poles were not placed ('{first_sentence(error)}'), expected outputs that show every slow mode; "
            "change the bandwidth or measure another output."
        ) from error


def current_gain(Phi: Matrix, C: Matrix, pole: float, fastest: float, where: str) -> Matrix:
    """Return L [n, q] with the slow poles of (I - L C) Phi at `pole`; the poles of several outputs are up to 20 % smaller."""
    slow = slow_modes(Phi, C, fastest)
    k = len(slow.Phi)
    poles = pole * (1 - 0.2 * np.arange(k) / max(k, 1) * (len(C) > 1))
    return slow.V @ np.linalg.solve(slow.Phi, predictor_gain(slow.Phi, slow.C, poles, where))


class Chain(NamedTuple):
    """A plant as a chain of n integrators: xi = O x, xi_i' = xi_(i+1), xi_n' = row x + b (u + d), y = xi_1."""

    O: Matrix  # [n, n]
    row: Matrix  # [1, n] C A^n
    b: float  # C A^(n-1) G
    G: Matrix  # [n, 1] direction of the disturbance d: E, or B without an unknown input


def chain_of(model: Model, where: str, n_states: int | None = None) -> Chain:
    """Return a model as a chain of integrators.

    Raises UserError if the model is discrete, has several outputs or disturbances, feedthrough, a number of states other than
    `n_states`, or a relative degree from the disturbance to the output below n.
    """
    G = model.B if model.E is None else model.E
    n = len(model.A)
    rows = [model.C]
    for _ in range(n):
        rows.append(rows[-1] @ model.A)
    known_part = "a known function of the state among its unknown inputs" if model.nonlinearity is not None else ""
    problem = (
        ("a discrete plant" if model.discrete else "")
        or (f"{len(model.C)} outputs" if len(model.C) != 1 else "")
        or (f"{G.shape[1]} disturbed inputs" if G.shape[1] != 1 else "")
        or ("feedthrough" if model.feedthrough.any() else "")
        or (f"{n} states" if n_states is not None and n != n_states else "")
        or known_part
    )
    if not problem:
        size = [float((abs(row) @ abs(G)).item()) for row in rows[:n]]
        effect = [float((row @ G).item()) for row in rows[:n]]
        is_active = [abs(e) > ZERO * max(s, 1e-300) for e, s in zip(effect, size, strict=True)]
        degree = is_active.index(True) + 1 if any(is_active) else None
        if degree == n:
            return Chain(np.vstack(rows[:n]), rows[n], effect[-1], G)
        problem = f"a disturbance of relative degree {degree} with {n} states"
    states = f"{n_states}" if n_states is not None else "n"
    raise UserError(
        f"{where}: got {problem}, expected a chain of {states} integrators: x' = A x + B u, one output without feedthrough, "
        f"and one input or unknown input that acts on its derivative of order {states} first; use kf."
    )
