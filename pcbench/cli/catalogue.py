"""What `pcbench list` says of everything there is: as data, for a program and for the screen."""

from collections.abc import Callable, Mapping
from inspect import get_annotations
from typing import Any

from pydantic import BaseModel

from pcbench import controllers, observers, plants
from pcbench.cli import facts
from pcbench.controllers import CONTROLLERS
from pcbench.dataset.columns import AXIS_UNITS, MEANING
from pcbench.errors import unknown
from pcbench.observers import OBSERVERS
from pcbench.observers.parts.options import TUNABLE, extra
from pcbench.plants import PLANTS, parameters_in, parameters_of
from pcbench.plants import signals_of as signals_in
from pcbench.scenarios import INTERVAL, SCENARIOS, Scenario
from pcbench.scenarios.scenario import RECORDS
from pcbench.scenarios.sources import Table, Wave
from pcbench.statistics import RUN_METRICS
from pcbench.study import STUDIES, Choices, Study, observers_of, parse
from pcbench.study.axes import AXES, COMMANDS, axes_of
from pcbench.study.plugins import registry, user_code

TAKES = {
    "any schedule": "of any age, in any order, from clocks of their own",
    "one clock": "of any age, in any order; all channels together",
    "one constant delay": "of one constant age",
    "constant delays": "taken regularly, all channels together; each channel of a constant age of its own",
}
NAMED = {  # fields of a scenario that its description names itself
    *("sampling_period", "delay", "noise_std", "steady_start", "controller"),
    *("settle_band", "divergence_threshold", "signals", "unknowns"),
}
Description = dict[str, Any]


def plant(p: plants.PlantSpec) -> Description:
    """Return a plant with its states, unknown inputs, and parameters."""
    return {
        "summary": p.summary,
        "signals": [{"name": s, "unit": u} for s, u in p.signals] or "the study's",
        "unknown": [{"name": s, "unit": u} for s, u in p.unknowns],
        "errors": [{"name": s, "unit": u} for s, u in p.errors],
        "parameters": {k: getattr(p.numbers, k) for k in parameters_of(p)},
    }


def observer(o: observers.ObserverSpec) -> Description:
    """Return an observer with the samples it takes and its options."""
    return {
        "summary": o.summary,
        "knows_schedule": o.knows_schedule,
        "samples": TAKES[o.takes],
        "plants": "nonlinear ones too" if o.nonlinear else "linear",
        **facts.observer_facts(o),
        "options": options(o.options),
    }


def controller(c: controllers.ControllerSpec) -> Description:
    """Return a controller with its options, of a study's table [controller]: its own before those that all laws have."""
    every, own = options(c.options), get_annotations(c.options)
    order = sorted(every, key=lambda name: name not in own)
    return {"summary": c.summary, "table": "[controller]", "options": {name: every[name] for name in order}}


def options(model: type[BaseModel]) -> dict[str, Description]:
    """Return every option of a model: type, default, range, what it is, and whether it can be tuned."""
    properties = model.model_json_schema()["properties"]
    return {
        name: {
            **facts.option_type(properties[name]),
            "default": properties[name].get("default"),
            "description": field.description or "",
            "tunable": TUNABLE in extra(field),
            **({"required": True} if field.is_required() else {}),
        }
        for name, field in model.model_fields.items()
    }


def scenario(s: Scenario, study: Study | None = None) -> Description:
    """Return a scenario with its plant, its times, its source and every field that is not as usual.

    Of a `study` with the study's observers and axes.
    """
    signals, bounds = signals_in(s), s.scoring.divergence_threshold
    if isinstance(bounds, float):
        bounds = (bounds,) * len(signals)
    return {
        "summary": s.summary,
        "source": s.source,
        "plant": s.plant,
        "loop": f"closed by {s.loop.controller}" if s.loop.controller else "open",
        "observers": list(s.observers) if study is None else observers_of(study, s.name),
        **({"axes_of_the_study": dict(study.axes)} if study is not None and study.axes else {}),
        "sampling_period": list(s.sampling.sampling_period),
        "delay": ["one interval" if d == INTERVAL else d for d in s.sampling.delay],
        "noise_std": list(s.sampling.noise_std),
        "tick": s.dt,
        "duration": s.duration,
        "steady_start": s.scoring.steady_start,
        "signals": [
            {"name": n, "unit": u, "settled_within": band, "diverged_beyond": bound}
            for (n, u), band, bound in zip(signals, s.scoring.settle_band, bounds, strict=True)
        ],
        **{
            name: _data(s.value(name))
            for record, fields in RECORDS.items()
            for name in fields
            if name not in NAMED and s.value(name) != type(getattr(s, record))._field_defaults.get(name, ())
        },
        **({"observer_options": _data(s.options)} if s.options else {}),
        "axes": [*axes_of(s), *(f"plant.{p}" for p in parameters_in(s))],
    }


