"""Unmeasured part of a plant between samples, and the gains of a reduced-order PI observer of it.

With z = T x = [y; w], C inv(T) = [I 0], and e^{A T} partitioned into y and w, the map of the error of w and the integral L
from sample to sample is

    J(T) = [[F, -I], [Ki A12, I]],   F = A22 - Kp A12            (PCO: F alone)

With more unmeasured states than outputs (n > 2 l), J has the eigenvalue 1 for all Kp and Ki: Ki A12 [n-l, n-l] has a rank of
at most l < n-l, so there is a v with Ki A12 v = 0, and J [v; (F - I) v] = [v; (F - I) v]. So no PI-PCO is stable for such
plants.
Gains are computed and certified in units of 1000^k (k whole) near the size of x(0), because the solution of the LMI depends
on the units. The margin is in those units.
Source: Li, Wang, Tian, PI-PCO, (10) to (17) and (26); J is this project's, the paper analyses F only.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import null_space

from pcbench.dynamics.linear import Matrix, Model
from pcbench.dynamics.observability import rank, require_observable
from pcbench.errors import UserError
from pcbench.synthesis import common_lyapunov, error_bounds, riccati
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.common_lyapunov import ErrorMaps
from pcbench.synthesis.parameter_ranges import Maps


class Partition(NamedTuple):
    """A plant in coordinates [y; w], over every map of a range."""

    T: Matrix  # [n, n]
    outputs: int  # l
    A12: Matrix  # [maps, l, n-l]
    A22: Matrix  # [maps, n-l, n-l]
    seconds: Matrix  # [maps] interval of each
    units: Matrix  # [n] units of y and w for the LMI
    corners: NDArray[np.int64]  # indices of the maps for a solver


def coordinates(C: Matrix, where: str) -> Matrix:
    """Return T [n, n] with C inv(T) = [I 0]: the rows of C, then a basis of its null space; identity if C = [I 0]."""
    l, n = C.shape
    if rank(C) < l or l == n:
        raise UserError(
            f"{where}: got C of shape {[l, n]} and rank {rank(C)}, expected independent outputs, fewer than "
            "states; leave a repeated output out."
        )
    if np.array_equal(C, np.eye(l, n)):
        return np.eye(n)
    basis = null_space(C).T
    lead = np.take_along_axis(basis, np.abs(basis).argmax(1)[:, None], 1)
    return np.vstack([C, basis * np.sign(lead)])


def partition(model: Model, size: Matrix, maps: Maps, where: str) -> Partition:
    """Return the partitions of T Phi inv(T) over a range of maps, for states of a `size` [n].

    Raises UserError if w is unobservable.
    """
    require_observable(model, where)
    T, l = coordinates(model.C, where), len(model.C)
    Phi_T = T @ maps.Phi @ np.linalg.inv(T)
    return Partition(
        T=T,
        outputs=l,
        A12=Phi_T[:, :l, l:],
        A22=Phi_T[:, l:, l:],
        seconds=maps.seconds,
        units=riccati.nearest_scale(np.linalg.norm(T * size, axis=1)),
        corners=maps.corners,
    )


def jacobian(A12: Matrix, A22: Matrix, Kp: Matrix, Ki: Matrix | None) -> Matrix:
    """Return J(T), or F(T) if Ki is None; A12 and A22 have a leading axis of intervals."""
    F = A22 - Kp @ A12
    if Ki is None:
        return F
    I = np.broadcast_to(np.eye(len(Kp)), F.shape)
    return np.concatenate([np.concatenate([F, -I], 2), np.concatenate([Ki @ A12, I], 2)], 1)


def design(
    plant: Partition, gain_list: list[Matrix], integral: bool, rate: float, where: str
) -> tuple[Matrix, Matrix, Certificate]:
    """Certify the gains `gain_list` ([Kp] or [Kp, Ki]), or compute and certify gains by the LMI, at a `rate` [1/s].

    Return Kp, Ki [n-l, l] and the certificate.
    """
    error_bounds.require_slower(rate, plant.seconds, where)
    k, l = plant.A22.shape[1], plant.outputs
    if integral and k > l:
        raise UserError(
            f"{where}: got {k + l} states and {l} independent output{'s' * (l > 1)}, expected at most {2 * l} states: with "
            "more, the error's map has the eigenvalue 1 for all gains Kp and Ki. Use pco, or measure another output."
        )
    measured, unmeasured = plant.units[:l], plant.units[l:]
    into_w, into_y = unmeasured / unmeasured[:, None], unmeasured / measured[:, None]
    plant = plant._replace(A12=plant.A12 * into_y, A22=plant.A22 * into_w)
    gain_list = [gain / into_y.T for gain in gain_list]
    zero, (A12, A22, seconds) = np.zeros((k, l)), _corners(plant, rate)

    def gains(solution: common_lyapunov.CommonLyapunov) -> tuple[Matrix, Matrix]:
        if gain_list:
            return gain_list[0], gain_list[1] if integral else zero
        G = np.asarray(solution.G, float).reshape(-1, l)
        return G[:k], -G[k:] if integral else zero

    def maps_of(solution: common_lyapunov.CommonLyapunov) -> ErrorMaps:
        Kp, Ki = gains(solution)
        return ErrorMaps(jacobian(plant.A12, plant.A22, Kp, Ki if integral else None), plant.seconds)

    if gain_list:
        corner_maps = ErrorMaps(jacobian(A12, A22, gain_list[0], gain_list[1] if integral else None), seconds)
    else:
        H = np.concatenate([A12, np.zeros_like(A12)], 2) if integral else A12
        corner_maps = ErrorMaps(jacobian(A12, A22, zero, zero if integral else None), seconds, H)
    inequality = "J(T)'P J(T) < P" if integral else "F(T)'P F(T) < P"
    inequality = inequality.replace("< P", f"< e^{{-2 {rate:g} T}} P") if rate else inequality
    inequality = f"{inequality} at every interval T"
    solution, certificate = common_lyapunov.design(corner_maps, maps_of, rate, inequality, where)
    Kp, Ki = (gain * into_y.T for gain in gains(solution))
    scale = np.tile(unmeasured, 2 if integral else 1)
    numbers = dict(certificate.numbers) | {"P": solution.P / np.outer(scale, scale), "Kp": Kp}
    if integral:
        numbers["Ki"] = Ki
    return Kp, Ki, certificate._replace(numbers=numbers)


def _corners(plant: Partition, rate: float) -> tuple[Matrix, Matrix, Matrix]:
    """Return A12, A22 and intervals for the solver: corners of the box of scalar (A12, A22) without a rate, else some maps."""
    if plant.A22.shape[1:] == (1, 1) and plant.outputs == 1 and rate == 0:
        a, e = plant.A12.ravel(), plant.A22.ravel()
        box = np.array([(x, y) for x in {a.min(), a.max()} for y in {e.min(), e.max()}])
        box = box[np.lexsort(box.T)]
        return box[:, 0].reshape(-1, 1, 1), box[:, 1].reshape(-1, 1, 1), np.zeros(len(box))
    indices = plant.corners
    return plant.A12[indices], plant.A22[indices], plant.seconds[indices]
