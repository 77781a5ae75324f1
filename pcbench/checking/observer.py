"""Does an observer keep to what pcbench asks of one?

The order is that of what can be asked: without a design nothing, without the right shapes nothing more.
"""

from collections.abc import Callable

from pcbench.checking.closed_loop import closed_loop
from pcbench.checking.fixtures import Trial, trial
from pcbench.checking.loading import Candidate
from pcbench.checking.noise_free_runs import WIDTH, moved, same_in_lanes
from pcbench.checking.observer_functions import asked, given
from pcbench.checking.programs import float64, gains, purity
from pcbench.checking.run_checks import after_the_jump, delay_0, no_peeking, perfect_start
from pcbench.checking.targets import Finding, ask
from pcbench.scenarios import Scenario
from pcbench.simulation.shape_checks import check as shapes_of


def shapes(t: Trial) -> str:
    """Every function of the protocol returns what it should."""
    for case in t.cases:
        shapes_of(t.label, t.observer, case.problem, continuous=t.observer.field is not None)
    return "init, snapshot, jump, flow and estimate return what they should"


def lanes(t: Trial) -> str:
    """Each lane of a batch is what the run gives alone; lanes stand last."""
    case = t.cases[0]
    first = given(t, case, case.problem.gains[t.label])
    rows = [(moved(first.memory, i), first.value * (1 + i)) for i in range(WIDTH)]
    return same_in_lanes(asked(t, case), rows, lambda own: first._replace(memory=own[0], value=own[1]))


CHECKS: dict[str, Callable[[Trial], str]] = {
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
BASIC = ("shapes",)  # what must pass before another check is asked
RUN = (*BASIC, "lanes")  # a run is carried over lanes
NEEDS = {
    "": BASIC,
    "shapes": (),
    "gains": (*BASIC, "purity"),
    "perfect start": RUN,
    "delay 0": RUN,
    "no peeking": RUN,
    "after the jump": RUN,
    "closed loop": RUN,  # asked where the scenario is one
}


def findings(candidate: Candidate, scenario: Scenario) -> list[Finding]:
    """Return what every check says of an observer on a scenario's plant."""

    def design() -> tuple[Trial, str]:
        made = trial(candidate, scenario)
        refused = f"; refused {len(made.refused)}: {made.refused[0]}" if made.refused else ""
        return made, f"gains on {len(made.cases)} schedules of {scenario.name}{refused}"

    loop = {"closed loop": lambda t: closed_loop(candidate, scenario)} if scenario.loop.controller else {}
    return ask("design", design, CHECKS | loop, NEEDS)
