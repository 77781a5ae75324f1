"""Cells of one shape: each has the room that the largest needs, and its own numbers in it."""

import jax
import numpy as np
import pytest

from pcbench import planning
from pcbench.planning import padding
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation.schedule import common_times, random_times
from pcbench.study import parse
from pcbench.study.grid import cell_of, cells_of


def drafts(axes, observers=("pccebo", "kf"), scenario="cart/white"):
    raw = {"name": "t", "scenarios": [scenario], "observers": list(observers), "axes": axes}
    study = parse.parse(raw, "t")
    with config.float64():
        return list(planning.drafts(cells_of(study)))


@pytest.mark.parametrize(
    "axes",
    [
        {"delay": [3.0, 0.2, 1.2], "sampling_period": [0.1, 0.4]},
        {"sampling_period": [0.05, 0.2], "delay": ["interval", 0.6], "sampling_pattern": ["sine"]},
        {"parameter_drift": [0.0, 1.0], "delay": [0.0, 0.35]},
    ],
    ids=str,
)
def test_every_cell_of_a_study_has_room_for_its_own_packets_and_the_shape_of_all(axes):
    before = drafts(axes, ("kf", "model-only"))
    after = padding.fit(before)
    assert len({(p.layout, *map(np.shape, jax.tree.leaves(p.problem))) for p in after}) == 1
    for small, p in zip(before, after, strict=True):
        assert p.layout.ring >= common_times.in_flight(p.problem.schedule)
        slots = small.problem.schedule.arrive.shape[1]
        np.testing.assert_array_equal(p.problem.schedule.arrive[:, :slots], small.problem.schedule.arrive)
        assert (p.problem.schedule.arrive[:, slots:] == -1).all()
        for a, b in zip(jax.tree.leaves(small.problem.params), jax.tree.leaves(p.problem.params), strict=True):
            np.testing.assert_array_equal(b, np.broadcast_to(a, np.shape(b)))


def test_cells_whose_runs_have_times_of_their_own_have_room_for_the_most_samples():
    before = drafts({"loss": [0.1], "sampling_period": [0.1, 0.4], "delay_jitter": [0.0, 0.3]}, ("model-only",))
    after = padding.fit(before)
    assert len({p.problem.schedule.due.shape for p in after}) == 1
    for small, p in zip(before, after, strict=True):
        many = small.problem.schedule.due.shape[1]
        np.testing.assert_array_equal(p.problem.schedule.due[:, :many], small.problem.schedule.due)
        assert (p.problem.schedule.due[:, many:] == common_times.NEVER).all()
        assert p.layout.ring >= random_times.room(p.cell.times.clocks, p.cell.times.ticks, 0)


@pytest.mark.ci
def test_delays_of_a_wider_distribution_leave_the_others_as_they_were():
    """Gamma distributions of two means have tables of two lengths, and every sample its own delay."""
    before = drafts({"delay_gamma_mean": [0.05, 0.4], "delay_gamma_shape": [3.0]}, ("model-only",))
    after = padding.fit(before)
    assert before[0].problem.schedule.delay_cdf.shape != before[1].problem.schedule.delay_cdf.shape
    assert len({padding.key_of(p) for p in after}) == 1
    for small, p in zip(before, after, strict=True):
        with config.float64():
            one, other = (random_times.clock_times(each.problem.schedule, 0, 3, np.arange(5)) for each in (small, p))
        np.testing.assert_array_equal(one, np.asarray(other)[:, : len(one[0])])


def test_falls_of_an_unknown_input_that_fill_a_list_never_come():
    """A square falls or rises every second, a sine never: in the tail from 1 s on, at 1, 2 and 3 s."""
    arm = SCENARIOS["arm/sampled"].with_fields(duration=3.5, steady_start=1.0, input="zero")
    cells = [cell_of(arm.with_fields(unknown_input=name)) for name in ("square", "arm-sine")]
    square, sine = padding.fit([planning.draft(cell, {}) for cell in cells])
    assert square.problem.jumps.tolist() == [2000, 4000, 6000]
    assert sine.problem.jumps.tolist() == [common_times.NEVER] * 3


def test_room_is_the_larger_of_each():
    a = padding.Capacity(1, 20, 5, 3, 4, 2, 50, 6, 7, 9, True, False, False, ((("cart", 0), 1), (("arm", 1), 9)))
    b = padding.Capacity(2, 10, 4, 8, 1, 1, 60, 5, 0, 3, True, True, False, ((("cart", 0), 5),))
    for one in (padding.larger(a, b), padding.larger(b, a)):
        assert one[:-1] == (2, 20, 5, 8, 4, 2, 60, 6, 7, 9, True, True, False)
        assert dict(one.rows) == {("cart", 0): 5, ("arm", 1): 9}
