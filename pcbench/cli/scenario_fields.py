"""The fields of a scenario as data, for `pcbench show`: those that are not at their defaults."""

from collections.abc import Mapping
from typing import Any

from pcbench.scenarios import Scenario
from pcbench.scenarios.scenario import RECORDS
from pcbench.scenarios.sources import Table, Wave

SAID = {  # fields of a scenario that `sheet` names itself
    *("sampling_period", "delay", "noise_std", "steady_start", "controller"),
    *("settle_band", "divergence_threshold", "signals", "unknowns"),
}


def not_at_default(s: Scenario) -> dict[str, Any]:
    """Return the fields that are not at their defaults, but those that `catalogue.sheet` names itself, and the options."""
    out: dict[str, Any] = {}
    for record, fields in RECORDS.items():
        usual = type(getattr(s, record))._field_defaults
        for name in fields:
            value = s.value(name)
            if name not in SAID and value != usual.get(name, ()):
                out[name] = _data(value)
    return out | ({"observer_options": _data(s.options)} if s.options else {})


def _data(value: Any) -> Any:
    """A value of a scenario as lists and dicts: of a wave what it says, of a table of inputs how many rows it has."""
    if isinstance(value, Wave):
        return {name: each for name, each in value._asdict().items() if each != value._field_defaults.get(name, "")}
    if isinstance(value, Table):
        return f"a table of {len(value.t):,} rows"
    if isinstance(value, Mapping):
        return {name: _data(each) for name, each in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_data(each) for each in value] if isinstance(value, tuple | list) else value
