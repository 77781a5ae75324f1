"""What a study's `tune.only` names of each observer, and whether the labels of its versions are free."""

from pcbench.errors import UserError, unknown
from pcbench.gains import parameters
from pcbench.scenarios import Scenario
from pcbench.study import Study
from pcbench.study.lookup import entry_in


def only(study: Study, observer: str) -> list[str] | None:
    """Return the options of an observer that are tuned; None: all that may be."""
    may = parameters.tunable(entry_in(study, observer))
    return None if study.tune.only is None else [name for name in study.tune.only if name in may]


def require_tunable(study: Study, observers: list[str]) -> None:
    """Raise UserError where a name of `tune.only` is of an option that no observer of the study tunes."""
    may = {name: None for o in observers for name in parameters.tunable(entry_in(study, o))}
    for name in study.tune.only or ():
        if name not in may:
            raise unknown(f"{study.name}: tune.only", "option that an observer of the study tunes", name, [*may])


def require_free_labels(study: Study, scenario: Scenario, observers: list[str]) -> None:
    """Raise UserError where the scenario has options for a version's label: they would be taken for its own."""
    for observer in observers if len(study.tunings) > 1 else ():
        if taken := [label for t in study.tunings if (label := f"{observer}-{t}") in scenario.options]:
            raise UserError(
                f"{study.name}: tuning: got {taken[0]} for gains of {observer}, expected a label that {scenario.name} has no "
                f"options for; run {observer} under another label."
            )
