"""What `pcbench list` says of everything there is."""

from collections.abc import Callable

from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS, parameters_of, signals_of
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES

TAKES = {
    "any schedule": "of any age, in any order, from clocks of their own",
    "one clock": "of any age, in any order; all channels together",
    "one constant delay": "of one constant age",
    "constant delays": "taken regularly, all channels together; each channel of a constant age of its own",
}
Rows = dict[str, tuple[str, ...]]
Listed = tuple[tuple[str, ...], Rows]


def plants() -> Listed:
    """Return every plant with its states, unknown inputs, and their units."""
    rows: Rows = {
        name: (
            p.summary,
            ", ".join(f"{s} [{u}]" for s, u in (*p.signals, *p.unknowns)) or "the study's",
            ", ".join(f"{k} {getattr(p.numbers, k):g}" for k in parameters_of(name)),
        )
        for name, p in PLANTS.items()
    }
    return ("plant", "what", "signals", "parameters (axes plant.*)"), rows


def observers() -> Listed:
    """Return every observer with its options and whether it knows the schedule."""
    rows: Rows = {}
    for name, o in OBSERVERS.items():
        options = ", ".join(f"{f.replace('_', '-')} ({v.description})" for f, v in o.options.model_fields.items())
        rows[name] = (o.summary, "yes" if o.knows_schedule else "no", TAKES[o.takes], options or "none")
    return ("observer", "what", "knows the schedule", "samples it takes", "options"), rows


def scenarios() -> Listed:
    """Return every scenario with its plant, observers and source."""
    rows: Rows = {}
    for name, s in SCENARIOS.items():
        units = [unit for _, unit in signals_of(s)]
        band = ", ".join(f"{b:g} {unit}" for b, unit in zip(s.settle_band, units, strict=True))
        bounds = (s.bound,) * len(units) if isinstance(s.bound, float) else s.bound
        bound = ", ".join(f"{b:g} {unit}" for b, unit in zip(bounds, units, strict=True))
        times = f"{s.horizon:g} s, tail from {s.tail:g} s; settled within {band}; diverged beyond {bound}"
        rows[name] = (s.summary, times, ", ".join(s.observers), s.source)
    return ("scenario", "what", "horizon and bands", "observers", "source"), rows


def studies() -> Listed:
    """Return every built-in study."""
    rows: Rows = {}
    for name, s in STUDIES.items():
        axes = "; ".join(f"{axis} {', '.join(map(str, values))}" for axis, values in s.axes.items())
        rows[name] = (", ".join(s.scenarios), axes or "none", str(s.seeds))
    return ("study", "scenarios", "axes", "seeds"), rows


CATALOGUE: dict[str, Callable[[], Listed]] = {
    "plants": plants,
    "observers": observers,
    "scenarios": scenarios,
    "studies": studies,
}
