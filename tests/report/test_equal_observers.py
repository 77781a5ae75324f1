"""Observers that do not differ share the first row of a report: it names them, in how many cells."""

import pandas as pd

from pcbench.report.summary import _said

NONE = pd.Series(dtype=int)


def standings(*sets):
    rows = [{"winner": "", "best": each[0] if each else "", "alike": tuple(each[1:]), "p": 0.5} for each in sets]
    return pd.DataFrame(rows)


def test_a_draw_in_every_cell_names_the_observers_that_are_as_good():
    found = standings(*[("kf", "kf-shift")] * 4, ("kf-shift", "kf"))
    assert _said(found, NONE, "", False, 64) == "as good as the best: kf, kf-shift in 5 of 5 cells"


def test_an_observer_that_is_as_good_in_fewer_cells_is_not_named():
    found = standings(("kf", "pco"), ("kf", "ekf"), ("ekf", "kf"), ())
    assert _said(found, NONE, "", False, 64) == "as good as the best: kf in 3 of 4 cells"


def test_cells_in_which_all_diverge_have_no_best():
    assert _said(standings((), ()), NONE, "", False, 64) == "all diverge"
