"""The unmeasured part of a plant between samples, and the gains of a reduced-order PI observer of it.

With z = T x = [y; w], C inv(T) = [I 0], and e^{A T} partitioned after y and w, the error of w and the integral L move by

    J(T) = [[F, -I], [Ki A12, I]],   F = A22 - Kp A12            (PCO: F alone)

from sample to sample. Source: Li, Wang, Tian, PI-PCO, (10) to (17) and (26); J is ours, the paper looks at F only.
"""

from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space

from pcbench.errors import UserError
from pcbench.synthesis import cache, common_lyapunov, linear
from pcbench.synthesis.certificate import Certificate, Setting
from pcbench.synthesis.linear import Matrix
from pcbench.synthesis.observability import require_observable

SHOWN = 17  # intervals the solver sees; the re-check sees every one


class Split(NamedTuple):
    """A plant in coordinates [y; w], over every interval that can occur."""

    T: Matrix  # [n, n]
    outputs: int  # l
    A12: Matrix  # [intervals, l, n-l]
    A22: Matrix  # [intervals, n-l, n-l]


class Found(NamedTuple):
    """Gains [n-l, l] and what proves them."""

    Kp: Matrix
    Ki: Matrix
    certificate: Certificate


def coordinates(C: Matrix, where: str) -> Matrix:
    """Return T [n, n] with C inv(T) = [I 0]: C itself, then the directions it does not see; identity where C = [I 0]."""
    l, n = C.shape
    if np.linalg.matrix_rank(C) < l or l == n:
        raise UserError(
            f"{where}: got C of shape {[l, n]} and rank {np.linalg.matrix_rank(C)}, expected independent outputs, fewer than "
            "states; leave a repeated output out."
        )
    if np.array_equal(C, np.eye(l, n)):
        return np.eye(n)
    unseen = null_space(C).T
    lead = np.take_along_axis(unseen, np.abs(unseen).argmax(1)[:, None], 1)
    return np.vstack([C, unseen * np.sign(lead)])


def split(setting: Setting, intervals: tuple[int, ...], where: str) -> Split:
    """Return the partitions of T e^{A T_i} inv(T) over the intervals [ticks]; raise UserError where w is unobservable."""
    require_observable(setting.model, where)
    T, l = coordinates(setting.model.C, where), len(setting.model.C)
    doubled = linear.doublings(setting.model, setting.dt, linear.bits_for(max(intervals)))
    maps = np.stack([T @ linear.over(doubled, i) @ np.linalg.inv(T) for i in intervals])
    return Split(T, l, maps[:, :l, l:], maps[:, l:, l:])


def jacobian(A12: Matrix, A22: Matrix, Kp: Matrix, Ki: Matrix | None) -> Matrix:
    """Return J(T), or F(T) where Ki is None; A12 and A22 with a leading axis of intervals."""
    F = A22 - Kp @ A12
    if Ki is None:
        return F
    I = np.broadcast_to(np.eye(len(Kp)), F.shape)
    return np.concatenate([np.concatenate([F, -I], 2), np.concatenate([Ki @ A12, I], 2)], 1)


def design(plant: Split, given: list[Matrix], integral: bool, where: str) -> Found:
    """Prove the gains that are given ([Kp] or [Kp, Ki]), or find them by the LMI and prove those."""
    A12, A22 = _vertices(plant)
    k, l = A22.shape[1], plant.outputs
    zero = np.zeros((k, l))
    if given:
        Kp, Ki = given[0], given[1] if integral else zero
        J = jacobian(A12, A22, Kp, Ki if integral else None)
        found = cache.remembered(
            common_lyapunov.Solution, "common-p", (J,), lambda: common_lyapunov.solve(J, None, where)
        )
    else:
        J = jacobian(A12, A22, zero, zero if integral else None)
        H = np.concatenate([A12, np.zeros_like(A12)], 2) if integral else A12
        found = cache.remembered(
            common_lyapunov.Solution, "common-g", (J, H), lambda: common_lyapunov.solve(J, H, where)
        )
        G = np.asarray(found.G, float).reshape(-1, l)
        Kp, Ki = G[:k], -G[k:] if integral else zero
    every = jacobian(plant.A12, plant.A22, Kp, Ki if integral else None)
    what = "J(T)'P J(T) < P at every interval T" if integral else "F(T)'P F(T) < P at every interval T"
    certificate = common_lyapunov.certify(found, every, what)
    numbers = dict(certificate.numbers) | {"Kp": Kp} | ({"Ki": Ki} if integral else {})
    return Found(Kp, Ki, certificate._replace(numbers=numbers))


def _vertices(plant: Split) -> tuple[Matrix, Matrix]:
    """The intervals the solver sees: the corners of the (A12, A22) box where both are numbers, else some of them."""
    if plant.A22.shape[1:] == (1, 1) and plant.outputs == 1:
        a, e = plant.A12.ravel(), plant.A22.ravel()
        corners = np.array([(x, y) for x in {a.min(), a.max()} for y in {e.min(), e.max()}])
        corners = corners[np.lexsort(corners.T)]
        return corners[:, 0].reshape(-1, 1, 1), corners[:, 1].reshape(-1, 1, 1)
    some = np.unique(np.linspace(0, len(plant.A12) - 1, SHOWN).round().astype(int))
    return plant.A12[some], plant.A22[some]
