"""What `pcbench list` says of everything there is."""

from collections.abc import Callable
from typing import Any

from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES

Rows = dict[str, tuple[str, ...]]
Listed = tuple[tuple[str, ...], Rows]


def plants() -> Listed:
    """Return every plant with its states and units."""
    rows: Rows = {
        name: (
            p.summary,
            ", ".join(f"{s} [{u}]" for s, u in p.signals),
            ", ".join(f"{k} {v:g}" for k, v in _numbers(p)),
        )
        for name, p in PLANTS.items()
    }
    return ("plant", "what", "states", "parameters (axes plant.*)"), rows


def observers() -> Listed:
    """Return every observer with its options and whether it knows the schedule."""
    rows: Rows = {}
    for name, o in OBSERVERS.items():
        options = ", ".join(f"{f.replace('_', '-')} ({v.description})" for f, v in o.options.model_fields.items())
        rows[name] = (o.summary, "yes" if o.knows_schedule else "no", options or "none")
    return ("observer", "what", "knows the schedule", "options"), rows


def scenarios() -> Listed:
    """Return every scenario with its plant, observers and source."""
    rows: Rows = {}
    for name, s in SCENARIOS.items():
        units = [unit for _, unit in PLANTS[s.plant].signals]
        band = ", ".join(f"{b:g} {unit}" for b, unit in zip(s.settle_band, units, strict=True))
        times = f"{s.horizon:g} s, tail from {s.tail:g} s; settled within {band}; diverged beyond {s.bound:g}"
        rows[name] = (s.summary, times, ", ".join(s.observers), s.source)
    return ("scenario", "what", "horizon and bands", "observers", "source"), rows


def studies() -> Listed:
    """Return every built-in study."""
    return ("study", "scenarios", "seeds"), {n: (", ".join(s.scenarios), str(s.seeds)) for n, s in STUDIES.items()}


def _numbers(plant: Any) -> list[tuple[str, float]]:
    return [(k, v) for k, v in plant.numbers._asdict().items() if not k.startswith("drift")]


CATALOGUE: dict[str, Callable[[], Listed]] = {
    "plants": plants,
    "observers": observers,
    "scenarios": scenarios,
    "studies": studies,
}
