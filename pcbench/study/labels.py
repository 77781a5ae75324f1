"""Labels of observers: from the two forms in which a study names them, a list of names, or tables with `use` and options.

    observers = ["kf", "mine.py:nudge"]        [observers.kf]
                                                [observers.strong]
                                                use = "mine.py:nudge"
                                                share = 0.3

In a list, MODULE:NAME has the label NAME. A name from an installed package is its own label. A path is relative to the study
file; on the command line and in Python it is relative to the working folder.
"""

import re
from collections.abc import Callable

from pcbench.errors import UserError, brief_repr, short
from pcbench.observers import MAX_LABEL_LENGTH, OBSERVERS, ObserverSpec, base_of
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study.controller_table import close_loop
from pcbench.study.parse_scenario import scenario_of
from pcbench.study.plugins import user_code
from pcbench.study.plugins.registry import find_plugins
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.schema import Study
from pcbench.toml_text import TomlTable

LABEL = re.compile(rf"\w[\w.+-]{{0,{MAX_LABEL_LENGTH - 1}}}")


def resolve_labels(raw: TomlTable, where: str) -> TomlTable:
    """Return a raw study whose observers are labels; its table `custom_observers` has those that are user-defined.

    Raises UserError for an invalid label, or one of two observers.
    """
    observers, options = raw.get("observers"), raw.get("options")
    references = dict(raw["custom_observers"]) if isinstance(raw.get("custom_observers"), dict) else {}
    if isinstance(observers, dict):
        raw = raw | {"observers": list(observers), "options": _options(observers, options, references, where)}
    elif isinstance(observers, list):
        raw = raw | {"observers": _labels(observers, references, f"{where}: observers")}

    def with_labels(table: TomlTable, place: str) -> TomlTable:
        names = table.get("observers")
        if not isinstance(names, list):
            return table
        return table | {"observers": _labels(names, references, f"{where}: {place}.observers")}

    raw = each_table(raw, with_labels)
    return raw | {"custom_observers": references} if references else raw


def each_table(raw: TomlTable, change: Callable[[TomlTable, str], TomlTable]) -> TomlTable:
    """Return a raw study with each user-defined scenario's table changed; `change` takes the table and its place."""
    out = raw | {name: change(raw[name], name) for name in ("lti", "scenario") if isinstance(raw.get(name), dict)}
    if isinstance(raw.get("tables"), dict):
        tables = raw["tables"].items()
        out["tables"] = {k: change(v, f"scenarios.{k}") if isinstance(v, dict) else v for k, v in tables}
    return out


def label_of(name: str) -> str:
    """Return the label of a name in a list of observers."""
    return name.rpartition(":")[2] if user_code.is_reference(name) else name


def _labels(names: list[object], references: dict[str, str], where: str) -> list[object]:
    """Return the labels of a list of names; references of user-defined ones are added to `references`."""
    out: list[object] = []
    for name in names:
        if not isinstance(name, str):
            out.append(name)  # the schema reports the error
            continue
        label = label_of(name)
        if user_code.is_reference(name):
            user_code.split(name, where)
            _require_free(label, name, where)
            if references.get(label, name) != name or label in out:
                raise UserError(
                    f"{where}: got '{short(name)}' and another observer with the label '{label}', expected different "
                    f'labels; write [observers.LABEL] use = "{short(name)}".'
                )
            references[label] = name
        elif label not in references and base_of(label) is None and (plugin := find_plugins("observer").get(label)):
            references[label] = plugin.reference
        out.append(label)
    return out


