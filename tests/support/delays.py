"""Runs of observers that look for a delay: how wrong they are at the end, and how wrong they believe to be."""

import jax
import jax.numpy as jnp
import numpy as np

from pcbench import planning
from pcbench.simulation import trajectory
from pcbench.study import parse

CHOICES = {"random_initial_state": True, "consistency": True}
WIDE = {
    "mmae-delay": {"delays": [round(0.02 * i, 2) for i in range(61)], "longest": 1.2},
    "ekf-delay": {"longest": 1.2},
}


def score(runs, **changes):
    """By observer: rms error of the position [m], mean and rms of the delay's [s], its mean square over what is believed."""
    study = {
        "name": "judged",
        "observers": ["ekf-delay", "mmae-delay"],
        "scenario": {"base": "cart/unknown-delay", **changes},
        "options": {"scenario": CHOICES, **WIDE},
    }
    (p,) = planning.plan(parse.grid_of(study, {}, []).study)
    record = jax.jit(trajectory.record_some, static_argnums=(0, 1, 2))
    found = record(p.layout, 100, 11, jax.tree.map(jnp.asarray, p.problem), jnp.asarray(0), jnp.arange(runs))
    out = {}
    for name, xhat in found.estimates.items():
        e, sigma = np.asarray(found.x - xhat)[-1], np.asarray(found.sigma[name])[-1]
        position, delay = e[0], e[2]
        nees = np.mean(np.square(delay) / np.maximum(np.square(sigma[2]), 1e-12))
        out[name] = [np.sqrt(np.mean(position**2)), delay.mean(), np.sqrt(np.mean(delay**2)), nees]
    return out
