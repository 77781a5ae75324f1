"""Nothing expensive is computed twice, and nothing is taken for another."""

import numpy as np
import pytest

from pcbench import planning
from pcbench.errors import UserError
from pcbench.planning import build, memo
from pcbench.study import parse
from pcbench.study.grid import cells_of
from pcbench.synthesis import riccati, solvers
from pcbench.value_cache import key_of

AXES = {"sampling_period": [0.2, 0.4], "noise_std": [0.1, 0.5], "parameter_drift": [0.0, 0.5]}
STUDY = {"name": "map", "scenarios": ["cart/gaussian"], "observers": ["pccebo", "kf"], "axes": AXES, "seeds": 2}


def count_calls(monkeypatch, module, name):
    """The calls of a function of a module from here on."""
    calls, real = [], getattr(module, name)

    def noted(*args):
        calls.append(args)
        return real(*args)

    monkeypatch.setattr(module, name, noted)
    return calls


def test_what_is_expensive_in_designs_is_computed_once_for_all_cells_that_differ_in_nothing_it_reads(
    monkeypatch, tmp_path
):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    solved = count_calls(monkeypatch, solvers, "minimise")
    cells = cells_of(parse.parse(STUDY, "map"))
    several = list(planning.drafts(cells[:1]))
    once = len(solved)
    riccati.multirate.cache_clear()
    several = list(planning.drafts(cells))
    assert once, "pccebo solves a matrix inequality"
    assert len(solved) == 2 * once, "it reads the period, neither noise nor drift"
    assert riccati.multirate.cache_info().misses == 8, "kf sees the noise, and what drift it has to expect"
    for p, cell in zip(several, cells, strict=True):
        alone = build.draft(cell, cell.options)
        assert key_of(alone.problem.gains["pccebo"].L) == key_of(p.problem.gains["pccebo"].L)
        assert key_of(alone.problem.gains["kf"].R) == key_of(p.problem.gains["kf"].R)
        assert key_of(alone.problem.params) == key_of(p.problem.params)
        assert key_of(alone.bound) == key_of(p.bound)


def test_a_design_is_made_once_though_its_cell_is_laid_out_twice(monkeypatch):
    made, cache = count_calls(monkeypatch, memo, "run_design"), memo.new_cache()
    cells = cells_of(parse.parse(STUDY, "map"))
    first, second = (list(planning.drafts(cells, cache=cache)) for _ in range(2))
    assert len(made) == len(cells) * 2
    assert all(a.problem.gains["kf"] is b.problem.gains["kf"] for a, b in zip(first, second, strict=True))


def test_keys_tell_numbers_apart_to_the_bit():
    numbers = [0.0, -0.0, 0, False, "0", None, np.zeros(1), np.zeros((1, 1)), np.zeros(1, np.float32), (0.0,), [0.0]]
    assert len({key_of(number) for number in numbers}) == len(numbers)
    assert key_of(np.array([np.nan])) == key_of(np.array([np.nan]))
    with pytest.raises(TypeError):
        key_of(object())


def test_what_refuses_is_asked_again(monkeypatch):
    cache = memo.new_cache()

    def refuses():
        raise UserError("no")

    with pytest.raises(UserError):
        cache("kind", 1, refuses)
    assert cache("kind", 1, lambda: 2) == 2
    assert [cache("kind", i, lambda i=i: i) for i in range(1000)] == [2 if i == 1 else i for i in range(1000)]


def test_bound_of_a_scenario_is_the_same_whatever_stands_before_it():
    """Of scenarios whose noise is correlated differently, in either order."""
    base = {"base": "camera-target/camera", "delay": 0.1, "sampling_period": 0.1, "duration": 1.0, "steady_start": 0.5}
    two = {name: base | {"noise_correlation": [[1.0, rho], [rho, 1.0]]} for name, rho in (("p", 0.0), ("q", 0.9))}

    def bounds(names):
        study = parse.parse({"name": "b", "scenarios": names, "tables": two, "observers": ["kf"]}, "b")
        return {p.cell.scenario.name: p.bound for p in planning.drafts(cells_of(study))}

    forwards, backwards = bounds(["p", "q"]), bounds(["q", "p"])
    for name in two:
        np.testing.assert_array_equal(forwards[name], backwards[name])
    assert np.abs(forwards["p"] - forwards["q"]).max() > 1e-6
