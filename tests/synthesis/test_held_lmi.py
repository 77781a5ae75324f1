"""The LMI of held innovations: intervals that it certifies, and its functional along runs with random intervals."""

import numpy as np
import pytest
from reference import linear

from pcbench.dynamics.linear import spectral_radius
from pcbench.errors import DesignError
from pcbench.plants import flexible_joint, ncs_two_state
from pcbench.synthesis import constant_periods, held_lmi
from pcbench.synthesis.held_lmi import HeldTask

SLOPES = np.stack(
    [flexible_joint.nominal(flexible_joint.Numbers(gravity=slope)).A for slope in (-3.33, 3.33)]
)  # corners of all slopes of -3.33 sin
ANGLE, BOTH = np.eye(4)[:1], np.eye(4)[:2]
GIVEN = np.array([[4.019], [0.901], [3.689], [3.505]])
TWO_STATE = ncs_two_state.nominal(ncs_two_state.Numbers())
FEEDBACK = np.array([[3.75, 11.5]])
OWN_A = np.array([[0.2, 1.0, 0.0], [-1.0, -0.3, 0.5], [0.0, -0.4, -0.8]])
OWN_C = np.array([[1.0, 0.0, 0.3], [0.0, 1.0, -1.0]])

# task without intervals, gain, certified interval [s]
INTERVALS = {
    "two-state plant": (HeldTask(TWO_STATE.A[None], FEEDBACK, (0,), (1.0,)), TWO_STATE.B, 1.614),
    "flexible joint": (HeldTask(SLOPES, ANGLE, (0,), (1.0,)), None, 0.290),
    "flexible joint, two outputs": (HeldTask(SLOPES, BOTH, (0, 0), (1.0,)), None, 0.2935),
    "flexible joint, given gain": (HeldTask(SLOPES, ANGLE, (0,), (1.0,)), GIVEN, 0.281),
}


def certificate(task, interval, L):
    task = task._replace(intervals=(interval,) * len(task.intervals))
    try:
        return held_lmi.design(task, L, np.ones(task.A.shape[-1]), "test")[1]
    except DesignError:
        return None


@pytest.mark.ci
@pytest.mark.parametrize("name", INTERVALS)
def test_largest_certified_interval_is_that_of_the_source(name):
    task, L, interval = INTERVALS[name]
    found, proof = held_lmi.largest_interval(task, L, 2.0 * interval)
    assert found == pytest.approx(interval, abs=6e-4)
    assert proof.margin > 0


@pytest.mark.parametrize("name", ["two-state plant", "flexible joint"])
def test_interval_is_certified_up_to_its_limit_only(name):
    task, L, interval = INTERVALS[name]
    proof = certificate(task, 0.997 * interval, L)
    assert proof.margin > 0
    assert proof.numbers["L"].shape == (task.A.shape[-1], len(task.C))
    assert certificate(task, 1.02 * interval, L) is None


def test_certified_intervals_lie_below_the_exact_constant_limit():
    task, L, interval = INTERVALS["flexible joint, given gain"]
    maps = [constant_periods.held_map(A, L, task.C, 1.7 * interval) for A in task.A]
    assert max(map(spectral_radius, maps)) < 1, "the LMI is sufficient only"


def functional(task, found, e, rates, ages, seconds):
    """V at the end of a stretch, in units of the largest interval; rates [k, n] of the last ticks, newest last."""
    unit, value = max(task.intervals), e @ found.P @ e
    for R, age, longest in zip(found.R, ages, task.intervals, strict=True):
        held = rates[len(rates) - age :]
        value += (longest / unit - age * seconds) * seconds * np.einsum("ki,ij,kj->", held, R, held)
    return value


@pytest.mark.parametrize("clocks", [(0, 0), (0, 1)])
def test_functional_falls_along_runs_with_random_intervals(clocks):
    """Its integral is a sum over short ticks, so V may rise by their error only."""
    longest = (0.4, 0.25)[: max(clocks) + 1]
    task = HeldTask(OWN_A[None], OWN_C, clocks, longest)
    found = held_lmi.solve(task, held_lmi.UNKNOWN_GAIN, "test")
    assert held_lmi.certify(task, found).margin > 0
    unit, h = max(longest), 1e-3
    L, rng = found.L / unit, np.random.default_rng(8)
    Phi, Gamma = linear.discretise(OWN_A, -L, h)
    for _ in range(3):
        e, rates, values = rng.normal(size=3), np.zeros((0, 3)), []
        ages = [0] * len(longest)
        ends = [int(rng.integers(1, T / h + 1)) for T in longest]
        held = OWN_C @ e
        for _ in range(800):
            for g, T in enumerate(longest):
                if ages[g] == ends[g]:
                    ages[g], ends[g] = 0, int(rng.integers(1, T / h + 1))
                    held = np.where(np.array(clocks) == g, OWN_C @ e, held)
            values.append(functional(task, found, e, rates, ages, h / unit))
            after = Phi @ e + Gamma @ held
            rates = np.vstack([rates, (after - e) * unit / h])[-500:]
            e, ages = after, [age + 1 for age in ages]
        values = np.array(values)
        assert (np.diff(values) < 2e-3 * values[:-1]).all()
        assert values[-1] < 0.5 * values[0]


def test_certified_rate_is_below_the_decay_of_every_constant_period():
    task = HeldTask(OWN_A[None], OWN_C, (0, 0), (0.3,), rate=0.5)
    L, proof = held_lmi.design(task, None, np.ones(3), "test")
    assert proof.rate == 0.5
    for period in (0.01, 0.1, 0.2, 0.3):
        Phi, Gamma = linear.discretise(OWN_A, -L, period)
        assert -np.log(np.abs(np.linalg.eigvals(Phi + Gamma @ OWN_C)).max()) / period > 0.5


def test_units_of_the_states_do_not_change_what_is_certified():
    task, scale = HeldTask(OWN_A[None], OWN_C, (0, 0), (0.3,)), np.array([1e3, 1.0, 1e-3])
    L, proof = held_lmi.design(task, None, np.ones(3), "test")
    odd = task._replace(A=task.A * scale[:, None] / scale, C=task.C / scale)
    other, again = held_lmi.design(odd, None, scale, "test")
    np.testing.assert_allclose(other / scale[:, None], L, rtol=1e-9)
    assert again.margin == pytest.approx(proof.margin, rel=1e-9)
    np.testing.assert_allclose(again.numbers["P"] * np.outer(scale, scale), proof.numbers["P"], rtol=1e-9)


@pytest.mark.parametrize(
    "broken",
    [
        lambda f: f._replace(L=-f.L),
        lambda f: f._replace(P=-f.P),
        lambda f: f._replace(R=-f.R),
        lambda f: f._replace(P2=-f.P2),
        lambda f: f._replace(P3=0 * f.P3),
        lambda f: f._replace(L=np.full_like(f.L, np.nan)),
    ],
)
def test_broken_answer_is_not_certified(broken):
    task = HeldTask(OWN_A[None], OWN_C, (0, 1), (0.3, 0.2))
    found = held_lmi.solve(task, held_lmi.UNKNOWN_GAIN, "test")
    assert held_lmi.certify(task, found).margin > 0
    assert not held_lmi.certify(task, broken(found)).margin > 0


def test_interval_that_no_gain_bears_is_refused():
    with pytest.raises(DesignError, match=r"certified|LMI"):
        held_lmi.design(HeldTask(np.array([[[1.0]]]), np.array([[1.0]]), (0,), (5.0,)), None, np.ones(1), "test")
