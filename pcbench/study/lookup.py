"""What a study names: its scenarios, its observers, and the labels under which they have options."""

from pcbench.observers import LONGEST, OBSERVERS, ObserverSpec, base_of
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study.controller_table import closed
from pcbench.study.parse_scenario import scenario_of
from pcbench.study.plugins.user_code import Own
from pcbench.study.schema import Study

LTI = "lti"  # the scenario of a linear plant that a study brings


def scenarios_of(study: Study, where: str | None = None) -> dict[str, Scenario]:
    """Return every scenario that a study may name: the published ones, `lti` where it brings a plant, and those of its own.

    Where the study has a controller, those that it names have their loops closed by that.
    """
    known, where = SCENARIOS, where or study.name
    if study.lti is not None:
        known = known | {LTI: study.lti.scenario(LTI, f"{where}: lti")}
    if study.scenario is not None:
        name = study.scenario.name or study.name
        known = known | {name: scenario_of(study.scenario, name, f"{where}: scenario", study._own)}
    for name, table in (study.tables or {}).items():
        known = known | {name: scenario_of(table, name, f"{where}: scenarios.{name}", study._own)}
    if study.controller is None:
        return known
    mine = [name for name in study.scenarios if name in known]
    return known | {name: closed(known[name], study.controller, f"{where}: controller", study._own) for name in mine}


def labels_of(study: Study) -> list[str]:
    """Return every label of an observer: its name, or name-anything where the study or a scenario has options for that."""
    given = [key for s in scenarios_of(study).values() if s.name in study.scenarios for key in s.options]
    variants = (key for key in [*given, *study.options] if base_in(study, key) is not None)
    return list(dict.fromkeys([*study.custom_observers, *OBSERVERS, *variants]))


def base_in(study: Study, label: str) -> str | None:
    """Return the observer that a label names in a study, one of the user's own first: its name, or name-anything."""
    found = [name for name in study.custom_observers if label == name or label.startswith(name + "-")]
    return max(found, key=len) if found and label.isprintable() and len(label) <= LONGEST else base_of(label)


def own_in(study: Study, label: str) -> Own | None:
    """Return the observer of a user's own that a label names in a study; None where it is one of pcbench's."""
    return study._own.get(base_in(study, label) or label)


def entry_in(study: Study, label: str) -> ObserverSpec:
    """Return the entry of the observer that a label names in a study; raise KeyError where there is none."""
    mine = own_in(study, label)
    return mine.entry if mine else OBSERVERS[base_in(study, label) or label]


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or scenarios_of(study)[scenario].observers)
