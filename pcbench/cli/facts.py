"""Facts of observers, axes, metrics and options that `pcbench list` prints and the reference pages of the guide contain."""

import re
from typing import Any

from pydantic import BaseModel

from pcbench.dataset.columns import unit_of
from pcbench.fields import FIELDS
from pcbench.observers import ObserverSpec
from pcbench.simulation.schedule.sampling import PROFILES
from pcbench.statistics import COMPARED
from pcbench.statistics.consistency import BANDS, INSIDE
from pcbench.study.axes import LARGEST
from pcbench.study.controller_table import Network
from pcbench.study.lti import Lti
from pcbench.study.scenario_schema import ScenarioTable

Description = dict[str, Any]
DEVIATIONS = ("one standard deviation", "two standard deviations", "three standard deviations")
SIGMAS = dict(zip(INSIDE, DEVIATIONS, strict=True))
FURTHER_METRICS = {
    **{
        name: f"fraction of runs whose error at tick N-1 is within {many} of the observer"
        for name, many in SIGMAS.items()
    },
    **{band: f"95 % band of the mean {name} for a correct covariance, as an interval" for name, band in BANDS.items()},
    **{
        f"{part}pooled_{name}": f"square root of the mean of the squared {part}{name} over runs"
        for part in ("", "steady_")
        for name in ("tracking_rmse", "input_rms")
    },
}
NEEDS = {  # by a part of a metric's name
    "nis": "an observer that reports innovations",
    "nees": "an observer that reports a covariance",
    "sigma": "an observer that reports a covariance",
    "interval": "an observer that bounds the state",
    "tracking": "a closed loop with a set point",
    "input_rms": "a closed loop with weights",
    "lq_cost": "a closed loop with weights",
    "recovery_time": "an unknown input that jumps",
    "rms_efficiency": "a Kalman bound above 0",
}
BEST = {
    "rms_efficiency": "1",
    "final_error": "0",
    "interval_coverage": "1",
    "interval_width": "the smallest with interval_coverage 1",
    **dict.fromkeys(BANDS, "1, the mean for a correct covariance"),
    **{name: f"{share} for a Gaussian error" for name, share in zip(INSIDE, (0.683, 0.954, 0.997), strict=True)},
}
PER = dict.fromkeys(("channel", "sensor", "output"), "or one per output channel")
PER |= {"state": "or one per state", "value": "or one per value of delay_values"}
WORDS = {
    "interval": 'or "interval"',
    "*": "or one of " + ", ".join(PROFILES),
    "lost": 'or "lost" instead of one of them',
    "inf": "or inf",
}
TYPES = {"boolean": "true or false", "integer": "whole number", "string": "text", "object": "table"}
ENDS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}


def observer_facts(o: ObserverSpec) -> Description:
    """Return the facts of an observer: its method in words, and what its functions and its record show."""
    facts = {
        "loops": "open and closed" if o.loops else "open",
        "needs_sampling_signal": o.observer.on_sample is not None,
        "covariance": o.observer.covariance is not None,
        "innovations": o.observer.innovation is not None,
        "bounds": o.observer.bounds is not None,
        "uses_stated_variance": o.measurement_noise,
        "tunes_by_gradient": o.smooth,
    }
    return facts | (o.method._asdict() if o.method else {})


def axis_facts(name: str) -> Description:
    """Return the facts of an axis: what a value is and may be, and which tables have it as a key."""
    (field,) = (f for f in FIELDS if f.name == name)
    tables: dict[str, type[BaseModel]] = {"lti": Lti, "scenario": ScenarioTable, "controller": Network}
    form = ["a list of numbers" if field.listed else "a number", PER.get(field.per, ""), WORDS.get(field.word, "")]
    form += ["or a list for each output channel (no axis)"] if field.rows else []
    least = "any number" if field.signed else "at least 0" if field.word != "*" else ""
    return {
        "value": ", ".join(filter(None, form)) + ("; whole ticks" if field.ticks else ""),
        "range": re.split("[;:]", field.limit.expected)[0].rstrip(".") if field.limit else least,
        "schedule": "random in each run" if field.random else "",
        "loops": "closed, with a [controller] table" if field.loop else "",
        "key_of": ["[axes]", *(f"[{table}]" for table, model in tables.items() if name in model.model_fields)],
    }


def metric_facts(name: str) -> Description:
    """Return the facts of a metric: unit, best value, what it needs, and whether it has an exact value."""
    from pcbench.moments.stats_rows import ORDER, RUNS_ONLY

    unit = unit_of(name, "unit of the signal")
    smaller = name in COMPARED or name.endswith(("rmse", "rms", "_rate"))
    exact = f"no: {RUNS_ONLY[name]}" if name in RUNS_ONLY else "yes" if name in ORDER else "no"
    return {
        "unit": "none" if unit == "1" else unit,
        "best": "the smallest" if smaller else BEST.get(name),
        "needs": next((need for part, need in NEEDS.items() if part in name), None),
        "exact_value": None if name in BANDS.values() else exact,
    }


def option_type(schema: Description) -> Description:
    """Return the type of an option in words, and its range or its choices, of a JSON schema."""
    schemas = [s for s in _alternatives(schema) if s.get("type") != "null"]
    if "enum" in schemas[0]:
        return {"type": "choice", "choices": schemas[0]["enum"]}
    ends = {sign: schemas[0][key] for key, sign in ENDS.items() if abs(schemas[0].get(key, LARGEST)) < LARGEST}
    if ">" in ends:
        ends.pop(">=", None)
    words = " and ".join(f"{sign} {end:.10g}" for sign, end in ends.items())
    return {"type": " or ".join(dict.fromkeys(map(_type_words, schemas))), "range": words or None}


def _alternatives(schema: Description) -> list[Description]:
    """Return the schemas of which a value satisfies one."""
    return [inner for s in schema["anyOf"] for inner in _alternatives(s)] if "anyOf" in schema else [schema]


def _type_words(schema: Description) -> str:
    """Return the type of one schema in words."""
    if "const" in schema:
        return f'"{schema["const"]}"'
    if schema.get("type") == "array":
        inner = dict.fromkeys(map(_type_words, _alternatives(schema.get("items", {}))))
        types = " or ".join(t if t.startswith('"') else f"{t}s" for t in inner)
        return "matrix" if types.startswith("list") else f"list of {types}"
    kind = str(schema.get("type", "table" if "$ref" in schema else "value"))
    return TYPES.get(kind, kind)
