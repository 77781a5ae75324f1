"""The options of each observer that differ from their defaults, and where they come from."""

from typing import Any, NamedTuple

from pcbench.dataset.result import Result
from pcbench.plots.scales import number
from pcbench.study import Study, dashes, given, observers_of, scenarios_of
from pcbench.study.lookup import base_in, entry_in
from pcbench.study.plugins.user_observers import ABSENT

LONG = 120  # letters of a value at most


class Option(NamedTuple):
    """One option of an observer."""

    observer: str
    name: str
    value: str
    default: str
    tuned: bool
    origin: str


def rows(result: Result) -> list[Option]:
    """Return the options of a study's observers that differ from their defaults, in the order of the study.

    Of an observer whose code is left alone the defaults are not known: all options that were given are returned.
    """
    study, found = result.study, list[Option]()
    known = scenarios_of(study)
    for name in study.scenarios:
        for observer in observers_of(study, name):
            found += [o for o in _of(study, known[name], observer, len(study.scenarios) > 1) if o not in found]
    return found


def _of(study: Study, scenario: Any, observer: str, several: bool) -> list[Option]:
    entry = entry_in(study, observer)
    fields = {} if entry.summary == ABSENT else entry.options.model_fields
    labels = [base_in(study, observer) or observer, observer]
    set_here = {key for label in labels for key in dashes(study.options.get(label, {}))}
    tuned = study.tuned.options.get(observer, {}) if study.tuned else {}
    found = []
    for name, value in given(study, scenario, observer).items():
        default = fields[name].get_default(call_default_factory=True) if name in fields else None
        if name in fields and value == default:
            continue
        origin = "the study" if name in set_here else f"the scenario{f' {scenario.name}' if several else ''}"
        was = _word(default) if name in fields and not fields[name].is_required() else "-"
        is_tuned = name in tuned and tuned[name] == value
        if is_tuned and study.tuned and study.tuned.cells:
            found.append(Option(observer, name, f"{_word(value)} in the first cell", was, True, origin))
            continue
        found.append(Option(observer, name, _word(value), was, is_tuned, origin))
    return found


def _word(value: Any) -> str:
    if isinstance(value, float):
        return number(value)
    if isinstance(value, list | tuple):
        text = f"[{', '.join(_word(v) for v in value)}]"
        return text if len(text) <= LONG else f"{text[: LONG - 4]} ..."
    return "none" if value is None else str(value)
