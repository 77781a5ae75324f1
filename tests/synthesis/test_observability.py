"""Which modes no output shows: the same whatever the units, in any coordinates. The oracle counts in exact fractions."""

from fractions import Fraction

import numpy as np
import pytest

from pcbench.dynamics.observability import rank, unobservable

CHAIN = np.eye(3, k=1)
PLANTS = {  # A, C, the modes that C does not show
    "oscillator and its rate": ([[0, 1], [-4, 0]], [[0, 1]], []),
    "rate of a double integrator": ([[0, 1], [0, 0]], [[0, 1]], [0]),
    "middle of a triple integrator": (CHAIN, [[0, 1, 0]], [0]),
    "end of a triple integrator": (CHAIN, [[0, 0, 1]], [0, 0]),
    "start of a triple integrator": (CHAIN, [[1, 0, 0]], []),
    "unstable mode": (np.diag([0.5, -1, -2]), [[0, 1, 1]], [0.5]),
    "sum of two integrators": (np.zeros((2, 2)), [[1, 1]], [0]),
    "two sums of three integrators": (np.zeros((3, 3)), [[1, 1, 0], [0, 1, 1]], [0]),
    "the same sum twice": (np.zeros((3, 3)), [[1, 1, 0], [1, 1, 0]], [0, 0]),
    "no output": (np.diag([-1.0, 2.0]), [[0, 0]], [-1, 2]),
    "decaying mode": (np.diag([-1.0, -2.0]), [[1, 0]], [-2]),
    "time constants far apart": (np.diag([-1e-3, -2e-3, -1e6]), [[1, 1, 1]], []),
    "slow modes beside a fast one": (np.diag([-0.25, -0.5, -(2.0**20)]), [[0, 0, 1]], [-0.5, -0.25]),
}
UNITS = [(1, 1, 1), (1e9, 1e-9, 1e3), (1e-9, 1e9, 1), (1e7, 1e7, 1e-7), (1e-5, 1, 1e9)]


def hidden_count(A, C):
    """n less the rank of [C; C A; C A^2 ...], in fractions."""
    A, C = ([[Fraction(x) for x in row] for row in np.asarray(M, float).tolist()] for M in (A, C))
    rows, block, found = [], C, 0
    for _ in A:
        rows = rows + block
        block = [[sum(a * b for a, b in zip(row, col, strict=True)) for col in zip(*A, strict=True)] for row in block]
    for column in range(len(A)):
        pivot = next((row for row in rows if row[column]), None)
        if pivot:
            others = [(row, row[column] / pivot[column]) for row in rows if row is not pivot]
            rows = [[a - f * b for a, b in zip(row, pivot, strict=True)] for row, f in others]
            found += 1
    return len(A) - found


def same(found, expected, accuracy):
    np.testing.assert_allclose(sorted(np.real(found)), sorted(expected), atol=accuracy)
    np.testing.assert_allclose(np.imag(found), 0, atol=accuracy)


@pytest.mark.parametrize("units", UNITS)
@pytest.mark.parametrize("name", PLANTS)
def test_units_of_states_and_outputs_change_no_mode(name, units):
    A, C, expected = PLANTS[name]
    A, C, x, y = np.array(A, float), np.array(C, float), np.array(units[: len(A)]), np.array(units[: len(C)])
    assert hidden_count(A, C) == len(expected)
    same(unobservable(x[:, None] * A / x, y[:, None] * C / x), expected, 1e-9)


@pytest.mark.parametrize("units", UNITS[:2])
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", PLANTS)
def test_other_coordinates_change_no_mode(name, seed, units):
    """The eigenvalues of a multiple mode move by the root of a rounding error there."""
    A, C, expected = PLANTS[name]
    n, rng = len(A), np.random.default_rng(seed)
    x, T = np.array(units[:n]), np.linalg.qr(rng.standard_normal((n, n)))[0] @ np.diag(rng.uniform(0.3, 3, n))
    A, C = x[:, None] * (T @ A @ np.linalg.inv(T)) / x, C @ np.linalg.inv(T) / x
    same(unobservable(A, C), expected, 1e-7)


def test_a_weak_coupling_is_a_matter_of_units():
    assert unobservable([[0, 1e-10], [0, 0]], [[1, 0]]) == []
    assert unobservable([[0, 1e-10], [0, 0]], [[0, 1]]) == [0]


@pytest.mark.parametrize(
    ("M", "expected"),
    [
        ([[1, 0], [1, 0]], 1),
        ([[1e-9, 0], [0, 1e9]], 2),
        ([[1, 2], [1e9, 2e9]], 1),
        ([[0, 0]], 0),
        ([[1, 1e12], [1, 2e12]], 2),
        ([[1, 0], [0, 0]], 1),
    ],
)
def test_a_rank_does_not_depend_on_the_units_of_rows_and_columns(M, expected):
    assert rank(np.array(M, float)) == expected
