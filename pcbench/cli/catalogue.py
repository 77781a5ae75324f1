"""What `pcbench list` says of everything there is: as data, for a program and for the screen."""

from collections.abc import Callable, Mapping
from inspect import get_annotations
from typing import Any

from pydantic import BaseModel

from pcbench import controllers, observers, plants
from pcbench.cli.scenario_fields import not_at_default
from pcbench.controllers import CONTROLLERS
from pcbench.dataset.columns import AXIS_UNITS, MEANING
from pcbench.errors import unknown
from pcbench.observers import OBSERVERS
from pcbench.observers.parts.options import TUNABLE, extra
from pcbench.plants import PLANTS, parameters_in, parameters_of
from pcbench.plants import signals_of as signals_in
from pcbench.scenarios import INTERVAL, SCENARIOS, Scenario
from pcbench.statistics import POOLED, RUN_METRICS
from pcbench.study import STUDIES, Choices, Study, observers_of, parse
from pcbench.study.axes import AXES, axes_of
from pcbench.study.plugins import registry, user_code

TAKES = {
    "any schedule": "of any age, in any order, from clocks of their own",
    "one clock": "of any age, in any order; all channels together",
    "one constant delay": "of one constant age",
    "constant delays": "taken regularly, all channels together; each channel of a constant age of its own",
}
Description = dict[str, Any]


def plant(name: str) -> Description:
    """Return a plant with its states, unknown inputs, and parameters."""
    return plant_of(PLANTS[name])


def plant_of(p: plants.PlantSpec) -> Description:
    """Return any plant likewise."""
    return {
        "summary": p.summary,
        "signals": [{"name": s, "unit": u} for s, u in p.signals] or "the study's",
        "unknown": [{"name": s, "unit": u} for s, u in p.unknowns],
        "parameters": {k: getattr(p.numbers, k) for k in parameters_of(p)},
    }


def observer(name: str) -> Description:
    """Return an observer with the samples it takes and its options."""
    return observer_of(OBSERVERS[name])


def observer_of(o: observers.ObserverSpec) -> Description:
    """Return any observer likewise."""
    return {
        "summary": o.summary,
        "knows_schedule": o.knows_schedule,
        "samples": TAKES[o.takes],
        "plants": "nonlinear ones too" if o.nonlinear else "linear",
        "options": options(o.options),
    }


def controller(name: str) -> Description:
    """Return a controller with its options, of a study's table [controller]."""
    return controller_of(CONTROLLERS[name])


def controller_of(c: controllers.ControllerSpec) -> Description:
    """Return any controller likewise, its own options before those that all laws have."""
    said, mine = options(c.options), get_annotations(c.options)
    order = sorted(said, key=lambda name: name not in mine)
    return {"summary": c.summary, "table": "[controller]", "options": {name: said[name] for name in order}}


def options(model: type[BaseModel]) -> dict[str, Description]:
    """Return every option of a model: type, default, range, what it is, and whether it can be tuned."""
    properties = model.model_json_schema()["properties"]
    return {
        name: {
            **_kind(properties[name]),
            "default": properties[name].get("default"),
            "description": field.description or "",
            "tunable": TUNABLE in extra(field),
        }
        for name, field in model.model_fields.items()
    }


def _kind(schema: Mapping[str, Any]) -> Description:
    """The type of an option in words, and its range or its choices."""
    schema = next((each for each in schema.get("anyOf", []) if each.get("type") != "null"), schema)
    if "enum" in schema:
        return {"type": "choice", "choices": schema["enum"]}
    above, least = schema.get("exclusiveMinimum"), schema.get("minimum")
    low = f"> {above:g}" if above is not None else f">= {least:g}" if least is not None else None
    most = schema.get("maximum")
    ends = " and ".join(filter(None, (low, f"<= {most:g}" if most is not None else None)))
    return {"type": _type(schema), "range": ends or None}


def _type(schema: Mapping[str, Any]) -> str:
    kind = schema.get("type", "value")
    if kind == "array":
        inner = schema.get("items", {}).get("type", "value")
        return "matrix" if inner == "array" else f"list of {inner}s"
    return {"boolean": "true or false", "object": "table", "integer": "whole number", "string": "text"}.get(kind, kind)


def scenario(name: str) -> Description:
    """Return a published scenario with its plant, its times, its observers and its source."""
    return sheet(SCENARIOS[name])


