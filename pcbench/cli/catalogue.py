"""The lists and descriptions of `pcbench list`, as data."""

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
from pcbench.observers.parts.options import TUNABLE, option_metadata
from pcbench.plants import PLANTS, drifts, parameters_in, parameters_of
from pcbench.plants import signals_of as signals_in
from pcbench.scenarios import INTERVAL, SCENARIOS, Scenario
from pcbench.scenarios.scenario import RECORDS
from pcbench.scenarios.sources import Table, Wave
from pcbench.statistics import RUN_METRICS
from pcbench.study import STUDIES, Choices, Study, observers_of, parse
from pcbench.study.axes import AXES, COMMANDS, axes_of
from pcbench.study.builtin import QUESTIONS
from pcbench.study.fits import RANDOM_AXES
from pcbench.study.plugins import registry, user_code

TAKES = {
    "any schedule": "any delay and order; each channel can have its own schedule",
    "one clock": "any delay and order; all channels with the same schedule",
    "one constant delay": "one constant delay",
    "constant delays": "regular samples of all channels; one constant delay per channel",
}
NAMED = {  # fields of a scenario with their own key in its description
    *("sampling_period", "delay", "noise_std", "steady_start", "controller"),
    *("settle_band", "divergence_threshold", "signals", "unknowns"),
}
# axes that have an effect only with one of RANDOM_AXES
WITH_RANDOM_AXES = ("delay_self_transition", "delay_weights", "delay_gamma_shape", "mean_burst_length")
Description = dict[str, Any]


def plant(p: plants.PlantSpec) -> Description:
    """Describe a plant: states, unknown inputs and parameters."""
    return {
        "summary": p.summary,
        "signals": [{"name": s, "unit": u} for s, u in p.signals] or "defined by the study",
        "unknown": [{"name": s, "unit": u} for s, u in p.unknowns],
        "errors": [{"name": s, "unit": u} for s, u in p.errors],
        "parameters": {k: getattr(p.numbers, k) for k in parameters_of(p)},
    }


def observer(o: observers.ObserverSpec) -> Description:
    """Describe an observer: the samples that it accepts, and its options."""
    return {
        "summary": o.summary,
        "knows_schedule": o.knows_schedule,
        "samples": TAKES[o.takes],
        "plants": "linear and nonlinear" if o.nonlinear else "linear, or linearised at an equilibrium",
        **facts.observer_facts(o),
        "options": options(o.options),
    }


def controller(c: controllers.ControllerSpec) -> Description:
    """Describe a controller: the options of the table [controller], its own before those of all controllers."""
    by_name, annotations = options(c.options), get_annotations(c.options)
    order = sorted(by_name, key=lambda name: name not in annotations)
    return {"summary": c.summary, "table": "[controller]", "options": {name: by_name[name] for name in order}}


def options(model: type[BaseModel]) -> dict[str, Description]:
    """Describe each option of a model: type, default, range, meaning, and whether it can be tuned."""
    properties = model.model_json_schema()["properties"]
    return {
        name: {
            **facts.option_type(properties[name]),
            "default": properties[name].get("default"),
            "description": field.description or "",
            "tunable": TUNABLE in option_metadata(field),
            **({"required": True} if field.is_required() else {}),
        }
        for name, field in model.model_fields.items()
    }


def scenario(s: Scenario, study: Study | None = None) -> Description:
    """Describe a scenario: plant, times, source and each field that differs from its default.

    With a `study`: the study's observers and axes.
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
        "axes": [*accepted_axes(s), *(f"plant.{p}" for p in parameters_in(s))],
    }


def accepted_axes(s: Scenario) -> list[str]:
    """Return the axes that a scenario accepts for at least one value, without its plant's parameters."""
    excluded = set() if drifts(s) else {"parameter_drift"}
    if s.sampling.continuous:
        excluded |= {*RECORDS["sampling"], *RECORDS["belief"]}
    if s.loop.controller and s.sampling.prefilled:  # its schedule is the same for all runs
        excluded |= {*RANDOM_AXES, *WITH_RANDOM_AXES, "delay_sequence"}
    return [name for name in axes_of(s) if name not in excluded]