def _data(value: object) -> object:
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


def study(s: Study) -> Description:
    """Return a built-in study."""
    return {
        "summary": ", ".join(s.scenarios) if len(s.scenarios) < 4 else f"{len(s.scenarios)} scenarios",
        "scenarios": s.scenarios,
        "observers": s.observers or "each scenario's own",
        "seeds": s.seeds,
        "axes": s.axes,
        "tuning": s.tuning,
    }


def axis(name: str) -> Description:
    """Return what an axis of a study holds."""
    unit = AXIS_UNITS.get(name, "s")
    return {"summary": MEANING[name] + (f" [{unit}]" if unit not in ("", "1") else ""), **facts.axis_facts(name)}


METRICS = {name: MEANING[name] for name in RUN_METRICS if name in MEANING} | {
    "pooled_rmse": "square root of the mean of e^2 over ticks and runs: it weighs bad runs more than the mean of rmse does",
    "steady_pooled_rmse": "the same from the tail start on",
    "rms_efficiency": "the least steady_pooled_rmse that any causal estimator can have, on average over x(0), over the "
    "observer's",
    "divergence_rate": "fraction of runs whose error became non-finite or left the scenario's divergence threshold",
    "unsettled_rate": "fraction of the other runs whose error left its band in the tail",
}
METRICS |= facts.FURTHER_METRICS
CATALOGUE: dict[
    str, tuple[Mapping[str, Any], Callable[[Any], Description]]
] = {  # by kind: what there is, described how
    "observers": (OBSERVERS, observer),
    "scenarios": (SCENARIOS, scenario),
    "plants": (PLANTS, plant),
    "controllers": (CONTROLLERS, controller),
    "studies": (STUDIES, study),
    "axes": ({name: name for name in (*AXES, *COMMANDS)}, axis),
    "metrics": ({name: name for name in METRICS}, lambda name: {"summary": METRICS[name], **facts.metric_facts(name)}),
    "choices": (options(Choices), lambda option: {"summary": option["description"]} | option),
}
OWN = ("observers", "plants", "controllers", "scenarios")  # kinds of what may be a user's own
WITHOUT_WORD = ("observers", "scenarios", "plants", "controllers", "studies")  # what `pcbench list` alone names
TITLES = {"choices": "choices ([options.scenario] of a study)", "axes": "axes (besides plant.PARAMETER)"}


def list_catalogue(kind: str, name: str | None = None) -> dict[str, Description]:
    """Return what there is of a kind, by name, or the one of that name; raise UserError for another word."""
    if kind not in CATALOGUE:
        raise unknown("list", "kind of thing", kind, CATALOGUE)
    members, describe = CATALOGUE[kind]
    installed = registry.find_plugins(kind.removesuffix("s"))
    if name is None:
        packages = {
            each: {"summary": f"of the package {offer.package}", "use": offer.reference}
            for each, offer in installed.items()
        }
        return {each: describe(member) for each, member in members.items()} | packages
    if name in members:
        return {name: describe(members[name])}
    reference = installed[name].reference if name in installed else name
    if not user_code.is_reference(reference):
        raise unknown(f"list {kind}", "name there (or MODULE:NAME)", name, [*members, *installed])
    if kind not in OWN:
        raise unknown(f"list {kind}", "name there", reference, members)
    if kind == "scenarios":
        return {name: describe(parse.scenario_of(reference))}
    return {name: describe(registry.load(kind.removesuffix("s"), reference, f"list {kind}").entry)}
