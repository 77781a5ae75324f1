"""What a study names: its scenarios, its observers, and the labels under which they have options."""

from pcbench.observers import OBSERVERS, base_of
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study.loops import closed
from pcbench.study.schema import Study

LTI = "lti"  # the scenario of a linear plant that a study brings


def scenarios_of(study: Study, where: str | None = None) -> dict[str, Scenario]:
    """Return every scenario that a study may name: the published ones, and `lti` where it brings a plant of its own."""
    place = where or study.name
    known = SCENARIOS if study.lti is None else SCENARIOS | {LTI: study.lti.scenario(LTI, f"{place}: lti")}
    if study.controller is None:
        return known
    mine = [name for name in study.scenarios if name in known]
    return known | {name: closed(known[name], study.controller, f"{place}: controller") for name in mine}


def labels_of(study: Study) -> list[str]:
    """Return every label of an observer: its name, or name-anything where the study or a scenario has options for that."""
    given = [key for s in scenarios_of(study).values() if s.name in study.scenarios for key in s.options]
    return list(dict.fromkeys([*OBSERVERS, *(key for key in [*given, *study.options] if base_of(key) is not None)]))


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or scenarios_of(study)[scenario].observers)
