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

from pcbench.protocols import Arrival, Covariance, Gains, Innovation, InnovationStats, Memory, Now, Observer
from pcbench.simulation.types import GridPointParams, Layout, present


class StatsMemory(NamedTuple):
    """An observer's memory with the sums over all arrivals."""

    memory: Memory
    sums: InnovationStats


def add_innovation_stats(layout: Layout) -> Layout:
    """Return the layout with innovation sums for every observer that defines `innovation`."""
    every = ((label, sum_innovations(o, o.innovation) if o.innovation else o) for label, o in layout.observers)
    return layout._replace(observers=tuple(every))


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
            on_sample=lambda gains, memory, now, mask: memory._replace(
                memory=on_sample(gains, memory.memory, now, mask)
            )
        )
    if (init_random := o.init_random) is not None:
        wrapper = wrapper._replace(
            init_random=lambda gains, memory, words, xhat0: memory._replace(
                memory=init_random(gains, memory.memory, words, xhat0)
            )
        )
    return wrapper


def sums(memory: Memory) -> InnovationStats | None:
    """Return the innovation sums from a memory, or None if the observer has none."""
    return memory.sums if isinstance(memory, StatsMemory) else None


KNOWN = 1e-9  # relative to the prior's standard deviation
RANK = 1e-11  # relative to the largest eigenvalue of the correlation matrix


class Squares(NamedTuple):
    """Normalized squared errors of one run."""

    nees: Array  # e' P^-1 e over the states that count, divided by the rank of P
    signal: Array  # [n], NaN for a state that does not count
    states: Array  # the rank of P
    innovation: InnovationStats | None = None  # sums over the run, if the observer defines `innovation`


def covariances(
    layout: Layout, p: GridPointParams, k: Array, memories: PyTree, commands: PyTree = ()
) -> dict[str, Array]:
    """Return the error covariance that each observer of one run reports at tick k, by label."""
    now = present(p, k, False, commands)
    return {label: f(p.gains[label], memories[label], now) for label, f in _able(layout).items()}


def _able(layout: Layout) -> dict[str, Covariance]:
    return {label: o.covariance for label, o in layout.observers if o.covariance}


def normalize_error(e: Array, P: Array, prior: Array) -> Squares:
    """Return the normalized squares of the error e [n] by P [n, n] or larger; prior [n] standard deviations."""
    n = e.shape[0]
    P = P[:n, :n]
    variance = jnp.diagonal(P)
    counts = variance > jnp.square(KNOWN * prior)
    std = jnp.sqrt(jnp.where(counts, variance, 1.0))
    e = jnp.where(counts, e / std, 0.0)
    correlation = jnp.where(counts[:, None] & counts[None, :], P / (std[:, None] * std[None, :]), jnp.eye(n))
    size, V = jnp.linalg.eigh(correlation)
    spans = size > RANK * size[-1]
    square_pinv = jnp.sum(jnp.where(spans, jnp.square(V.T @ e) / jnp.where(spans, size, 1.0), 0.0))
    full = jnp.all(spans)
    square = jnp.where(full, e @ jnp.linalg.solve(jnp.where(full, correlation, jnp.eye(n)), e), square_pinv)
    rank = (jnp.sum(counts) - jnp.sum(~spans)).astype(float)
    return Squares(square / rank, jnp.where(counts, e * e, jnp.nan), rank)
