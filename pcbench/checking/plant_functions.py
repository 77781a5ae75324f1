"""Checks of a plant's functions where they are: shapes, finite values, slopes, and the numbers that change nothing."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.checking import pure
from pcbench.checking.plant_fixtures import Given, Trial, asked, entries_of, moves, points, shown_at
from pcbench.checking.result import Noted, Skipped, require
from pcbench.checking.vmap_check import WIDTH, same_in_lanes
from pcbench.dynamics.linear import discretize_zoh
from pcbench.errors import UserError, raised
from pcbench.plants import numbers_of

STEP, CLOSE, KINK = 1e-5, 1e-6, 1e-2  # of the spread; of the slopes; of those from either side


def shapes(t: Trial) -> str:
    """Every function returns a number for each state, output or unknown."""
    for a in asked(t):
        want = (len(entries_of(t, a.name)),)
        try:
            found = jax.eval_shape(lambda g, a=a: jnp.asarray(a.f(g)), points(t)[0])
        except Exception as error:
            raise UserError(
                f"shapes: {a.name} cannot be traced ({raised(error)}), expected pure jax.numpy code for one run, with "
                "jnp.where in place of if; mend that line."
            ) from None
        require(
            found.shape == want,
            f"shapes: got an array of shape {list(found.shape)} from {a.name}, expected {list(want)}, a number for each of "
            f"{', '.join(entries_of(t, a.name))}; return all of them.",
        )
    return f"{', '.join(a.name for a in asked(t))} return what they should"


def purity(t: Trial) -> str:
    """The same input gives the same output; nothing is kept outside, no argument is changed."""
    return pure.purity(asked(t), points(t)[1])


def float64(t: Trial) -> str:
    """No number is rounded to fewer bits than it came with."""
    return pure.float64(asked(t), points(t)[1])


def lanes(t: Trial) -> str:
    """Each lane of a batch is what the run gives alone."""
    rows = [(g.x, g.u) for g in points(t)[1 : 1 + WIDTH]]
    return same_in_lanes(asked(t), rows, lambda own: Given(t.params, *own))


def finite(t: Trial) -> str:
    """Values are numbers at the operating point and around it."""
    for a in asked(t):
        f = jax.jit(a.f)
        for g in points(t):
            value = np.asarray(f(g))
            for i in np.flatnonzero(~np.isfinite(value)):
                raise UserError(
                    f"finite: got {value[i]} for {entries_of(t, a.name)[i]} in {a.name} at {shown_at(t, g)}, expected a "
                    "number; guard the root or the quotient there, or name a --scenario whose prior_std stays where the plant "
                    "can be."
                )
    return f"finite at the operating point and at {len(points(t)) - 1} points around it"


def slopes(t: Trial) -> str:
    """What jax and the linear model take for slopes are those of the values, from either side."""
    linear = t.model.known is None and (
        t.entry.model is None or t.entry.residual is not None
    )  # then the model is the slope
    motion, A, B = moves(t), t.model.A, t.model.B
    if motion.name == "step" and not t.model.discrete:
        A, B = discretize_zoh(A, B, t.scenario.dt)
    for a, model in (
        (motion, (A, B)),
        (next(a for a in asked(t) if a.name == "output"), (t.model.C, t.model.feedthrough)),
    ):
        f, here = jax.jit(a.f), points(t)
        derived = jax.jit(jax.jacfwd(a.f))
        for i, g in enumerate(here[: 1 + WIDTH]):
            slope = derived(g)
            known = model if not i and linear else None
            for name, size, k in (("x", t.spread, 0), ("u", t.reach, 1)):
                said = np.asarray(known[k] if known else getattr(slope, name)) * size
                _compare(t, a.name, f, g, name, size, said, "the linear model" if known else "jax")
    return "jax and the linear model agree with differences of the values"


def _compare(
    t: Trial, function: str, f: Any, g: Given, name: str, size: np.ndarray, said: np.ndarray, who: str
) -> None:
    """Raise UserError where slopes, times the spread, are not those of values a little to either side."""
    at, names = np.asarray(f(g)), t.states if name == "x" else [f"u{i + 1}" for i in range(len(size))]

    def beside(j: int, sign: int) -> np.ndarray:
        moved = getattr(g, name).at[j].add(sign * STEP * size[j])
        return np.asarray(f(g._replace(**{name: moved})))

    up, down = ((np.stack([beside(j, s) for j in range(len(size))], 1) - at[:, None]) * s / STEP for s in (1, -1))
    scale = np.abs(said).max() + np.abs(at)[:, None] + np.abs(up)
    for found, allowed in (((up + down) / 2, CLOSE), (up, KINK), (down, KINK)):
        bad = np.argwhere(~(np.abs(found - said) <= allowed * scale + 1e-300))
        if bad.size:
            i, j = bad[0]
            raise UserError(
                f"slopes: got {said[i, j] / size[j]:.6g} from {who} and {found[i, j] / size[j]:.6g} from differences for the "
                f"slope of {entries_of(t, function)[i]} in {function} by {names[j]}, at {shown_at(t, g)}, expected the same; "
                "smooth the kink there, or leave out what hides a slope (stop_gradient, NumPy, rounding)."
            )


def axes(t: Trial) -> str:
    """Each number that a study may vary changes something."""
    if not t.axes:
        raise Skipped("it has no numbers that a study may vary")
    numbers, idle = numbers_of(t.scenario), []
    fs = [jax.jit(a.f) for a in asked(t) if a.name != "unknown"]
    for name in t.axes:
        value = getattr(numbers, name)
        other = t.entry.prepare(numbers._replace(**{name: 1.01 * value or 0.01}), t.scenario.dt, 10)
        params = jax.tree.map(jnp.asarray, other)
        if all(np.array_equal(f(g), f(g._replace(params=params))) for f in fs for g in points(t)):
            idle.append(f"plant.{name}")
    if idle:
        raise Noted(
            f"around the operating point nothing changes with {', '.join(idle)}: a study that varies it there gets equal cells"
        )
    return "each of its numbers changes the plant"
