"""Nothing is computed twice, and nothing is taken for another: designs are known by what they look at."""

import numpy as np
import pytest

from pcbench import planning
from pcbench.errors import UserError
from pcbench.planning import build, memo
from pcbench.study import parse
from pcbench.study.grid import cells_of

AXES = {"sampling_period": [0.2, 0.4], "noise_std": [0.1, 0.5], "parameter_drift": [0.0, 0.5]}
STUDY = {"name": "map", "scenarios": ["cart/gaussian"], "observers": ["kfbo", "kf"], "axes": AXES, "seeds": 2}


def counted(monkeypatch):
    """The names of the designs that are made from here on."""
    made, real = [], memo.designed

    def noted(label, entry, known, options):
        made.append(label)
        return real(label, entry, known, options)

    monkeypatch.setattr(memo, "designed", noted)
    return made


def test_a_design_is_found_once_for_all_cells_that_differ_in_nothing_it_looks_at(monkeypatch):
    made = counted(monkeypatch)
    cells = cells_of(parse.parse(STUDY, "map"))
    several = list(planning.drafts(cells))
    assert made.count("kfbo") == 2, "it looks at the period, neither at noise nor drift"
    assert made.count("kf") == 8, "it sees the noise, and what drift it has to expect"
    for p, cell in zip(several, cells, strict=True):
        alone = build.draft(cell, cell.options)
        assert memo.key_of(alone.problem.gains["kfbo"]) == memo.key_of(p.problem.gains["kfbo"])
        assert memo.key_of(alone.problem.gains["kf"].R) == memo.key_of(p.problem.gains["kf"].R)
        assert memo.key_of(alone.problem.params) == memo.key_of(p.problem.params)
        assert memo.key_of(alone.bound) == memo.key_of(p.bound)


class Fake:
    """A design whose look at the noise depends on the period."""

    __module__ = "pcbench.fake"

    def __init__(self):
        self.asked = 0

    def __call__(self, known, options):
        self.asked += 1
        return known.period, known.noise_std if known.period[0] > 200 else None


def test_a_design_that_looks_further_for_some_cells_is_not_taken_for_others(monkeypatch):
    monkeypatch.setattr(memo, "designed", lambda label, entry, known, options: entry.design(known, options))
    ask, design, options = memo.once(), Fake(), {}
    entry = kfbo_entry()._replace(design=design)
    known = [build.setting(cell) for cell in cells_of(parse.parse(STUDY, "map"))]
    for setting in [*known, *known]:
        got = memo.design(ask, "cell", "fake", entry, setting, options)
        assert got == (setting.period, setting.noise_std if setting.period[0] > 200 else None)
    assert design.asked <= 1 + 2 + 2, "the first, and every period and noise once what it looks at is known"


def kfbo_entry():
    return cells_of(parse.parse(STUDY, "map"))[0].entry("kfbo")


def test_a_watched_setting_notes_what_is_read_however_it_is_read():
    (cell, *_) = cells_of(parse.parse(STUDY, "map"))
    known = build.setting(cell)
    watched = memo.Watched(*known)
    assert watched.noise_variance == known.noise_variance
    assert watched.__dict__["read"] == {"noise_std"}
    assert watched._replace(dt=1.0).period == known.period
    assert watched.__dict__["read"] == set(known._fields)


def test_keys_tell_numbers_apart_to_the_bit():
    numbers = [0.0, -0.0, 0, False, "0", None, np.zeros(1), np.zeros((1, 1)), np.zeros(1, np.float32), (0.0,), [0.0]]
    assert len({memo.key_of(each) for each in numbers}) == len(numbers)
    assert memo.key_of(np.array([np.nan])) == memo.key_of(np.array([np.nan]))
    with pytest.raises(TypeError):
        memo.key_of(object())


def test_what_refuses_is_asked_again(monkeypatch):
    ask = memo.once()

    def refuses():
        raise UserError("no")

    with pytest.raises(UserError):
        ask("kind", 1, refuses)
    assert ask("kind", 1, lambda: 2) == 2
    assert [ask("kind", i, lambda i=i: i) for i in range(1000)] == [2 if i == 1 else i for i in range(1000)]
