"""Check that float64 resolves the errors of a run: the rounding of a large state may not be small relative to them.

A float64 x is rounded to multiples of about EPS |x|. An observer computes xhat with the same rounding. So e = x - xhat has no
digits left if EPS |x| is not small relative to e, for any observer. The error is then that rounding, its amplification by an
unstable plant, or 0 if x and xhat agree in all digits. An unstable plant has its largest state at the end. So the errors of
signal i are unresolved if, in most runs,

    EPS |x_i(N-1)|  >  PART mean |e_i| over the tail

and the rounding matters: it exceeds TRIFLE times the settling band of a signal, the process noise of a state, or the noise of
an output. An error that decays to the rounding of a small state counts as 0.
In a stabilised loop the state stays small. Observers that predict with the response to the input (`gains.motion`) do not
benefit: they store that response.
"""

import jax
import numpy as np
from jax import Array
from jaxtyping import Float
from numpy.typing import NDArray

from pcbench.errors import DigitsError
from pcbench.observers.parts.prediction import Motion
from pcbench.planning.padding import Plan
from pcbench.plants import signals_of
from pcbench.runtime import program_cache
from pcbench.simulation.types import GridPointParams, Layout, RunSums, present

EPS = float(np.finfo(np.float64).eps)
PART = 1e-2
TRIFLE = 1e-4
Floats = NDArray[np.float64]


def require(p: Plan, outcome: RunSums) -> None:
    """Raise DigitsError if rounding decides the errors of an observer in most runs of a call."""
    tail = p.cell.times.ticks - p.cell.times.tail
    for label, (name, _) in zip(p.labels, p.layout.observers, strict=True) if np.size(outcome.actual) else ():
        steady_mae = np.asarray(outcome.streams[name].absolute)[1:].sum(0) / tail
        require_of(p, np.asarray(outcome.actual), steady_mae)
        _require_response(p, label, steady_mae)


def require_of(p: Plan, actual: Floats, steady_mae: Floats) -> None:
    """Raise DigitsError if rounding decides errors of mean size `steady_mae` [s, runs]; `actual` is [n + s, runs]."""
    steady_mae = steady_mae[: len(actual)]  # without user-defined errors
    size = np.abs(actual[: len(steady_mae)])
    overflows = ~np.isfinite(size) & (p.layout.controller is None)  # in a closed loop the estimate may cause it
    is_rounding = overflows | (np.isfinite(size) & (EPS * size > PART * steady_mae))
    share = is_rounding.mean(-1)
    if share.max(initial=0.0) <= 0.5:
        return
    worst, typical = int(share.argmax()), np.median(np.abs(actual), -1)
    if np.isfinite(typical[worst]) and not _matters(p, typical):
        return
    s, typical_size = p.cell.scenario, float(typical[worst])
    name, unit = signals_of(s)[worst]
    if np.isfinite(typical_size):
        reaches = (
            f"reaches {amount(typical_size, unit)}, where float64 numbers are {np.spacing(typical_size):.1g} apart"
        )
    else:
        reaches = f"grows beyond {np.finfo(np.float64).max:.1e}, the largest float64"
    steady = "another controller" if s.loop.controller else "a [controller] that stabilises the plant"
    raise DigitsError(
        f"{s.name}, cell {p.cell.number}: {name} {reaches}, so that fewer than two digits of the errors are left, for any "
        f"observer; expected a smaller state: use a shorter duration, {steady}, or an origin near the state."
    )


def require_of_trace(p: Plan, x: Floats, estimates: list[Floats]) -> None:
    """Raise DigitsError if rounding decides an observer's errors in one run: x [N+1, n + s], estimates [N+1, m]."""
    last = p.cell.times.ticks
    for label, estimate in zip(p.labels, estimates, strict=True):
        error = np.abs(x[p.cell.times.tail : last, : estimate.shape[1]] - estimate[p.cell.times.tail : last])
        require_of(p, x[last - 1][:, None], error.mean(0)[:, None])
        _require_response(p, label, error.mean(0)[:, None])


