"""Exact discretisation of a linear model with a held input, and of its process noise.

Doublings: entry b is for 2^b ticks. The noise over 2^b ticks follows by Q_2b = E_b Q_b E_b' + Q_b from one short tick. One
matrix exponential over a long interval would overflow silently (Van Loan's at 0.6 s on the cart).
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

from pcbench.value_cache import cached_by_value

Matrix = NDArray[np.float64]


class Model(NamedTuple):
    """A linear model with a held input: x' = A x + B u, y = C x + D u; if `discrete`, x one tick later is A x + B u.

    A plant with an unknown input, x' = A x + B u + E f, has E. If a part of f is a known function of the state, f = known(x)
    + input.
    """

    A: Matrix  # [n, n] 1/s (discrete: per tick)
    B: Matrix  # [n, m]
    C: Matrix  # [q, n]
    D: Matrix | None = None  # [q, m]; None: zero
    discrete: bool = False
    E: Matrix | None = None  # [n, r]; None: no unknown input
    # x [n] -> [r], a jax.tree_util.Partial with its arrays; None: no known part
    nonlinearity: Callable[[Any], Any] | None = None

    @property
    def feedthrough(self) -> Matrix:
        """D as a matrix [q, m]."""
        return np.zeros((len(self.C), self.B.shape[1])) if self.D is None else self.D


def discretize_zoh(A: Matrix, B: Matrix, h: float) -> tuple[Matrix, Matrix]:
    """Discretize x' = A x + B u exactly, for an input held over h seconds (zero-order hold).

    Results are cached in memory.

    Args:
        A: [n, n], may be singular.
        B: [n, m].
        h: time step [s].

    Returns:
        Phi = e^(A h) [n, n], and Gamma [n, m], the integral of e^(A s) over s = 0 .. h, times B.
    """
    n, m = B.shape
    block = np.zeros((n + m, n + m))
    block[:n, :n], block[:n, n:] = A, B
    exponential = _exponential(block, h)
    return exponential[:n, :n], exponential[:n, n:]


@cached_by_value
def _exponential(A: Matrix, h: float) -> Matrix:
    """Return e^{A h}."""
    out: Matrix = expm(A * h)
    out.flags.writeable = False
    return out


def spectral_radius(M: Matrix) -> float:
    """Return the largest absolute value of an eigenvalue of M [n, n], or of several matrices [..., n, n]."""
    return float(np.abs(np.linalg.eigvals(M)).max())


def one_tick(model: Model, h: float) -> tuple[Matrix, Matrix]:
    """Return Phi and Gamma of one tick of h seconds, exactly: x(t + h) = Phi x(t) + Gamma u."""
    return (model.A, model.B) if model.discrete else discretize_zoh(model.A, model.B, h)


def bits_for(ticks: int) -> int:
    """Return the number of doublings for all ages up to `ticks`."""
    return max(int(ticks).bit_length(), 1)


def doublings(model: Model, h: float, bits: int) -> Matrix:
    """Return the model's map over 2^b ticks without input, b = 0 .. bits - 1, as [bits, n, n]; cached."""
    return _doublings(model.A, model.discrete, h, bits)


@cached_by_value
def _doublings(M: Matrix, discrete: bool, h: float, bits: int) -> Matrix:
    if discrete:
        maps = [M]
        for _ in range(bits - 1):
            maps.append(maps[-1] @ maps[-1])
        out = np.stack(maps)
    else:
        out = np.stack([expm(M * (h * 2**b)) for b in range(bits)])
    out.flags.writeable = False
    return out


def noise_over_tick(A: Matrix, Qc: Matrix, h: float) -> Matrix:
    """Return int_0^h e^{As} Qc e^{A's} ds for one tick, by Van Loan's exponential; Qc is an intensity, per second.

    If a fast mode decays within the tick, e^{-Ah} would overflow. So the tick is halved until |A| h is at most 1, and the
    result is doubled again.
    Source: Van Loan, Computing integrals involving the matrix exponential, IEEE TAC 23 (1978).
    """
    return _noise_over_tick(A, Qc, h).copy()


@cached_by_value
def _noise_over_tick(A: Matrix, Qc: Matrix, h: float) -> Matrix:
    n = len(A)
    size = float(np.linalg.norm(A, 2)) * h
    halvings = int(np.ceil(np.log2(size))) if size > 1 else 0
    short = h / 2**halvings
    E_block = _exponential(np.block([[-A, Qc], [np.zeros((n, n)), A.T]]), short)
    E = E_block[n:, n:].T
    Q = E @ E_block[:n, n:]
    for _ in range(halvings):
        Q, E = E @ Q @ E.T + Q, E @ E
    out: Matrix = (Q + Q.T) / 2
    out.flags.writeable = False
    return out