def _data(value: object) -> object:
    """Return a value of a scenario as lists and dicts; for a table of inputs only its number of rows."""
    if isinstance(value, Wave):
        return {name: v for name, v in value._asdict().items() if v != value._field_defaults.get(name, "")}
    if isinstance(value, Table):
        return f"a table of {len(value.t):,} rows"
    if isinstance(value, Mapping):
        return {name: _data(v) for name, v in value.items()}
    if hasattr(value, "tolist"):
        return value.tolist()
    return [_data(v) for v in value] if isinstance(value, tuple | list) else value


def study(s: Study) -> Description:
    """Describe a built-in study."""
    return {
        "summary": QUESTIONS[s.name],
        "scenarios": s.scenarios,
        "observers": s.observers or "each scenario's own",
        "seeds": s.seeds,
        "axes": s.axes,
        "tuning": s.tuning,
    }


def axis(name: str) -> Description:
    """Describe an axis of a study."""
    unit = AXIS_UNITS.get(name, "s")
    return {"summary": MEANING[name] + (f" [{unit}]" if unit not in ("", "1") else ""), **facts.axis_facts(name)}


METRICS = {name: MEANING[name] for name in RUN_METRICS if name in MEANING} | {
    "pooled_rmse": "square root of the mean of e^2 over ticks and runs; it weights bad runs more than the mean of rmse does",
    "steady_pooled_rmse": "the same as pooled_rmse, from steady_start on",
    "rms_efficiency": "the Kalman bound divided by steady_pooled_rmse; 1 is best. The bound is the least steady_pooled_rmse of "
    "any causal estimator, on average over x(0)",
    "divergence_rate": "fraction of runs whose error became non-finite or exceeded the scenario's divergence threshold",
    "unsettled_rate": "fraction of the other runs whose error left its band after steady_start",
}
METRICS |= facts.FURTHER_METRICS
# by kind: the members, and the function that describes one
CATALOGUE: dict[str, tuple[Mapping[str, Any], Callable[[Any], Description]]] = {
    "observers": (OBSERVERS, observer),
    "scenarios": (SCENARIOS, scenario),
    "plants": (PLANTS, plant),
    "controllers": (CONTROLLERS, controller),
    "studies": (STUDIES, study),
    "axes": ({name: name for name in (*AXES, *COMMANDS)}, axis),
    "metrics": ({name: name for name in METRICS}, lambda name: {"summary": METRICS[name], **facts.metric_facts(name)}),
    "choices": (options(Choices), lambda option: {"summary": option["description"]} | option),
}
USER_KINDS = ("observers", "plants", "controllers", "scenarios")  # kinds that a user can define
DEFAULT_KINDS = ("observers", "scenarios", "plants", "controllers", "studies")  # kinds that `pcbench list` shows
TITLES = {"choices": "choices (keys of [options.scenario])", "axes": "axes (in addition to plant.PARAMETER)"}
SINGULAR = {"studies": "study", "axes": "axis"}


def list_catalogue(kind: str, name: str | None = None) -> dict[str, Description]:
    """Return the descriptions of a kind by name, or the one with that name; raise UserError for an unknown kind or name."""
    if kind not in CATALOGUE:
        raise unknown("list", "kind to list", kind, CATALOGUE)
    members, describe = CATALOGUE[kind]
    singular = SINGULAR.get(kind, kind.removesuffix("s"))
    plugins = registry.find_plugins(singular)
    if name is None:
        packages = {
            key: {"summary": f"from the package {offer.package}", "use": offer.reference}
            for key, offer in plugins.items()
        }
        return {key: describe(member) for key, member in members.items()} | packages
    if name in members:
        return {name: describe(members[name])}
    reference = plugins[name].reference if name in plugins else name
    if not user_code.is_reference(reference):
        raise unknown(f"list {kind}", f"{singular} (or MODULE:NAME)", name, [*members, *plugins])
    if kind not in USER_KINDS:
        raise unknown(f"list {kind}", singular, reference, members)
    if kind == "scenarios":
        return {name: describe(parse.scenario_of(reference))}
    return {name: describe(registry.load(singular, reference, f"list {kind}").entry)}
