"""Error metrics as running sums over e = x - xhat, and the metrics computed from them at the end.

Errors are taken after the jump of each tick, at ticks 0 .. N-1. Sums cover a *window*. The windows together cover the whole
duration; the last windows are the tail.

A new metric also changes `statistics.metric_matrix` (RUN_METRICS), `dataset.columns` (MEANING) and `moments.stats_rows`
(ORDER). A new sum also changes `external.score` and `simulation.reverse_mode`, which compute the sums themselves.
CONTRIBUTING.md has the list.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree
from numpy.typing import NDArray

from pcbench.protocols import Leaf


class ErrorSums(NamedTuple):
    """Error sums of one run in one window; n states."""

    absolute: Array  # [n] sum of |e|
    square: Array  # [n] sum of e^2
    peak: Array  # [n] max |e|


class IntervalSums(NamedTuple):
    """Interval width and coverage of an observer with bounds, at one tick or summed over ticks; n signals."""

    width: Array  # [n] upper - lower
    inside: Array  # [n] 1 where lower <= z <= upper


class SettlingState(NamedTuple):
    """Settling and divergence state of one run over the whole duration; n signals."""

    settling_tick: Array  # [n] the tick after the last one with |e| outside its band
    recovery: (
        Array  # [n] largest number of ticks from a jump of the unknown input to the last exit before the next jump
    )
    first_bad: Array  # first tick with an error that was not finite or above the divergence threshold, or -1
    interval: PyTree = ()  # IntervalSums of an observer with bounds


class Weights(NamedTuple):
    """Weights of the cost (x - x_ref)'Q1 (x - x_ref) + (u - u_ref)'Q2 (u - u_ref)."""

    Q1: Leaf  # [n, n]; empty: no cost, only u'u is summed
    Q2: Leaf  # [m, m]
    x_ref: Leaf  # [T, n] by tick; [0, n]: the set point is 0
    u_ref: Leaf  # [T, m] steady input of the set point; [0, m]: 0


class ControlCost(NamedTuple):
    """Input energy and cost of one run in one window."""

    cost: Array  # sum
    square: Array  # sum of u'u


def add_cost(effort: ControlCost, weights: Weights, k: Array, x: Array, u: Array) -> ControlCost:
    """Add the state x[n] and the input u[m] of tick k to the window."""
    cost, square = jnp.zeros(()), u @ u
    if np.size(weights.x_ref):
        x, u = x - jnp.asarray(weights.x_ref)[k], u - jnp.asarray(weights.u_ref)[k]
    if np.size(weights.Q1):
        cost = x @ weights.Q1 @ x + u @ weights.Q2 @ u
    return ControlCost(effort.cost + cost, effort.square + square)


def zero_sums(n: int) -> ErrorSums:
    """Return the error sums of an empty window."""
    return ErrorSums(jnp.zeros(n), jnp.zeros(n), jnp.zeros(n))


def initial_settling(n: int, n_bounded: int = 0) -> SettlingState:
    """Return the settling state before the first tick, for an observer that bounds `n_bounded` signals."""
    interval = IntervalSums(jnp.zeros(n_bounded), jnp.zeros(n_bounded)) if n_bounded else ()
    return SettlingState(jnp.zeros(n), jnp.zeros(n), jnp.asarray(-1.0), interval)


def add_error(stream: ErrorSums, e: Array) -> ErrorSums:
    """Add the error e[n] of one tick to the window."""
    abs_e = jnp.abs(e)
    return ErrorSums(stream.absolute + abs_e, stream.square + e * e, jnp.maximum(stream.peak, abs_e))


def update_settling(
    watch: SettlingState, tick: Array, e: Array, band: Array, bound: Array, jumps: Array, interval: PyTree = ()
) -> SettlingState:
    """Update the settling state with the error e[n] of one tick, also since the last of the `jumps` [J, ticks].

    `band` and `bound` are [n] or longer; a NaN exceeds the bound. `interval` has the sums of this tick, if there are bounds.
    """
    n = e.shape[0]
    abs_e, t = jnp.abs(e), tick.astype(float)
    is_good = jnp.all(abs_e <= bound[:n])
    first_bad = jnp.where(is_good | (watch.first_bad >= 0), watch.first_bad, t)
    outside, recovery = abs_e > band[:n], watch.recovery
    if jumps.shape[0]:
        since = jnp.min(jnp.where(jumps <= tick, tick - jumps, tick))
        has_jumped = jnp.any(jumps <= tick)
        recovery = jnp.where(outside & has_jumped, jnp.maximum(recovery, since + 1.0), recovery)
    intervals = jax.tree.map(jnp.add, watch.interval, interval)
    return SettlingState(jnp.where(outside, t + 1, watch.settling_tick), recovery, first_bad, intervals)


def finalize(
    streams: ErrorSums,
    watch: SettlingState,
    final: Array,
    ticks: int,
    tail: int,
    dt: float,
    jumps: bool = False,
    tracking: ErrorSums | None = None,
    effort: ControlCost | None = None,
    costs: bool = False,
    squares: PyTree = None,
    sent: NDArray | None = None,
) -> dict[str, NDArray]:
    """Return every metric by name, [n, L]. In `streams` [W, n, L] window 0 is before the tail, the others are the tail.

    - `final_error`: e of tick N-1.
    - `settling_time` [s]: time of the last exit from the band; the duration if a run is outside the band at the end.
    - `recovery_time` [s], if there are `jumps`: longest time from a jump to the last exit before the next jump.
    - `tracking` [W, r, L], closed loop: gives the rms of set point minus state, for the first r states, [r, L].
    - `effort` [W, L], closed loop: gives the rms input and, with `costs`, the mean cost, [1, L].
    - `squares` [n, L] and [L]: `innovation_stats.Squares` of an observer with a covariance.
    - `interval_width`: mean of upper - lower over ticks; `interval_coverage`: share of ticks with lower <= z <= upper.
    - `sent` [L]: share of the samples that were sent, if sensors decide.
    - `diverged` [L] and `divergence_time` [L, s] (NaN: none). A diverged run has NaN for every metric.
    - `unsettled` [n, L]: not diverged, and outside the band in the tail.
    """
    total = ErrorSums(streams.absolute.sum(0), streams.square.sum(0), streams.peak.max(0))
    steady = ErrorSums(streams.absolute[1:].sum(0), streams.square[1:].sum(0), streams.peak[1:].max(0))
    out: dict[str, NDArray] = {}
    for prefix, first, count in (("", 0, ticks), ("steady_", 1, ticks - tail)):
        if tracking is not None:
            out[prefix + "tracking_rmse"] = np.sqrt(np.asarray(tracking.square)[first:].sum(0) / count)
        if effort is not None and costs:
            out[prefix + "lq_cost"] = np.asarray(effort.cost)[first:].sum(0)[None] / count
        if effort is not None:
            out[prefix + "input_rms"] = np.sqrt(np.asarray(effort.square)[first:].sum(0)[None] / count)
    for prefix, s, count in (("", total, ticks), ("steady_", steady, ticks - tail)):
        out[prefix + "mae"] = np.asarray(s.absolute) / count
        out[prefix + "mse"] = np.asarray(s.square) / count
        out[prefix + "rmse"] = np.sqrt(out[prefix + "mse"])
        out[prefix + "max_abs_error"] = np.asarray(s.peak)
    out["final_error"] = np.asarray(final)
    out["settling_time"] = np.asarray(watch.settling_tick) * dt
    if jumps:
        out["recovery_time"] = np.asarray(watch.recovery) * dt
    if squares is not None:
        out |= {"nees": np.atleast_2d(squares.nees), "nees_dof": np.atleast_2d(squares.states)}
        out["signal_nees"] = np.asarray(squares.signal)
        if (innovation := squares.innovation) is not None:
            nis_sum, dof = np.atleast_2d(innovation.nis_sum), np.atleast_2d(innovation.dof)
            with np.errstate(invalid="ignore"):  # 0 / 0 in a run without a tested sample
                out |= {"nis": nis_sum / np.where(dof > 0, dof, np.nan), "nis_dof": dof}
    if watch.interval:
        out["interval_width"] = np.asarray(watch.interval.width) / ticks
        out["interval_coverage"] = np.asarray(watch.interval.inside) / ticks
    if sent is not None:
        out["sent_fraction"] = np.atleast_2d(sent)
    diverged = np.asarray(watch.first_bad) >= 0
    out = {name: np.where(diverged, np.nan, values) for name, values in out.items()}
    out["unsettled"] = ~diverged & (np.asarray(watch.settling_tick) > tail)
    return out | {"diverged": diverged, "divergence_time": np.where(diverged, np.asarray(watch.first_bad) * dt, np.nan)}
