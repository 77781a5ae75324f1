"""Error metrics as streams: what is kept of e = x - xhat from tick to tick, and what is read from it at the end.

Errors are read after the jump of each tick, on ticks 0 .. N-1. Sums run over a *window* (the whole horizon is the sum
of its windows; the last is the tail).

A new metric also touches `statistics.metric_matrix` (RUN_METRICS), `dataset.columns` (MEANING), `moments.stats_rows` (ORDER); a
new sum also `external.score` and `simulation.reverse_mode`, which compute the sums on their own. CONTRIBUTING.md has the list.
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
    """What is kept of one run in one window; n states."""

    absolute: Array  # [n] sum of |e|
    square: Array  # [n] sum of e^2
    peak: Array  # [n] max |e|


class IntervalSums(NamedTuple):
    """What is kept of the intervals of an observer that has bounds: at one tick, or summed over ticks; n signals."""

    width: Array  # [n] high - low
    inside: Array  # [n] 1 where low <= z <= high


class SettlingState(NamedTuple):
    """What is kept of one run over the whole horizon; n signals."""

    unsettled: Array  # [n] the tick after the last one at which |e| left its band
    recovery: Array  # [n] ticks from a jump of the unknown input until |e| is in its band to stay, until the next; the largest
    first_bad: Array  # first tick at which an error was not finite or beyond the bound, or -1
    interval: PyTree = ()  # IntervalSums of an observer that has bounds


class Weights(NamedTuple):
    """Of the cost (x - x_ref)'Q1 (x - x_ref) + (u - u_ref)'Q2 (u - u_ref), where there is one."""

    Q1: Leaf  # [n, n]; empty: there is no cost, the input alone is summed
    Q2: Leaf  # [m, m]
    x_ref: Leaf  # [T, n] by tick; [0, n]: no set point, so it is 0
    u_ref: Leaf  # [T, m] the steady input of the set point, likewise


class ControlCost(NamedTuple):
    """What is kept of one run's input and cost in one window."""

    cost: Array  # sum
    square: Array  # sum of u'u


def start_effort() -> ControlCost:
    """Return the effort of an empty window."""
    return ControlCost(jnp.zeros(()), jnp.zeros(()))


def spend(effort: ControlCost, weights: Weights, k: Array, x: Array, u: Array) -> ControlCost:
    """Take the state x[n] and the input u[m] of tick k into the window."""
    cost, square = jnp.zeros(()), u @ u
    if np.size(weights.x_ref):
        x, u = x - jnp.asarray(weights.x_ref)[k], u - jnp.asarray(weights.u_ref)[k]
    if np.size(weights.Q1):
        cost = x @ weights.Q1 @ x + u @ weights.Q2 @ u
    return ControlCost(effort.cost + cost, effort.square + square)


def start(n: int) -> ErrorSums:
    """Return the stream of an empty window."""
    return ErrorSums(jnp.zeros(n), jnp.zeros(n), jnp.zeros(n))


def start_watch(n: int, bounded: int = 0) -> SettlingState:
    """Return the watch before the first tick, of an observer that bounds so many signals."""
    interval = IntervalSums(jnp.zeros(bounded), jnp.zeros(bounded)) if bounded else ()
    return SettlingState(jnp.zeros(n), jnp.zeros(n), jnp.asarray(-1.0), interval)


def update(stream: ErrorSums, e: Array) -> ErrorSums:
    """Take the error e[n] of one tick into the window."""
    size = jnp.abs(e)
    return ErrorSums(stream.absolute + size, stream.square + e * e, jnp.maximum(stream.peak, size))


def look(
    watch: SettlingState, tick: Array, e: Array, band: Array, bound: Array, jumps: Array, interval: PyTree = ()
) -> SettlingState:
    """Note when e[n] leaves its settling band, also after one of the `jumps` [J, ticks], and when it first leaves its bound.

    `band` and `bound` are [n] or longer; a NaN leaves the bound. `interval` is that of the tick, where there are bounds.
    """
    n = e.shape[0]
    size, now = jnp.abs(e), tick.astype(float)
    good = jnp.all(size <= bound[:n])
    first_bad = jnp.where(good | (watch.first_bad >= 0), watch.first_bad, now)
    outside, recovery = size > band[:n], watch.recovery
    if jumps.shape[0]:
        since = jnp.min(jnp.where(jumps <= tick, tick - jumps, tick))
        after = jnp.any(jumps <= tick)
        recovery = jnp.where(outside & after, jnp.maximum(recovery, since + 1.0), recovery)
    intervals = jax.tree.map(jnp.add, watch.interval, interval)
    return SettlingState(jnp.where(outside, now + 1, watch.unsettled), recovery, first_bad, intervals)


