"""Plant from sample to sample, for observers that compute once per sample: its map, its noise, and its observability.

x(k+1) = A x(k) + B u(k) + w,  y(k) = C x(k) + D u(k) + v, where k counts samples. All channels are sampled together every
`period` ticks, and channel j arrives a whole number tau_j of samples later.
"""

from typing import NamedTuple

import numpy as np

from pcbench.dynamics import linear
from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.dynamics.observability import format_mode, rank
from pcbench.errors import UserError
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import NO_NOISE, DesignContext

power = np.linalg.matrix_power
MIN_SINGULAR_VALUE = 1e-8  # least singular value of Hautus' test for an observable mode, in scaled units
NO_DECAY = 1 - 1e-9  # a mode of this absolute value or more does not decay
MAX_ROWS = 1500  # of the largest map whose spectral radius is computed
MAX_GROWTH = 100.0  # powers of ten by which a model may grow over a delay


class SampledPlant(NamedTuple):
    """n states, q outputs; one step is one sample."""

    A: Matrix  # [n, n]
    C: Matrix  # [q, n]
    Q: Matrix  # [n, n] covariance that the assumed process noise adds over a sample
    R: Matrix  # [q, q] variance of one sample
    tau: tuple[int, ...]  # [q] samples
    period: int  # ticks
    scale: Matrix  # [n] size of each state, for rank decisions
    sizes: Matrix  # [q] size of each output


def sample_plant(context: DesignContext, observer: str, q: float | None = None) -> SampledPlant:
    """Return the plant at its samples; `q` is process noise through the input, per second (default: the context's).

    Raises UserError if channels differ in period, a delay is not a whole number of samples, or the model overflows over it.
    """
    where = f"{observer} in {context.scenario}"
    period = _period_in_ticks(context, where)
    model, tau = context.model, tuple(delay // period for delay in context.delay)
    tick = linear.input_noise(model, context.input_intensity if q is None else q, context.dt) + context.process_noise
    binary_maps = linear.doublings(model, context.dt, linear.bits_for(period))
    noise = linear.noise_doublings(model, tick, context.dt, len(binary_maps))
    A, Q = linear.over(binary_maps, period), linear.noise_over(binary_maps, noise, period)
    fastest = float(np.abs(np.linalg.eigvals(A)).max())
    if max(tau) * np.log10(max(fastest, 1e-300)) > MAX_GROWTH:
        raise UserError(
            f"{where}: got a model that grows by {fastest:.3g} a sample over a delay of {max(tau)} samples, expected less than "
            f"1e{MAX_GROWTH:.0f} in all; shorten the delay."
        )
    scale = riccati.prior_size(context)
    sizes = np.linalg.norm(model.C * scale, axis=1)
    R = context.noise_variance
    sizes = np.where(R > NO_NOISE, np.sqrt(R), np.where(sizes > 0, sizes, 1.0))
    return SampledPlant(A=A, C=model.C, Q=Q, R=np.diag(R), tau=tau, period=period, scale=scale, sizes=sizes)


def _period_in_ticks(context: DesignContext, where: str) -> int:
    """Return the period in ticks; raise UserError if a delay is not a whole number of samples."""
    periods, dt, error = set(context.period), context.dt, context.error
    if len(periods) > 1:
        seconds = ", ".join(f"{p * dt:g}" for p in context.period)
        raise UserError(
            f"{where}: got sampling periods of {seconds} s, expected the same for all channels, because it computes "
            "once per sample; give one period, or use kf."
        )
    period = periods.pop()
    times = {f"a delay of {{}} s in channel {j + 1}": delay - error for j, delay in enumerate(context.delay)}
    for template, ticks in (times | {"an assumed_delay_error of {} s": error}).items():
        if ticks % period:
            low = ticks // period * period * dt
            raise UserError(
                f"{where}: got {template.format(f'{ticks * dt:g}')} at a sampling period of {period * dt:g} s, expected whole "
                f"samples; write {low:g} or {low + period * dt:g}, or use kf."
            )
    return period


def noise_over(plant: SampledPlant, d: int) -> Matrix:
    """Return the covariance that process noise adds over d samples, [n, n]: the sum of A^j Q A^j'."""
    powers = [power(plant.A, j) for j in range(d)]
    return np.asarray(sum(E @ plant.Q @ E.T for E in powers))


def invertible(C: Matrix) -> bool:
    """Return whether C is square and invertible."""
    return C.shape[0] == C.shape[1] and rank(C) == len(C)


def require_visible(
    plant: SampledPlant, d: int, where: str, least: float = NO_DECAY, purpose: str = "its design"
) -> None:
    """Raise UserError with a mode of A^d of absolute value `least` or more that C does not observe.

    This is Hautus' test at the scale of x(0) and of the noise. It uses singular values, so that it detects a multiple mode:
    two modes of A may be equal in A^d.
    """
    Ad = power(plant.A, d) / plant.scale[:, None] * plant.scale
    C = plant.C / plant.sizes[:, None] * plant.scale
    for mode in np.linalg.eigvals(Ad):
        *_, sizes, V = np.linalg.svd(np.vstack([Ad - mode * np.eye(len(Ad)), C]))
        if abs(mode) >= least and sizes[-1] < MIN_SINGULAR_VALUE:
            v = plant.scale * V[-1].conj()
            direction = ", ".join(f"{part:.3g}" for part in np.real(v / v[np.abs(v).argmax()]))
            kind = "a detectable" if least else "an observable"
            raise UserError(
                f"{where}: got (C, A^d) that over d = {d} samples does not show the mode {format_mode(complex(mode))} of A^d "
                f"(along [{direction}]), expected {kind} pair for {purpose}; measure another output or change a delay."
            )


def delayed_radius(A: Matrix, K: Matrix, C: Matrix, ages: tuple[int, ...]) -> float:
    """Return the spectral radius of e(k+1) = A e(k) - sum_j K_j C_j e(k - ages_j); NaN if the ages are too long."""
    n = len(A)
    if n * (max(ages) + 1) > MAX_ROWS:
        return float("nan")
    J = np.eye(n * (max(ages) + 1), k=-n)
    J[:n, :n] += A
    for j, age in enumerate(ages):
        J[:n, n * age : n * (age + 1)] -= np.outer(K[:, j], C[j])
    return spectral_radius(J)
