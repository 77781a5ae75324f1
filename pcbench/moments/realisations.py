"""Realisations: a grid point with its random schedules, networks and plant parameters set to those of one run.

Given these, the error is affine in normals and its moments are exact. Over realisations moments are averaged, with a standard
error.
"""

from functools import lru_cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from pcbench.moments.affinity import uses_last_arrival
from pcbench.moments.noise_state import form_of
from pcbench.planning import alone
from pcbench.planning.padding import Plan
from pcbench.simulation import rng
from pcbench.simulation.schedule import common_times
from pcbench.simulation.schedule.random_times import ClockParams
from pcbench.simulation.types import GridPointParams, Layout


class Mode(NamedTuple):
    """One mode of a grid point (see `delay_modes`)."""

    number: int
    probability: float
    source: tuple[int, ...]  # the modes that may precede it
    weight: tuple[float, ...]  # and their probabilities
    merge_ticks: NDArray[np.bool_]  # [N+1] ticks at which it follows them


class Realisation(NamedTuple):
    """A grid point in which only the noise is random."""

    layout: Layout
    problem: GridPointParams
    network: tuple[NDArray[np.float64], ...]  # (late, lost) [J, 1] of every decision; (): no network
    chance: float = 1.0  # probability that a sample arrives
    mode: Mode | None = None  # if this is one of the grid point's modes


def is_random(p: Plan) -> bool:
    """Return whether runs of a grid point differ in more than their noise."""
    commands = p.problem.network
    network = bool(commands) and (commands.jitter > 0 or commands.loss > 0)
    return isinstance(p.problem.schedule, ClockParams) or p.layout.drifting or network


def draw_realisation(p: Plan, root_seed: int, seed: int) -> Realisation:
    """Return a grid point with the random values of one run, except its noise."""
    plan = alone(p, root_seed, seed) if isinstance(p.problem.schedule, ClockParams) else p
    layout, problem, plant = plan.layout._replace(width=1, watch=False), plan.problem, plan.layout.plant
    network: tuple[NDArray[np.float64], ...] = ()
    if layout.drifting and plant.of_run:
        params = plant.of_run(problem.params, _drift(root_seed, seed, plant.drawn))
        layout, problem = layout._replace(drifting=False), problem._replace(params=jax.tree.map(np.asarray, params))
    if layout.pending:
        decisions = -(-len(problem.schedule.event) // int(problem.network.period_ticks))
        root, seeds = jnp.asarray(root_seed), jnp.asarray([seed])
        network = tuple(
            np.asarray(rng.uniforms(root, seeds, stream, jnp.asarray(0), decisions, 1))[:, :, 0]
            for stream in ("command_jitter", "command_loss")
        )
    return Realisation(layout, problem, network)


@lru_cache(1024)
def _drift(root_seed: int, seed: int, count: int) -> Array:
    """Return the random numbers [count] of one run's plant, the same at all grid points; cached, as drawing them takes 6 ms."""
    return rng.uniforms(jnp.asarray(root_seed), jnp.asarray([seed]), "drift", jnp.asarray(0), 1, count)[0][:, 0]


def only_losses_random(p: Plan) -> bool:
    """Return whether independent losses of one sensor are all that is random in addition to the noise."""
    clocks, commands = p.cell.times.clocks, p.problem.network
    if len(clocks) > 1 or not clocks[0].loss or clocks[0].burst or p.layout.drifting or commands:
        return False
    return not clocks[0]._replace(loss=0.0).random


def realisation_over_losses(p: Plan) -> Realisation | None:
    """Return a grid point of one observer for the recursion over losses; None if the observer's maps depend on earlier losses.

    They do if an arrival changes values that noise does not reach, such as the time of the newest sample or a covariance, or if
    the observer uses the time of the last arrival. Its moments are then averaged over drawn schedules.
    """
    clock, ticks = p.cell.times.clocks[0]._replace(loss=0.0), p.cell.times.ticks
    lossless = common_times.schedule(
        common_times.samples_of([clock], ticks), ticks, len(p.problem.noise_std), p.cell.times.error
    )
    problem = p.problem._replace(schedule=lossless)
    layout = p.layout._replace(width=1, watch=False)
    form, lossy = form_of(layout, problem), form_of(layout, p.problem)
    if (lossy.noisy, lossy.random) != (form.noisy, form.random) or any(form.random):
        return None
    if uses_last_arrival(layout, problem):
        return None
    ring = max(layout.ring, common_times.in_flight(lossless))
    return Realisation(layout._replace(ring=ring), problem, (), 1.0 - p.cell.times.clocks[0].loss)
