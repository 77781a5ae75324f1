"""Does a plant keep to what pcbench asks of one? `pcbench.make_plant` has asked the first things itself."""

from collections.abc import Callable
from functools import partial

from pcbench.checking.plant_fixtures import Trial, trial
from pcbench.checking.plant_functions import axes, finite, float64, lanes, purity, shapes, slopes
from pcbench.checking.plant_motion import perfect_start, rest, seen, tick
from pcbench.checking.result import Finding, ask
from pcbench.scenarios import Scenario

CHECKS: dict[str, Callable[[Trial], str]] = {
    "shapes": shapes,
    "purity": purity,
    "float64": float64,
    "finite": finite,
    "lanes": lanes,
    "axes": axes,
    "slopes": slopes,
    "rest": rest,
    "tick": tick,
    "seen": seen,
    "perfect start": perfect_start,
}
BASIC = ("shapes",)
NEEDS = {
    "": BASIC,
    "shapes": (),
    "slopes": (*BASIC, "finite"),
    "rest": (*BASIC, "finite"),
    "tick": (*BASIC, "finite"),
    "seen": (),
    "perfect start": (*BASIC, "finite", "lanes"),
}


def findings(label: str, scenario: Scenario) -> list[Finding]:
    """Return what every check says of the plant of a scenario."""
    return ask("numbers", partial(trial, label, scenario), CHECKS, NEEDS)
