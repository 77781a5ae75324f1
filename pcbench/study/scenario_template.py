"""A scenario as a study file: a table `[scenario]` with every field, its unit and its meaning."""

import json
import re
from collections.abc import Mapping

from pcbench.errors import UserError
from pcbench.scenarios import INTERVAL, NOTHING, Scenario
from pcbench.scenarios.scenario import RECORD_OF, RECORDS
from pcbench.scenarios.sources import Source, Wave
from pcbench.study.scenario_schema import ScenarioTable
from pcbench.toml_text import TomlTable

TITLES = {
    "truth": "true values, which the design of observers does not use",
    "loop": "input and controller",
    "sampling": "measurements",
    "belief": "assumed values",
    "scoring": "metrics",
}
FIRST = ("summary", "source", "plant", "observers", "dt", "duration")


def as_study(s: Scenario, axes: Mapping[str, object] = NOTHING, options: Mapping[str, TomlTable] = NOTHING) -> str:
    """Return a study of one scenario with its `axes` and `options`, as TOML that gives the numbers of `s`.

    Raises UserError for a scenario of a study's table [lti].
    """
    if s.plant == "lti":
        raise UserError(
            f"show {s.name}: got a plant of a study's table [lti], expected a built-in plant; edit that table instead."
        )
    lines = [f"name = {toml_value('my-' + s.name.replace('/', '-'))}", "seeds = 256", "", "[scenario]"]
    lines += [_line(s, key) for key in FIRST]
    for record, fields in RECORDS.items():
        keys = [key for key in fields if key in ScenarioTable.model_fields and s.value(key) is not None]
        lines += ["", f"# {TITLES[record]}", *(_line(s, key) for key in keys)]
    tables = {f"scenario.options.{key_of(label)}": table for label, table in s.options.items()}
    tables |= {f"options.{key_of(label)}": table for label, table in options.items()}
    for name, table in (tables | ({"axes": axes} if axes else {})).items():
        lines += ["", f"[{name}]", *(f"{key_of(key)} = {toml_value(value)}" for key, value in table.items())]
    return "\n".join(lines) + "\n"


def _line(s: Scenario, key: str) -> str:
    """Return one key with its value and its meaning; as a comment if the value is the default."""
    value, description, record = s.value(key), ScenarioTable.model_fields[key].description, RECORD_OF.get(key)
    default = getattr(s, record)._field_defaults if record and key != "steady_start" else {}
    if key in ("input", "unknown_input") and not isinstance(value, str):
        sources = [_source(source) for source in value]
        text = toml_value(sources if len(sources) > 1 else sources[0])
    elif key in ("signals", "unknowns"):
        text = toml_value([f"{name} [{unit}]" for name, unit in value])
    else:
        text = toml_value(INTERVAL if key == "delay" and set(value) == {INTERVAL} else value)
    return f"{'# ' if key in default and value == default[key] else ''}{key} = {text}  # {description}"


def _source(source: Source) -> object:
    """Return a wave as a table, and a table as rows."""
    if isinstance(source, Wave):
        return {"signal": source.shape} | {k: v for k, v in source._asdict().items() if k != "shape" and v != ""}
    return source if isinstance(source, str) else [[t, *u] for t, u in zip(source.t, source.u, strict=True)]


def toml_value(value: object) -> str:
    """Return a value as TOML on one line, with numbers in full precision."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{key_of(key)} = {toml_value(v)}" for key, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(toml_value(v) for v in value)}]"
    return repr(value)


def key_of(name: str) -> str:
    """Return a name as a key of TOML: in quotes unless it has letters, digits, `-` and `_` only."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else toml_value(name)
