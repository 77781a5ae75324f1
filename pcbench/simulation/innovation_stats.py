"""Consistency statistics of an observer: normalized innovations over a run, and the normalized error at the last tick.

`sum_innovations` wraps an observer. The wrapper adds two sums to its memory and updates them before each jump. The estimates
do not change.

    nees         e' P^-1 e / n at the last tick, P the observer's own error covariance, n the states of the plant
    signal       e_i^2 / P_ii
    innovation   sum of nu' S^-1 nu over all samples that the observer tests, and the sum of their dimensions

If P is correct and errors are Gaussian, n e' P^-1 e / n is chi-square with n degrees of freedom, and each signal with one. The
innovation sum is chi-square with as many degrees of freedom as there were numbers.

A state counts as known if its standard deviation in P is below 1e-9 of the prior's; it enters neither of the first two.
If P is singular, `nees` uses the pseudo-inverse of P divided by the rank. The rank is the number of eigenvalues of the
correlation matrix above 1e-11 of the largest, a limit that rounding does not reach.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.protocols import Arrival, Gains, Innovation, InnovationStats, Memory, Now, Observer
from pcbench.simulation.types import GridPointParams, Layout, present


class StatsMemory(NamedTuple):
    """An observer's memory with the sums over all arrivals."""

    memory: Memory
    sums: InnovationStats


def add_innovation_stats(layout: Layout) -> Layout:
    """Return the layout with innovation sums for every observer that defines `innovation`."""
    observers = ((label, sum_innovations(o, o.innovation) if o.innovation else o) for label, o in layout.observers)
    return layout._replace(observers=tuple(observers))


def sum_innovations(o: Observer, innovation: Innovation) -> Observer:
    """Return an observer with the same estimates that also sums its normalized innovations."""

    def init(gains: Gains, xhat0: Array) -> StatsMemory:
        return StatsMemory(o.init(gains, xhat0), InnovationStats(jnp.zeros(()), jnp.zeros(())))

    def snapshot(gains: Gains, memory: StatsMemory, now: Now) -> Array:
        return o.snapshot(gains, memory.memory, now)

    def jump(gains: Gains, memory: StatsMemory, now: Now, arrival: Arrival) -> StatsMemory:
        sums, increment = memory.sums, innovation(gains, memory.memory, now, arrival)
        total = InnovationStats(sums.nis_sum + increment.nis_sum, sums.dof + increment.dof)
        return StatsMemory(o.jump(gains, memory.memory, now, arrival), total)

    def flow(gains: Gains, memory: StatsMemory, now: Now) -> StatsMemory:
        return memory._replace(memory=o.flow(gains, memory.memory, now))

    def estimate(gains: Gains, memory: StatsMemory) -> Array:
        return o.estimate(gains, memory.memory)

    wrapper = Observer(init, snapshot, jump, flow, estimate, uses_silence=o.uses_silence)
    if (covariance := o.covariance) is not None:
        wrapper = wrapper._replace(covariance=lambda gains, memory, now: covariance(gains, memory.memory, now))
    if (bounds := o.bounds) is not None:
        wrapper = wrapper._replace(bounds=lambda gains, memory: bounds(gains, memory.memory))
    if (on_sample := o.on_sample) is not None:
        wrapper = wrapper._replace(
            on_sample=lambda gains, m, now, mask: m._replace(memory=on_sample(gains, m.memory, now, mask))
        )
    if (init_random := o.init_random) is not None:
        wrapper = wrapper._replace(
            init_random=lambda gains, m, words, xhat0: m._replace(memory=init_random(gains, m.memory, words, xhat0))
        )
    return wrapper


def sums(memory: Memory) -> InnovationStats | None:
    """Return the innovation sums from a memory, or None if the observer has none."""
    return memory.sums if isinstance(memory, StatsMemory) else None


KNOWN_TOL = 1e-9  # relative to the prior's standard deviation: below it a state counts as known
RANK_TOL = 1e-11  # relative to the largest eigenvalue of the correlation matrix


class Squares(NamedTuple):
    """Normalized squared errors of one run."""

    nees: Array  # e' P^-1 e over the states that are not known, divided by the rank of P
    signal: Array  # [n], NaN for a known state
    states: Array  # the rank of P
    innovation: InnovationStats | None = None  # sums over the run, if the observer defines `innovation`


def covariances(
    layout: Layout, p: GridPointParams, k: Array, memories: PyTree, commands: PyTree = ()
) -> dict[str, Array]:
    """Return the error covariance that each observer of one run reports at tick k, by label."""
    now = present(p, k, False, commands)
    return {o: f.covariance(p.gains[o], memories[o], now) for o, f in layout.observers if f.covariance}


def normalize_error(e: Array, P: Array, prior_std: Array) -> Squares:
    """Return the normalized squares of the error e [n] by P [n, n] or larger; `prior_std` [n] standard deviations."""
    n = e.shape[0]
    P = P[:n, :n]
    variance = jnp.diagonal(P)
    is_uncertain = variance > jnp.square(KNOWN_TOL * prior_std)  # not known: it enters the squares
    std = jnp.sqrt(jnp.where(is_uncertain, variance, 1.0))
    e = jnp.where(is_uncertain, e / std, 0.0)
    both_uncertain = is_uncertain[:, None] & is_uncertain[None, :]
    correlation = jnp.where(both_uncertain, P / (std[:, None] * std[None, :]), jnp.eye(n))
    values, V = jnp.linalg.eigh(correlation)
    nonzero = values > RANK_TOL * values[-1]
    square_pinv = jnp.sum(jnp.where(nonzero, jnp.square(V.T @ e) / jnp.where(nonzero, values, 1.0), 0.0))
    is_full_rank = jnp.all(nonzero)
    square_inv = e @ jnp.linalg.solve(jnp.where(is_full_rank, correlation, jnp.eye(n)), e)
    square = jnp.where(is_full_rank, square_inv, square_pinv)
    rank = (jnp.sum(is_uncertain) - jnp.sum(~nonzero)).astype(float)
    return Squares(square / rank, jnp.where(is_uncertain, e * e, jnp.nan), rank)