def _options(tables: TomlTable, options: object, references: dict[str, str], where: str) -> TomlTable:
    """Return the options of a study whose observers are tables; those that are user-defined are added to `references`."""
    out = dict(options) if isinstance(options, dict) else {}
    for label, table in tables.items():
        place = f"{where}: observers.{short(label)}"
        if not isinstance(table, dict):
            raise UserError(
                f"{place}: got {brief_repr(table)}, expected a table with `use` and options; write [observers.{label}]."
            )
        values = dict(table)
        if (text := values.pop("use", None)) is not None:
            if not isinstance(text, str):
                raise UserError(f'{place}.use: got {brief_repr(text)}, expected MODULE:NAME such as "mine.py:nudge".')
            if user_code.is_reference(text):
                user_code.split(text, f"{place}.use")
                _require_free(label, text, where)
                references[label] = text
            elif text in OBSERVERS and label != text and not label.startswith(text + "-"):
                raise UserError(
                    f"{place}.use: got '{text}', expected a label that begins with it; write [observers.{text}-{label}]."
                )
        if values and label in out:
            raise UserError(f"{place}: got options here and in options.{label}, expected them once; remove one.")
        if values:
            out[label] = values
    return out


def _require_free(label: str, name: str, where: str) -> None:
    """Raise UserError if a label is invalid or a built-in name."""
    if not LABEL.fullmatch(label):
        raise UserError(
            f"{where}: got the label '{short(label)}', expected letters, digits, '-', '_', '.' or '+', at most "
            f"{MAX_LABEL_LENGTH}; write another."
        )
    if label in OBSERVERS or label in ("scenario", "target"):
        raise UserError(
            f"{where}: got '{short(name)}' as '{label}', which is pcbench's own name; expected another label; write "
            f'[observers.my-{label}] use = "{short(name)}".'
        )


LTI = "lti"  # the scenario of a study's linear plant


def title_of_scenario(study: Study, scenario: str) -> str:
    """Return a scenario's title in tables and figures: the study's name for its own linear plant."""
    return study.name if scenario == LTI else scenario


def scenarios_of(study: Study, where: str | None = None) -> dict[str, Scenario]:
    """Return every scenario that a study may name: built-in, `lti` for its linear plant, and its own.

    If the study has a controller, it closes the loops of the named scenarios.
    """
    scenarios, where = SCENARIOS, where or study.name
    if study.lti is not None:
        scenarios = scenarios | {LTI: study.lti.scenario(LTI, f"{where}: lti")}
    if study.scenario is not None:
        name = study.scenario.name or study.name
        scenarios = scenarios | {name: scenario_of(study.scenario, name, f"{where}: scenario", study._plugins)}
    for name, table in (study.tables or {}).items():
        scenarios = scenarios | {name: scenario_of(table, name, f"{where}: scenarios.{name}", study._plugins)}
    if study.controller is None:
        return scenarios
    names = [name for name in study.scenarios if name in scenarios]
    return scenarios | {
        name: close_loop(scenarios[name], study.controller, f"{where}: controller", study._plugins) for name in names
    }


def labels_of(study: Study) -> list[str]:
    """Return every label of an observer: its name, or name-suffix if the study or a scenario has options for it."""
    scenario_labels = [key for s in scenarios_of(study).values() if s.name in study.scenarios for key in s.options]
    variants = (key for key in [*scenario_labels, *study.options] if base_in(study, key) is not None)
    return list(dict.fromkeys([*study.custom_observers, *OBSERVERS, *variants]))


def base_in(study: Study, label: str) -> str | None:
    """Return the observer of a label in a study, user-defined ones first: its name, or name-suffix."""
    names = [name for name in study.custom_observers if label == name or label.startswith(name + "-")]
    return max(names, key=len) if names and label.isprintable() and len(label) <= MAX_LABEL_LENGTH else base_of(label)


def plugin_in(study: Study, label: str) -> UserPlugin | None:
    """Return the user-defined observer of a label in a study; None if it is built-in."""
    return study._plugins.get(base_in(study, label) or label)


def entry_in(study: Study, label: str) -> ObserverSpec:
    """Return the entry of an observer's label in a study; raise KeyError if there is none."""
    plugin = plugin_in(study, label)
    return plugin.entry if plugin else OBSERVERS[base_in(study, label) or label]


def observers_of(study: Study, scenario: str) -> list[str]:
    """Return the observers that run in a scenario: the study's, or else the scenario's own."""
    return list(study.observers or scenarios_of(study)[scenario].observers)
