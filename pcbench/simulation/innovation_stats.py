"""An observer that keeps, beside its memory, how far what arrived was from what it expected.

What it does is unchanged: `sum_innovations` puts its memory into one that has two sums more, and every jump adds to them first.

Does an observer know how wrong it is? Its error at the last tick against the covariance P that it believes it to have.

    whole: e' P^-1 e / n,   by signal: e_i^2 / P_ii,   of the n states of the plant
    of innovations: the sum of nu' S^-1 nu over all samples that it judges, over how many numbers these were
    (`innovation_stats`)

Where P is true and errors are Gaussian, n times the first is chi-square with n degrees of freedom, the second with one, and the
sum with as many as there were numbers. A state whose standard deviation is believed to be below 1e-9 of its prior's is known
for every purpose, and counts in neither of the first two. If P is singular, as when all states depend on one unknown number,
the first takes the pseudo-inverse of P and divides by the rank: the number of eigenvalues of the correlation matrix above 1e-11
of the largest one, which rounding does not reach.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax import Array
from jaxtyping import PyTree

from pcbench.protocols import Arrival, Covariance, Gains, Innovation, InnovationStats, Memory, Now, Observer
from pcbench.simulation.types import GridPointParams, Layout, present


class StatsMemory(NamedTuple):
    """An observer's memory, and the sums over all that has arrived."""

    memory: Memory
    so_far: InnovationStats


def add_innovation_stats(layout: Layout) -> Layout:
    """Return the layout with every observer judged that says what it expects of a sample."""
    every = ((label, sum_innovations(o, o.innovation) if o.innovation else o) for label, o in layout.observers)
    return layout._replace(observers=tuple(every))


def sum_innovations(o: Observer, innovation: Innovation) -> Observer:
    """Return an observer that does the same and sums what its innovations amount to."""

    def init(gains: Gains, xhat0: Array) -> StatsMemory:
        return StatsMemory(o.init(gains, xhat0), InnovationStats(jnp.zeros(()), jnp.zeros(())))

    def snapshot(gains: Gains, memory: StatsMemory, now: Now) -> Array:
        return o.snapshot(gains, memory.memory, now)

    def jump(gains: Gains, memory: StatsMemory, now: Now, arrival: Arrival) -> StatsMemory:
        before, more = memory.so_far, innovation(gains, memory.memory, now, arrival)
        so_far = InnovationStats(before.nis_sum + more.nis_sum, before.dof + more.dof)
        return StatsMemory(o.jump(gains, memory.memory, now, arrival), so_far)

    def flow(gains: Gains, memory: StatsMemory, now: Now) -> StatsMemory:
        return memory._replace(memory=o.flow(gains, memory.memory, now))

    def estimate(gains: Gains, memory: StatsMemory) -> Array:
        return o.estimate(gains, memory.memory)

    made = Observer(init, snapshot, jump, flow, estimate, uses_silence=o.uses_silence)
    if (covariance := o.covariance) is not None:
        made = made._replace(covariance=lambda gains, memory, now: covariance(gains, memory.memory, now))
    if (bounds := o.bounds) is not None:
        made = made._replace(bounds=lambda gains, memory: bounds(gains, memory.memory))
    if (on_sample := o.on_sample) is not None:
        made = made._replace(
            on_sample=lambda gains, memory, now, mask: memory._replace(
                memory=on_sample(gains, memory.memory, now, mask)
            )
        )
    if (init_random := o.init_random) is not None:
        made = made._replace(
            init_random=lambda gains, memory, words, xhat0: memory._replace(
                memory=init_random(gains, memory.memory, words, xhat0)
            )
        )
    return made


def sums(memory: Memory) -> InnovationStats | None:
    """Return the sums of an observer that was judged."""
    return memory.so_far if isinstance(memory, StatsMemory) else None


KNOWN = 1e-9  # part of the prior's standard deviation
RANK = 1e-11  # part of a correlation matrix's largest eigenvalue


class Squares(NamedTuple):
    """Normalised squares of one run's error."""

    whole: Array  # over the rank of P among the states that count
    signal: Array  # [n], NaN of a state that does not count
    states: Array  # that rank
    innovation: InnovationStats | None = None  # sums over the run, of an observer that says what it expects of samples


def covariances(
    layout: Layout, p: GridPointParams, k: Array, memories: PyTree, commands: PyTree = ()
) -> dict[str, Array]:
    """Return what each observer of one lane believes of its error at tick k, of those that have a covariance."""
    now = present(p, k, False, commands)
    return {label: f(p.gains[label], memories[label], now) for label, f in _able(layout).items()}


def _able(layout: Layout) -> dict[str, Covariance]:
    return {label: o.covariance for label, o in layout.observers if o.covariance}


def normalize_error(e: Array, P: Array, prior: Array) -> Squares:
    """Return the squares of e [n] by P [n, n] or larger; prior [n] standard deviations."""
    n = e.shape[0]
    P = P[:n, :n]
    variance = jnp.diagonal(P)
    counts = variance > jnp.square(KNOWN * prior)
    std = jnp.sqrt(jnp.where(counts, variance, 1.0))
    e = jnp.where(counts, e / std, 0.0)
    correlation = jnp.where(counts[:, None] & counts[None, :], P / (std[:, None] * std[None, :]), jnp.eye(n))
    size, V = jnp.linalg.eigh(correlation)
    spans = size > RANK * size[-1]
    left = jnp.sum(jnp.where(spans, jnp.square(V.T @ e) / jnp.where(spans, size, 1.0), 0.0))
    full = jnp.all(spans)
    square = jnp.where(full, e @ jnp.linalg.solve(jnp.where(full, correlation, jnp.eye(n)), e), left)
    rank = (jnp.sum(counts) - jnp.sum(~spans)).astype(float)
    return Squares(square / rank, jnp.where(counts, e * e, jnp.nan), rank)
