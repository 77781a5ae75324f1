"""Does a controller keep to what pcbench asks of one, and does it hold the plant of a scenario?"""

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.checking import jaxpr_checks
from pcbench.checking.controller_fixtures import Trial, asked, given, numbers, trial
from pcbench.checking.noise_free_runs import WIDTH, moved, planned, quiet, recorded, same_in_lanes, short
from pcbench.checking.targets import Finding, Skipped, ask, require
from pcbench.dynamics.observability import shown as shown_mode
from pcbench.errors import UserError
from pcbench.observers import entry_of as observer_of
from pcbench.plants import nonlinear, signals_of, states_of
from pcbench.scenarios import Scenario
from pcbench.simulation import law_conformance
from pcbench.study import controller_table
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import Own


def numbers_are_arrays(t: Trial) -> str:
    """`prepare` returns arrays only."""
    many = len(jax.tree.leaves(numbers(t)))
    return f"prepare returns {many} array{'s' * (many != 1)}, and nothing else"


def shapes(t: Trial) -> str:
    """A command for each input, set points of the first states, and what is kept comes back as it was."""
    n, m = t.told.model.B.shape
    law_conformance.check(t.label, t.law, numbers(t), law_conformance.Sizes(n, len(signals_of(t.scenario)) - n, m))
    return f"{', '.join(a.name for a in asked(t))} return what they should"


def purity(t: Trial) -> str:
    """The same input gives the same output; nothing is kept outside, no argument is changed."""
    return jaxpr_checks.purity(asked(t), given(t))


def float64(t: Trial) -> str:
    """No number is rounded to fewer bits than it came with."""
    return jaxpr_checks.float64(asked(t), given(t))


def lanes(t: Trial) -> str:
    """Each lane of a batch is what the run gives alone."""
    g = given(t)
    rows = [(g.estimate * (1 + i), moved(g.kept, i)) for i in range(WIDTH)]
    return same_in_lanes(asked(t), rows, lambda own: g._replace(estimate=own[0], kept=own[1]))


def held(t: Trial) -> str:
    """Between decisions the command stays, whatever the estimate does."""
    if t.every == 1:
        raise Skipped("its options have no period: it decides at every tick")
    g, command = given(t), jax.jit(next(a.f for a in asked(t) if a.name == "command"))
    kept, commands = g.kept, []
    for tick in range(2 * t.every):
        given_now = g._replace(tick=jnp.asarray(tick), estimate=g.estimate * (1 + tick), kept=kept)
        u, kept = command(given_now) if t.law.start else (command(given_now), ())
        commands.append(np.asarray(u))
    first = next((k for k, u in enumerate(commands) if not np.array_equal(u, commands[k - k % t.every])), None)
    require(
        first is None,
        f"held: got another command at tick {first}, between decisions every {t.every} ticks (period), expected the last one; "
        "keep it from start on, and decide where now.tick % every == 0.",
    )
    return f"commands change every {t.every} ticks only"


def settles(t: Trial) -> str:
    """The eigenvalues of the closed loop, the state known, lie within the unit circle."""
    found, where = controller_table.slowest(t.scenario, "settles"), t.scenario.name
    if found is None:
        raise Skipped(
            "it has no linear law about rest, as it looks at inputs on their way: write linear(options, told)"
        )
    if sentence := controller_table.warning(t.scenario, "settles"):
        raise UserError(sentence)
    return (
        f"the closed loop on {where} has the eigenvalue {shown_mode(found.mode)} over {found.period:g} s, of size "
        f"{abs(found.mode):.4g}"
    )


def run(t: Trial) -> str:
    """A run from a true start, without noise, stays finite."""
    observer = "ekf" if nonlinear(t.scenario) else "model-only"
    cell = cell_of(t.scenario)._replace(options={observer: observer_of(observer).options()})
    (p,) = planned(quiet(short(cell)))
    s, out = p.cell.scenario, recorded(p, noise=False)
    x = np.asarray(out.x)[:, : len(states_of(s))]
    for k in np.flatnonzero(~(np.isfinite(x).all(1) & np.isfinite(np.asarray(out.u)).all(1))):
        raise UserError(
            f"run: got a state or a command that is not finite at tick {k} ({k * s.dt:g} s) of {s.name}, from a true start "
            "without noise, expected numbers; see what the law divides by, or give other options."
        )
    at_end = ", ".join(f"{name} {v:.3g}" for (name, _), v in zip(states_of(s), x[-1], strict=True))
    return f"after {s.duration:g} s with the state known: {at_end}; commands of {np.abs(out.u).max():.3g} at most"


CHECKS: dict[str, Callable[[Trial], str]] = {
    "numbers": numbers_are_arrays,
    "shapes": shapes,
    "purity": purity,
    "float64": float64,
    "lanes": lanes,
    "held": held,
    "settles": settles,
    "run": run,
}
BASIC = ("numbers", "shapes")
NEEDS = {"": BASIC, "numbers": (), "shapes": ("numbers",), "settles": (*BASIC, "purity"), "run": (*BASIC, "lanes")}


def findings(label: str, mine: Own, scenario: Scenario, options: Mapping[str, Any]) -> list[Finding]:
    """Return what every check says of a controller that closes the loop of a scenario."""
    return ask("options", partial(trial, label, mine, scenario, options), CHECKS, NEEDS)
