"""Gains and model as numbers for your own code: JSON, and a MAT-file for MATLAB."""

import io
import json
from collections.abc import Mapping
from typing import Any, cast

import numpy as np
from jaxtyping import PyTree

from pcbench.dynamics import linear
from pcbench.export import observer_to_c, structs
from pcbench.export.c_files import About
from pcbench.json_values import json_values
from pcbench.synthesis.certificate import Certificate, DesignContext


def describe_gains(
    about: About, context: DesignContext, certificate: Certificate, options: Mapping[str, object], gains: PyTree
) -> dict[str, object]:
    """Return the gains by their names in C, and the model that the observer assumes, continuous and over one tick."""
    Phi, Gamma = linear.one_tick(context.model, context.dt)
    model = {"A": context.model.A, "B": context.model.B, "C": context.model.C, "D": context.model.feedthrough}
    gain_values = zip(structs.fields(gains, "gain"), observer_to_c.numbers(gains), strict=True)
    return {
        "observer": about.observer,
        "scenario": about.scenario,
        "options": options,
        "certificate": {"inequality": certificate.inequality, "margin": float(certificate.margin)},
        "dt": about.dt,
        "signals": [name for name, _ in about.signals],
        "units": [unit for _, unit in about.signals],
        "period": [t * about.dt for t in context.period],
        "delay": [t * about.dt for t in context.delay],
        "noise_std": list(context.noise_std),
        "model": model | {"Phi": Phi, "Gamma": Gamma, "discrete": context.model.discrete},
        "gains": {f.name: value for f, value in gain_values},
    }


def as_json(description: Mapping[str, object]) -> str:
    """Return a description as JSON."""
    return json.dumps(json_values(description), indent=2) + "\n"


def as_mat(description: Mapping[str, object]) -> bytes:
    """Return a description as a MAT-file, version 5."""
    from scipy.io import savemat

    out = io.BytesIO()
    content = {name: _to_matlab(value) for name, value in description.items() if value is not None}
    savemat(cast(Any, out), content, long_field_names=True)  # scipy's types know no open file
    return out.getvalue()


def _to_matlab(x: object) -> object:
    """Return nested dicts as MATLAB requires them: names of at most 63 letters, no None."""
    if isinstance(x, dict):
        return {str(k)[:63]: _to_matlab(v) for k, v in x.items() if v is not None}
    if isinstance(x, list | tuple):
        values = [_to_matlab(v) for v in x if v is not None]
        return np.array(values, object) if any(isinstance(v, str | dict) for v in values) else np.array(values, float)
    return x