def input_noise(model: Model, intensity: float, h: float, last: Matrix | None = None) -> Matrix:
    """Return the covariance [n, n] that white noise through the input adds over a tick of h seconds.

    `intensity` is per second, and so is `last` [r], of noise on the last r states. For a discrete model, the noise is held
    over the tick.
    """
    Q = intensity * model.B @ model.B.T
    if last is not None and len(last):
        Q[-len(last) :, -len(last) :] += np.diag(last) * (h * h if model.discrete else 1.0)
    return Q / h if model.discrete else noise_over_tick(model.A, Q, h)


def noise_doublings(model: Model, Q: Matrix, h: float, bits: int) -> Matrix:
    """Return the covariance over 2^b ticks of noise that adds Q [n, n] per tick, b = 0 .. bits - 1, [bits, n, n]; cached."""
    return _noise_doublings(model.A, model.discrete, Q, h, bits)


@cached_by_value
def _noise_doublings(A: Matrix, discrete: bool, Q: Matrix, h: float, bits: int) -> Matrix:
    E, noise = _doublings(A, discrete, h, bits), [Q]
    for b in range(bits - 1):
        noise.append(E[b] @ noise[-1] @ E[b].T + noise[-1])
    out = np.stack(noise)
    out.flags.writeable = False
    return out


def powers(model: Model, h: float, ticks: int) -> Matrix:
    """Return the model's maps over i R^level ticks without input, as [2, R, n, n], R^2 > `ticks`; cached.

    See `integrate.after`.
    """
    return _powers(model.A, model.discrete, h, ticks)


@cached_by_value
def _powers(A: Matrix, discrete: bool, h: float, ticks: int) -> Matrix:
    half, n = -(-bits_for(ticks) // 2), len(A)
    binary_maps = _doublings(A, discrete, h, 2 * half)
    levels = []
    for level in range(2):
        table = np.eye(n)[None]
        for E in binary_maps[level * half : (level + 1) * half]:
            table = np.concatenate([table, E @ table])
        levels.append(table)
    out = np.stack(levels)
    out.flags.writeable = False
    return out


def noise_powers(model: Model, Q: Matrix, h: float, ticks: int) -> Matrix:
    """Return the noise covariance over the ticks of each of `powers`, [2, R, n, n], for Q [n, n] per tick; cached."""
    return _noise_powers(model.A, model.discrete, Q, h, ticks)


@cached_by_value
def _noise_powers(A: Matrix, discrete: bool, Q: Matrix, h: float, ticks: int) -> Matrix:
    half = -(-bits_for(ticks) // 2)
    binary_maps = _doublings(A, discrete, h, 2 * half)
    noise, levels = _noise_doublings(A, discrete, Q, h, 2 * half), []
    for level in range(2):
        table = np.zeros_like(noise[:1])
        for b in range(level * half, (level + 1) * half):
            table = np.concatenate([table, binary_maps[b] @ table @ binary_maps[b].T + noise[b]])
        levels.append(table)
    out = np.stack(levels)
    out.flags.writeable = False
    return out


def over(binary_maps: Matrix, ticks: int) -> Matrix:
    """Return e^{A h ticks} as a product of doublings."""
    E = np.eye(binary_maps.shape[1])
    for b in range(binary_maps.shape[0]):
        if ticks >> b & 1:
            E = binary_maps[b] @ E
    return E


def noise_over(binary_maps: Matrix, noise: Matrix, ticks: int) -> Matrix:
    """Return the process noise covariance over `ticks` ticks from its doublings."""
    Q = np.zeros_like(binary_maps[0])
    for b in range(binary_maps.shape[0]):
        if ticks >> b & 1:
            Q = binary_maps[b] @ Q @ binary_maps[b].T + noise[b]
    return Q


def with_unknown_input(model: Model) -> Model:
    """Return the model with its unknown inputs as the last states: x' = A x + B u + E f, f' = 0."""
    E: Matrix = np.asarray(model.E, float)
    (n, r), m = E.shape, model.B.shape[1]
    A = np.zeros((n + r, n + r))
    A[:n, :n], A[:n, n:] = model.A, E
    if model.discrete:
        A[n:, n:] = np.eye(r)
    C = np.hstack([model.C, np.zeros((len(model.C), r))])
    return model._replace(A=A, B=np.vstack([model.B, np.zeros((r, m))]), C=C, E=None, nonlinearity=None)


def with_input_bias(model: Model) -> Model:
    """Return the model with a constant bias b per input as a state: x' = A x + B (u + b), y = C x + D (u + b), b' = 0."""
    n, m = model.B.shape
    A = np.zeros((n + m, n + m))
    A[:n, :n], A[:n, n:] = model.A, model.B
    if model.discrete:
        A[n:, n:] = np.eye(m)
    B_joint = np.vstack([model.B, np.zeros((m, m))])
    E = None if model.E is None else np.vstack([model.E, np.zeros((m, model.E.shape[1]))])
    return model._replace(A=A, B=B_joint, C=np.hstack([model.C, model.feedthrough]), E=E)
