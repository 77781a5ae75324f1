"""Delays that follow a Markov chain, by going through every sequence there can be: how probable it is, and means over all.

The chain keeps value i with probability stay[i], or changes for any other alike; it starts as it is in the long run, in the
proportions of the eigenvector of its transition matrix for 1.
"""

import itertools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

Array = np.ndarray


def transitions(stay: Sequence[float]) -> Array:
    """Return the matrix [m, m] of probabilities from value to value."""
    m = len(stay)
    return np.array([[stay[i] if i == j else (1 - stay[i]) / (m - 1) for j in range(m)] for i in range(m)])


def in_the_long_run(T: Array) -> Array:
    """Return how often each value is there."""
    values, vectors = np.linalg.eig(T.T)
    often = np.real(vectors[:, np.argmin(np.abs(values - 1))])
    return often / often.sum()


def sequences(values: Sequence[int], stay: Sequence[float], many: int) -> Iterator[tuple[tuple[int, ...], float]]:
    """Yield every sequence of values with its probability."""
    T = transitions(stay)
    first = in_the_long_run(T)
    for which in itertools.product(range(len(values)), repeat=many):
        chance = first[which[0]] * np.prod([T[a, b] for a, b in itertools.pairwise(which)])
        yield tuple(values[i] for i in which), float(chance)


def mean_over(
    values: Sequence[int], stay: Sequence[float], taken: Sequence[int], late: int, ticks: int, of: Callable
) -> Array:
    """Return the mean of `of`(times) over all sequences; times are (taken, arrival or None beyond `ticks`) of each sample.

    Sequences that differ only in what arrives beyond are one.
    """
    each: dict[tuple[tuple[int, int | None], ...], float] = {}
    for later, chance in sequences(values, stay, len(taken)):
        arrives = [t + late + more for t, more in zip(taken, later, strict=True)]
        times = tuple((t, a if a <= ticks else None) for t, a in zip(taken, arrives, strict=True))
        each[times] = each.get(times, 0.0) + chance
    return sum(chance * of(list(times)) for times, chance in each.items())
