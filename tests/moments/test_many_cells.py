"""Cells that go through a program side by side, their functions written out entry by entry: the numbers of one alone."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import pcbench
from pcbench.moments import programs
from pcbench.moments.noise_state import is_constant

pytestmark = pytest.mark.usefixtures("in_a_hurry")

TICKS, POINTS = 2000, 80  # of a study; at so many moments are kept, every 25 ticks: within those that go together
STUDY = {
    "name": "many",
    "scenarios": {"mine": {"base": "cart/gaussian", "duration": 2.0, "steady_start": 1.0}},
    "axes": {"noise_std": [0.1 * i for i in range(1, programs.FEW + 2)]},
}


SLOW = [pytest.param(observer, 1.0, marks=pytest.mark.nightly) for observer in ("kfbo", "kf")]


@pytest.mark.ci
@pytest.mark.parametrize(("observer", "drift"), [("pccebo", 0.0), *SLOW])
def test_of_many_cells_each_has_the_numbers_that_it_has_alone(observer, drift):
    fast = {"sampling_period": [0.2], "delay": [0.1], "parameter_drift": [drift]}
    study = STUDY | {"observers": [observer], "axes": STUDY["axes"] | fast}
    many = pcbench.exact_moments(study)
    assert many.stats["method"].ne("none").any()
    noises = study["axes"]["noise_std"]
    solved = {m.plan.cell.number: m for m in many.solve_cells(many.grid.cells, "std", POINTS)}
    for cell in (0, len(noises) - 1):
        one = pcbench.exact_moments(study | {"axes": study["axes"] | {"noise_std": [noises[cell]]}})
        mine = many.stats.query("cell == @cell").reset_index(drop=True)
        np.testing.assert_allclose(mine["mean"], one.stats["mean"], rtol=1e-10, atol=1e-14)
        alone = one.moments()
        for seen in many.over_time(solved[cell], POINTS):
            every = alone[alone["signal"] == seen["signal"][0]].iloc[:: TICKS // POINTS]
            for column in ("t", "mean", "std"):
                np.testing.assert_allclose(seen[column], every[column], rtol=1e-10, atol=1e-14)


def test_a_matrix_is_the_same_at_every_tick_where_it_reads_neither_the_tick_nor_the_state():
    p = {"own": jnp.ones((2, 3)), "common": jnp.ones((4, 2))}
    state, own = jnp.ones((2, 3)), (False, True)  # leaves in the order of their names
    assert is_constant(p, own, lambda p, k, state: p["own"] * p["common"][0], state)
    assert not is_constant(p, own, lambda p, k, state: p["own"] * p["common"][k], state), (
        "it looks numbers up by the tick"
    )
    assert not is_constant(p, own, lambda p, k, state: p["own"] * state, state)


def test_how_many_go_side_by_side_depends_on_the_cells_of_a_study_alone(monkeypatch):
    """The last cells of a study go by the program of those before; what another study had before decides no bit."""
    monkeypatch.setattr(programs, "is_per_cell", lambda problem: ())
    cell, wide = SimpleNamespace(layout="one", problem=()), set()
    assert programs.width_of([cell] * programs.MANY, wide) == programs.MANY
    assert programs.width_of([cell] * programs.SOME, wide) == programs.MANY
    assert programs.width_of([cell] * programs.SOME, set()) == programs.SOME
    assert programs.width_of([cell] * programs.FEW, wide) == programs.FEW