def read(
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
    """Return every metric by name, [n, L]. Of `streams` [W, n, L] window 0 is before the tail, the others are the tail.

    `final_error` is e of tick N-1.

    `settling_time` [s] is the time of the last exit from the band; a run still outside at the end is given the horizon.
    Where there are `jumps`, `recovery_time` [s] is from a jump to the last exit before the next, the longest of them.
    Of a closed loop `tracking` [W, r, L] gives the rms of set point less state, of the first r states: [r, L]; and
    `effort` [W, L] the input's rms and, where it `costs`, the mean cost: one number a run, [1, L].
    `squares` [n, L] and [L] (`innovation_stats.Squares`) are those of an observer that says how wrong it is.
    `interval_width` is the mean of high - low over ticks, `interval_coverage` the share of ticks with low <= z <= high.
    `sent` [L] is the share of the samples that were sent, where sensors decide.
    A diverged run has NaN for every metric; `diverged` [L] and `divergence_time` [L, s] (NaN where none) tell it apart.
    `unsettled` [n, L]: not diverged, and outside the band in the tail.
    """
    whole = ErrorSums(streams.absolute.sum(0), streams.square.sum(0), streams.peak.max(0))
    late = ErrorSums(streams.absolute[1:].sum(0), streams.square[1:].sum(0), streams.peak[1:].max(0))
    out: dict[str, NDArray] = {}
    for prefix, first, count in (("", 0, ticks), ("steady_", 1, ticks - tail)):
        if tracking is not None:
            out[prefix + "tracking_rmse"] = np.sqrt(np.asarray(tracking.square)[first:].sum(0) / count)
        if effort is not None and costs:
            out[prefix + "lq_cost"] = np.asarray(effort.cost)[first:].sum(0)[None] / count
        if effort is not None:
            out[prefix + "input_rms"] = np.sqrt(np.asarray(effort.square)[first:].sum(0)[None] / count)
    for prefix, s, count in (("", whole, ticks), ("steady_", late, ticks - tail)):
        out[prefix + "mae"] = np.asarray(s.absolute) / count
        out[prefix + "mse"] = np.asarray(s.square) / count
        out[prefix + "rmse"] = np.sqrt(out[prefix + "mse"])
        out[prefix + "max_abs_error"] = np.asarray(s.peak)
    out["final_error"] = np.asarray(final)
    out["settling_time"] = np.asarray(watch.unsettled) * dt
    if jumps:
        out["recovery_time"] = np.asarray(watch.recovery) * dt
    if squares is not None:
        out |= {"nees": np.atleast_2d(squares.whole), "nees_dof": np.atleast_2d(squares.states)}
        out["signal_nees"] = np.asarray(squares.signal)
        if (found := squares.innovation) is not None:
            square, degrees = np.atleast_2d(found.nis_sum), np.atleast_2d(found.dof)
            with np.errstate(invalid="ignore"):  # of a run in which no sample was judged nothing is known
                out |= {"nis": square / np.where(degrees > 0, degrees, np.nan), "nis_dof": degrees}
    if watch.interval:
        out["interval_width"] = np.asarray(watch.interval.width) / ticks
        out["interval_coverage"] = np.asarray(watch.interval.inside) / ticks
    if sent is not None:
        out["sent_fraction"] = np.atleast_2d(sent)
    bad = np.asarray(watch.first_bad) >= 0
    out = {name: np.where(bad, np.nan, values) for name, values in out.items()}
    out["unsettled"] = ~bad & (np.asarray(watch.unsettled) > tail)
    return out | {"diverged": bad, "divergence_time": np.where(bad, np.asarray(watch.first_bad) * dt, np.nan)}
