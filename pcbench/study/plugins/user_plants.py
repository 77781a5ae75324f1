"""Plants of a user's own where their code is not asked for: a result is read by what it says of them.

`study.toml` holds the facts of each: names, units, sizes, the linear model at the operating point. No run can be made of them.
"""

from collections import namedtuple
from typing import Any

import numpy as np

from pcbench.dynamics.linear import Model
from pcbench.errors import UserError
from pcbench.plants import PlantSpec
from pcbench.protocols import Plant
from pcbench.signal_names import pair
from pcbench.study.plugins.user_code import Code, Own
from pcbench.study.plugins.user_observers import ABSENT

FUNCTIONS = ("model", "successor", "sensor")  # those that observers are told, where a plant has them
LINEAR = ("A", "B", "C", "D", "E")


def facts(entry: PlantSpec) -> dict[str, Any]:
    """Return what a dataset says of a plant, as TOML has words for it."""
    linear = entry.nominal(entry.numbers)
    said = {name: np.asarray(getattr(linear, name)).tolist() for name in LINEAR if getattr(linear, name) is not None}
    rest = {} if entry.residual is None else {"residual": np.asarray(entry.residual(entry.numbers)).tolist()}
    return {
        "summary": entry.summary,
        "signals": [list(each) for each in entry.signals],
        "unknowns": [list(each) for each in entry.unknowns],
        "numbers": {name: _listed(value) for name, value in entry.numbers._asdict().items()},
        "positive": list(entry.positive),
        "drifts": entry.drifts,
        "discrete": linear.discrete,
        "field": entry.plant.field is not None,
        "functions": [name for name in FUNCTIONS if getattr(entry, name) is not None],
        "linear": said,
        **rest,
    }


def _listed(value: Any) -> Any:
    return [_listed(each) for each in value] if isinstance(value, tuple) else value


def _tuples(value: Any) -> Any:
    return tuple(_tuples(each) for each in value) if isinstance(value, list) else value


def absent(reference: str, code: Code, known: dict[str, Any]) -> Own:
    """Return what stands for a plant of which only the facts are known."""

    def nothing(*given: Any) -> Any:
        raise UserError(f"{reference}: got no code, expected it where runs are made; run the study that names it.")

    linear: Any = {name: np.array(value, float) for name, value in known["linear"].items()}
    model = Model(**linear, discrete=known["discrete"])
    rest = np.array(known["residual"]) if "residual" in known else None
    numbers = namedtuple("Numbers", known["numbers"])(**{k: _tuples(v) for k, v in known["numbers"].items()})  # type: ignore[misc]
    told = {name: nothing if name in known["functions"] else None for name in FUNCTIONS}
    there = PlantSpec(
        plant=Plant(step=nothing, output=nothing, field=nothing if known["field"] else None),
        signals=tuple(pair(name, unit, reference) for name, unit in known["signals"]),
        numbers=numbers,
        nominal=lambda numbers: model,
        prepare=nothing,
        summary=ABSENT,
        unknowns=tuple(pair(name, unit, reference) for name, unit in known["unknowns"]),
        model=told["model"],
        successor=told["successor"],
        sensor=told["sensor"],
        positive=tuple(known["positive"]),
        drifts=known["drifts"],
        residual=None if rest is None else lambda numbers: rest,
    )
    return Own(there, code)
