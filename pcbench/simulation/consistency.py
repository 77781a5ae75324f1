"""Does an observer know how wrong it is? Its error at the last tick against the covariance P that it believes it to have.

    whole: e' P^-1 e / n,   by signal: e_i^2 / P_ii,   of the n states of the plant

Where P is true and errors are Gaussian, n times the first is chi-square with n degrees of freedom, the second with one. A
state whose standard deviation is believed to be below 1e-9 of its prior's is known for every purpose, and counts in neither.
Source: Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 2001, section 5.4.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jax import Array

from pcbench.simulation.lanes.entrywise import over
from pcbench.simulation.problem import Layout, Problem, State

KNOWN = 1e-9  # part of the prior's standard deviation


class Squares(NamedTuple):
    """Normalised squares of one run's error."""

    whole: Array  # over the number of states that count
    signal: Array  # [n], NaN of a state that does not count
    states: Array  # how many count


def squares(layout: Layout, p: Problem, state: State, errors: dict[str, Any]) -> dict[str, Squares]:
    """Return them by observer, of those that have a covariance; errors are those of the same tick."""
    able = {label: o.covariance for label, o in layout.observers if o.covariance}

    def one_lane(memories: Any, e: dict[str, Array]) -> dict[str, Squares]:
        prior = jnp.diagonal(p.spread0)
        return {
            label: normalised(e[label][: len(prior)], f(p.gains[label], memories[label]), prior)
            for label, f in able.items()
        }

    return over(one_lane)(state.memories, errors) if able else {}


def sigmas(layout: Layout, p: Problem, state: State) -> dict[str, Any]:
    """Return the standard deviation that each observer believes its errors to have, of those that have a covariance."""
    able = {label: o.covariance for label, o in layout.observers if o.covariance}

    def one_lane(memories: Any) -> dict[str, Array]:
        return {label: jnp.sqrt(jnp.diagonal(f(p.gains[label], memories[label]))) for label, f in able.items()}

    return over(one_lane)(state.memories) if able else {}


def normalised(e: Array, P: Array, prior: Array) -> Squares:
    """Return the squares of e [n] by P [n, n] or larger; prior [n] standard deviations."""
    n = e.shape[0]
    P = P[:n, :n]
    variance = jnp.diagonal(P)
    counts = variance > jnp.square(KNOWN * prior)
    std = jnp.sqrt(jnp.where(counts, variance, 1.0))
    e = jnp.where(counts, e / std, 0.0)
    correlation = jnp.where(counts[:, None] & counts[None, :], P / (std[:, None] * std[None, :]), jnp.eye(n))
    many = jnp.sum(counts).astype(float)
    whole = e @ jnp.linalg.solve(correlation, e) / many
    return Squares(whole, jnp.where(counts, e * e, jnp.nan), many)
