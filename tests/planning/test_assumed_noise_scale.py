"""Noise that is assumed larger or smaller than it is: the axis `assumed_noise_scale` is what an option says in each filter."""

import numpy as np
import pytest
from honest import STUDY

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.study import parse
from pcbench.study.grid import cells_of

AXIS = {"assumed_noise_scale": [0.5, 1.0, 3.0]}
KNOWN = {"name": "known", "observers": ["kf"], "lti": STUDY["lti"], "options": {}}


def cells(**given):
    return cells_of(parse.parse(KNOWN | given, "test"))


def test_designers_assume_so_many_times_the_noise():
    assumed = [planning.context_of(cell).noise_std for cell in cells(axes=AXIS)]
    np.testing.assert_allclose(assumed, [[0.15], [0.3], [0.9]], rtol=1e-12)


def test_what_is_assumed_changes_neither_the_samples_nor_the_bound():
    plans = planning.plan(parse.parse(KNOWN | {"axes": AXIS}, "test"))
    for p in plans:
        np.testing.assert_array_equal(p.problem.noise_std, [0.3])
        np.testing.assert_allclose(p.bound, plans[1].bound, rtol=1e-12)


def test_a_filter_that_believes_in_a_quarter_of_the_variance_is_the_one_told_so_by_an_option():
    by_axis, by_option = (planning.draft(cell, cell.options).problem.gains for cell in (
        cells(axes={"assumed_noise_scale": [0.5]})[0], cells(options={"kf": {"R": 0.0225}})[0]))  # fmt: skip
    np.testing.assert_allclose(by_axis["kf"].R, by_option["kf"].R, rtol=1e-12)


@pytest.mark.nightly
def test_who_is_told_a_quarter_is_over_confident_and_who_is_told_four_times_pessimistic():
    study = KNOWN | {"options": {"scenario": {"random_initial_state": True, "consistency": True}}, "seeds": 256}
    stats = pcbench.run(study, axes={"assumed_noise_scale": [0.5, 1.0, 2.0]}).stats
    nis = stats[stats.metric == "nis"].set_index("assumed_noise_scale")["mean"]
    assert nis[0.5] > 2 > 1.1 > nis[1.0] > 0.9 > 0.5 > nis[2.0]


REFUSED = [
    ({"axes": {"assumed_noise_scale": [0.0]}}, "expected a number greater than 0"),
    ({"axes": {"assumed_noise_scale": [-1.0]}}, "expected a number of at least 0"),
    ({"axes": {"assumed_noise_scale": [float("inf")]}}, "finite number"),
    ({"lti": KNOWN["lti"] | {"noise_std": [0.0], "assumed_noise_scale": 2.0}}, "whose assumed noise is 0"),
]


@pytest.mark.parametrize(("given", "sentence"), REFUSED, ids=[row[1] for row in REFUSED])
def test_what_cannot_be_is_one_sentence(given, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        pcbench.run(KNOWN | given, seeds=1)
    assert "\n" not in str(caught.value)