def unresolved_signals(size: Floats, steady_mae: Floats, limits: list[tuple[Floats, Floats]]) -> list[int]:
    """Return the signals of a replay whose mean errors `steady_mae` [m] are rounding; `size` [m] is the largest value of each.

    `limits` are pairs of sizes and reference values: settling bands of signals, noise of measurements.
    """
    matters = any(_exceeds_trifle(s, least) for s, least in limits)
    return np.flatnonzero(matters & (EPS * size > PART * steady_mae)).tolist()


def response_size(p: Plan, label: str) -> Floats | None:
    """Return the size of the response to the input since t = 0, [n]; None if an observer does not store it in a closed loop.

    In a closed loop this response cancels the open-loop response to the initial state, so it is as large
    (`observers.parts.prediction`).
    """
    names = dict(zip(p.labels, (name for name, _ in p.layout.observers), strict=True))
    motion = getattr(p.problem.gains[names[label]], "motion", None)
    if p.layout.controller is None or not isinstance(motion, Motion) or motion.restarts is not None:
        return None
    s, n = p.cell.scenario, len(p.problem.x0)
    with np.errstate(over="ignore", invalid="ignore"):
        growth = np.abs(np.linalg.matrix_power(np.asarray(motion.Phi), p.cell.times.ticks)[:n, :n])
        return np.asarray(growth @ (np.abs(np.asarray(p.problem.x0)) + np.asarray(s.belief.prior_std)))


def describe_response(p: Plan, size: Floats, mask: NDArray[np.bool_]) -> str:
    """Return a clause about the largest response among the states of `mask` [n]."""
    i = int(np.argmax(np.where(mask, size, 0.0)))
    name, unit = signals_of(p.cell.scenario)[i]
    reaches = amount(float(size[i]), unit)
    return f"keeps the response of {name} to the input without the feedback, which grows to about {reaches}"


def _require_response(p: Plan, label: str, steady_mae: Floats) -> None:
    """Raise DigitsError if an observer's stored response to the input leaves too few digits in a closed loop."""
    size = response_size(p, label)
    if size is None:
        return
    mask = (EPS * size[:, None] > PART * steady_mae[: len(size)]).mean(-1) > 0.5
    mask &= EPS * size > TRIFLE * np.asarray(p.problem.band)[: len(size)]
    if mask.any():
        raise DigitsError(
            f"{p.cell.scenario.name}, cell {p.cell.number}: {label} {describe_response(p, size, mask)}, so that fewer than two "
            "digits of its errors are left in float64; expected a smaller one: use a shorter duration, kf or ekf."
        )


def amount(size: float, unit: str) -> str:
    """Return a size with its unit, if it has one."""
    return f"{size:.2g}" if unit in ("", "1") else f"{size:.2g} {unit}"


def _matters(p: Plan, size: Floats) -> bool:
    """Return whether rounding of signals [n + s] of this size matters for settling bands, or noise."""
    n = len(p.problem.x0)
    state = np.where(np.isfinite(size[:n]), size[:n], 0.0)
    y = np.asarray(_JIT_OUTPUT(p.layout, jax.tree.map(np.asarray, p.problem), state))
    process = np.asarray(p.problem.process_std)  # [n] std per tick, [n, n] a root of the covariance, or [0]: none
    process = np.sqrt(np.square(process).sum(-1)) if process.ndim == 2 else process
    return bool(
        (EPS * size > TRIFLE * np.asarray(p.problem.band)[: len(size)]).any()
        or _exceeds_trifle(size[:n], process)
        or _exceeds_trifle(np.abs(y), np.asarray(p.problem.noise_std))
    )


def _output(layout: Layout, p: GridPointParams, x: Float[Array, " n"]) -> Float[Array, " q"]:
    """Return the noise-free measurement of a state at the last tick, [q]."""
    return layout.plant.output(p.params, present(p, p.windows[-1, 0], True), x)


# called after each call of a grid point, so compiled once
_JIT_OUTPUT = program_cache.jit_with_limit(_output, static_argnums=0)


def _exceeds_trifle(size: Floats, std: Floats) -> bool:
    """Return whether the rounding of any number exceeds TRIFLE times its noise, among those with noise."""
    return bool(((EPS * size[: len(std)] > TRIFLE * std) & (std > 0)).any())
