"""Does an observer keep to what pcbench asks of one? Named checks, each with a verdict and a reason.

The order is that of what can be asked: without a design nothing, without the right shapes nothing more.
"""

from collections.abc import Callable
from functools import partial
from typing import Any

from pcbench.checking.finding import FAILS, PASSES, SKIPPED, Finding, Skipped
from pcbench.checking.lanes import lanes
from pcbench.checking.loading import Candidate, load
from pcbench.checking.programs import float64, gains, purity
from pcbench.checking.schedules import after_the_jump, delay_0, no_peeking, perfect_start
from pcbench.checking.trial import Trial, trial
from pcbench.errors import UserError, raised, unknown
from pcbench.machine import process
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.simulation.conformance import check as shapes_of

Check = Callable[[Trial], str]  # what passed; raises UserError or Skipped


def shapes(t: Trial) -> str:
    """Every function of the protocol returns what it should."""
    for case in t.cases:
        p = case.problem
        shapes_of(t.label, t.observer, p, continuous=t.observer.field is not None)
    return "init, note, jump, flow and estimate return what they should"


CHECKS: dict[str, Check] = {
    "shapes": shapes,
    "purity": purity,
    "gains": gains,
    "float64": float64,
    "lanes": lanes,
    "perfect start": perfect_start,
    "delay 0": delay_0,
    "no peeking": no_peeking,
    "after the jump": after_the_jump,
}
BASIC = ("design", "shapes")  # what must pass before another check is asked
RUN = (*BASIC, "lanes")  # a run is carried over lanes
NEEDS = {
    "shapes": ("design",),
    "gains": (*BASIC, "purity"),
    "perfect start": RUN,
    "delay 0": RUN,
    "no peeking": RUN,
    "after the jump": RUN,
}


def check(
    target: str, scenario: str = "cart/white", options: dict[str, Any] | None = None
) -> tuple[str, list[Finding]]:
    """Return the name of the observer that MODULE:OBSERVER names, and what every check says of it on a scenario's plant.

    Raises UserError where there is no such module, observer, option or scenario.
    """
    if scenario not in SCENARIOS:
        raise unknown("check --scenario", "scenario", scenario, SCENARIOS)
    with process.float64():
        candidate = load(target, options)
        return candidate.label, findings(candidate, SCENARIOS[scenario])


def findings(candidate: Candidate, scenario: Scenario) -> list[Finding]:
    """Return what every check says of an observer; nothing that its code raises comes out but in a sentence."""
    made: list[Trial] = []

    def design() -> str:
        made.append(trial(candidate, scenario))
        refused = f"; refused {len(made[0].refused)}: {made[0].refused[0]}" if made[0].refused else ""
        return f"gains on {len(made[0].cases)} schedules of {scenario.name}{refused}"

    out = [_verdict("design", design)]
    for name, check in CHECKS.items():
        failed = [f.check for f in out if f.verdict == FAILS]
        first = next((need for need in NEEDS.get(name, BASIC) if need in failed), None)
        if first:
            out.append(Finding(name, SKIPPED, f"not asked before {first} passes"))
        else:
            out.append(_verdict(name, partial(check, made[0])))
    return out


def _verdict(name: str, check: Callable[[], str]) -> Finding:
    try:
        return Finding(name, PASSES, check())
    except Skipped as reason:
        return Finding(name, SKIPPED, str(reason))
    except UserError as error:
        return Finding(name, FAILS, str(error))
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        return Finding(name, FAILS, f"{name}: got {raised(error)}, expected code that can be run; mend that line.")
