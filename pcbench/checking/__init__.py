"""Does what is a user's own keep to what pcbench asks of it? Named checks, each with a verdict and a reason."""

from typing import Any

from pcbench.checking.finding import Finding
from pcbench.checking.loading import load
from pcbench.checking.observer import CHECKS, findings
from pcbench.errors import UserError, unknown
from pcbench.machine import process
from pcbench.scenarios import SCENARIOS


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