def sheet(s: Scenario, study: Study | None = None) -> Description:
    """Return any scenario likewise, with every field that is not as usual; of a `study` with its observers and axes."""
    signals = signals_in(s)
    bounds = (
        (s.scoring.divergence_threshold,) * len(signals)
        if isinstance(s.scoring.divergence_threshold, float)
        else s.scoring.divergence_threshold
    )
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
        **not_at_default(s),
        "axes": [*axes_of(s), *(f"plant.{p}" for p in parameters_in(s))],
    }


def study(name: str) -> Description:
    """Return a built-in study."""
    s = STUDIES[name]
    return {
        "summary": ", ".join(s.scenarios) if len(s.scenarios) < 4 else f"{len(s.scenarios)} scenarios",
        "scenarios": s.scenarios,
        "observers": s.observers or "each scenario's own",
        "seeds": s.seeds,
        "axes": s.axes,
        "tuning": s.tuning,
    }


def metric(name: str) -> Description:
    """Return what a metric means."""
    return {"summary": MEANING.get(name) or METRICS[name]}


def axis(name: str) -> Description:
    """Return what an axis of a study holds."""
    unit = AXIS_UNITS.get(name, "s")
    return {"summary": MEANING[name] + (f" [{unit}]" if unit not in ("", "1") else "")}


def choice(name: str) -> Description:
    """Return a choice of `[options.scenario]`."""
    said = options(Choices)[name]
    return {"summary": said["description"]} | said


METRICS = {
    "pooled_rmse": "square root of the mean of e^2 over ticks and runs: it weighs bad runs more than the mean of rmse does",
    "steady_pooled_rmse": "the same from the tail start on",
    "rms_efficiency": "the least steady_pooled_rmse that any causal estimator can have, on average over x(0), over the "
    "observer's",
    "divergence_rate": "fraction of runs whose error became non-finite or left the scenario's divergence threshold",
    "unsettled_rate": "fraction of the other runs whose error left its band in the tail",
}
CATALOGUE: dict[str, tuple[tuple[str, ...], Callable[[str], Description]]] = {
    "observers": (tuple(OBSERVERS), observer),
    "scenarios": (tuple(SCENARIOS), scenario),
    "plants": (tuple(PLANTS), plant),
    "controllers": (tuple(CONTROLLERS), controller),
    "studies": (tuple(STUDIES), study),
    "axes": (AXES, axis),
    "metrics": ((*RUN_METRICS, *POOLED, "rms_efficiency", "divergence_rate", "unsettled_rate"), metric),
    "choices": (tuple(Choices.model_fields), choice),
}
OWN: dict[str, tuple[str, Callable[[Any], Description]]] = {  # kinds of what may be a user's own
    "observers": ("observer", observer_of),
    "plants": ("plant", plant_of),
    "controllers": ("controller", controller_of),
}
WITHOUT_WORD = ("observers", "scenarios", "plants", "controllers", "studies")  # what `pcbench list` alone names
TITLES = {"choices": "choices ([options.scenario] of a study)", "axes": "axes (besides plant.PARAMETER)"}


def found(kind: str, name: str | None = None) -> dict[str, Description]:
    """Return what there is of a kind, by name, or the one of that name; raise UserError for another word."""
    if kind not in CATALOGUE:
        raise unknown("list", "kind of thing", kind, CATALOGUE)
    names, say = CATALOGUE[kind]
    there = registry.installed(kind.removesuffix("s"))
    if name is None:
        return {each: say(each) for each in names} | {each: _offered(offer) for each, offer in there.items()}
    if name in names:
        return {name: say(name)}
    if name in there or user_code.is_reference(name):
        return {name: _own(kind, there[name].reference if name in there else name)}
    raise unknown(f"list {kind}", "name there (or MODULE:NAME)", name, [*names, *there])


def _offered(offer: registry.Installed) -> Description:
    """What is said of something that an installed package offers, without its code."""
    return {"summary": f"of the package {offer.package}", "use": offer.reference}


def _own(kind: str, reference: str) -> Description:
    """What is said of a user's own by its code."""
    where = f"list {kind}"
    if kind == "scenarios":
        return sheet(parse.scenario_of(reference))
    if kind not in OWN:
        raise unknown(where, "name there", reference, CATALOGUE[kind][0])
    singular, say = OWN[kind]
    return say(registry.load(singular, reference, where).entry)
