"""Tuning: free parameters, ways down, going on after a stop, judged on other seeds, one sentence for every mistake."""

import json
import shlex

import numpy as np
import pandas as pd
import pytest
from commands import call
from documents import code_blocks
from hypothesis import given
from hypothesis import strategies as st
from interruptions import stop_tuning_at

import pcbench
from pcbench.dataset.seed_ranges import seed_range
from pcbench.errors import UserError
from pcbench.gains import optimizers, parameters, tune
from pcbench.gains.history import Judgement
from pcbench.gains.objective import Objective
from pcbench.gains.validation import rejection_reason
from pcbench.observers import OBSERVERS, entry_of

SMALL = {"budget": 6, "training_seeds": (0, 16), "validation_seeds": (100, 140), "objective": "steady_rmse"}
START = {"pccebo": {"L": [[0.9], [0.0]]}, "pco": {"Kp": -3.0}, "pi-pco": {"Kp": -3.0, "Ki": 0.5}}
START["lmi-sampled"] = {"L": [[0.9], [0.4]]}
START["high-gain-predictor"] = {"theta": 4.0}


def options(observer):
    return entry_of(observer).options.model_validate(START.get(observer, {}))


@pytest.mark.ci
@pytest.mark.parametrize(
    "observer", [name for name, entry in OBSERVERS.items() if parameters.tunable(entry) and name != "model-only"]
)
@given(data=st.data())
def test_every_vector_of_numbers_is_an_option(observer, data):
    numbers = {"R": 0.3, "q": 0.0}
    found, at = parameters.start(observer, OBSERVERS[observer], options(observer), numbers, None, "test")
    there = np.array(data.draw(st.lists(st.floats(-20, 20), min_size=len(at), max_size=len(at))))
    made = parameters.with_values(options(observer), found, there)
    again, back = parameters.start(observer, OBSERVERS[observer], made, numbers, [f.name for f in found], "test")
    for f, g in zip(found, again, strict=True):
        mine, its = there[f.first : f.first + f.size], back[g.first : g.first + g.size]
        if f.kind == "real":
            np.testing.assert_allclose(its * g.scale, mine * f.scale, rtol=1e-12, atol=1e-14 * f.scale)
        else:
            np.testing.assert_allclose(its, mine, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("metric", ["rmse", "pooled_rmse", "steady_pooled_rmse"])
def test_a_goals_slope_is_its_derivative_and_a_lost_run_has_no_number(metric):
    goal, runs, lost = Objective(metric, 0, "x", "m"), np.array([4.0, 9.0, 1.0]), np.zeros(3, bool)
    assert goal.slope(2.0) == pytest.approx((goal.from_mean(2.0 + 1e-6) - goal.from_mean(2.0 - 1e-6)) / 2e-6, rel=1e-8)
    assert goal.from_runs(runs, lost) == goal.from_mean(14 / 3)
    assert goal.from_runs(runs, np.array([False, True, False])) == np.inf


def test_a_slope_beside_what_is_refused_is_taken_from_the_middle():
    def design(at):
        if at[0] > most:
            raise UserError("mine: got too much, expected less; take less.")
        return {"L": np.array([3 * at[0] + at[1], at[1]]), "room": np.arange(2)}

    slopes, at, most = [np.array([1.0, 10.0])], np.array([1.0, 0.0]), 2.0
    for most in (2.0, 1.0):
        np.testing.assert_allclose(optimizers.chain(slopes, design, at), [3.0, 11.0], rtol=1e-9)


JUDGED = Judgement(
    what="validation", seeds=seed_range(100, 64), start=2.0, start_se=0.1, tuned=1.0, tuned_se=0.1,
    difference=-1.0, difference_se=0.1, diverged=(0, 0),
)  # fmt: skip


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({}, ""),
        ({"difference": 0.19}, ""),  # less than two standard errors
        ({"difference": 0.21}, "worse than its start on the validation runs by 0.21"),
        ({"diverged": (3, 2)}, ""),
        ({"diverged": (2, 3)}, "3 of 64 validation runs diverge, 2 with the start"),
        ({"difference": np.nan, "diverged": (64, 64)}, "64 of 64 validation runs diverge, as with the start"),
    ],
)
def test_what_is_found_is_used_where_the_judging_runs_do_not_speak_against_it(changes, why):
    said = rejection_reason([JUDGED._replace(what="training"), JUDGED._replace(**changes)])
    assert said.startswith(why)
    assert bool(said) == bool(why)


def bowl(at):
    """A long valley with its least at (1, 2), refused beyond 3."""
    gap = at - np.array([1.0, 2.0])
    value = gap[0] ** 2 + 100 * (gap[1] - gap[0]) ** 2
    slope = np.array([2 * gap[0] - 200 * (gap[1] - gap[0]), 200 * (gap[1] - gap[0])])
    return (np.inf, np.full(2, np.nan)) if at.max() > 3 else (value, slope)


def evaluations(way, start, budget, value_only=False):
    """The points that a way asks for, with their values."""
    points = []

    def ask(at):
        value, slope = bowl(at)
        points.append((at.copy(), value))
        return value if value_only else (value, slope)

    way(ask, np.array(start), budget)
    return points


@pytest.mark.parametrize(
    "start", [(2.9, -4.0), *(pytest.param(p, marks=pytest.mark.nightly) for p in ((0.0, 0.0), (-3.0, 2.9)))]
)
def test_both_ways_go_down_past_what_is_refused_and_keep_to_their_budget(start):
    for way, alone, budget in ((optimizers.descent, False, 60), (optimizers.search, True, 150)):
        points = evaluations(way, start, budget, alone)
        assert len(points) <= budget
        assert min(value for _, value in points) < 1e-5, way
        assert len(evaluations(way, start, 5, alone)) <= 5
        for (a, x), (b, y) in zip(points, evaluations(way, start, budget, alone), strict=True):
            assert (a == b).all(), "the same again"
            assert x == y


@pytest.mark.nightly
def test_a_tuning_that_was_stopped_goes_on_where_it_was(tmp_path, monkeypatch):
    whole = pcbench.tune("cart/slow", "pccebo", out=tmp_path / "whole", **SMALL)
    count = stop_tuning_at(4, monkeypatch)
    with pytest.raises(KeyboardInterrupt):
        pcbench.tune("cart/slow", "pccebo", out=tmp_path / "out", **SMALL)
    again = pcbench.tune("cart/slow", "pccebo", out=tmp_path / "out", **SMALL)
    assert count[0] == 4 + len(whole.points) - 3, "three points were not asked for again"
    assert [p[:3] for p in again.points] == [p[:3] for p in whole.points]
    assert again.best == whole.best
    for name in ("tuned.toml",):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    history = pd.read_parquet(tmp_path / "out" / "history.parquet")
    assert list(history.columns) == [
        "point",
        "free.L[0]",
        "free.L[1]",
        "objective",
        "slope.L[0]",
        "slope.L[1]",
        "seconds",
    ]
    assert history.objective.min() == min(p.value for p in whole.points)
    with pytest.raises(UserError, match="contains another tuning"):
        pcbench.tune("cart/slow", "pccebo", out=tmp_path / "out", **SMALL | {"objective": "mae"})
    (tmp_path / "out" / "history.parquet").write_bytes(b"PAR1")
    with pytest.raises(UserError, match="is damaged"):
        pcbench.tune("cart/slow", "pccebo", out=tmp_path / "out", **SMALL)


@pytest.mark.nightly
def test_what_is_found_runs_as_a_study_and_gives_the_numbers_it_was_judged_by(tmp_path):
    found = pcbench.tune("cart/gaussian", "pccebo", out=tmp_path / "out", **SMALL)
    (training, judging) = found.judgements
    assert training.tuned == pytest.approx(min(p.value for p in found.points), rel=1e-12)
    assert training.start == pytest.approx(found.points[0].value, rel=1e-12)
    result = pcbench.run(tmp_path / "out" / "tuned.toml", seeds=40, first_seed=100)
    (row,) = result.stats.query("signal == 'position' and metric == 'steady_rmse'").to_dict("records")
    assert row["mean"] == pytest.approx(judging.tuned, rel=1e-12)
    assert not found.kept_start
    assert judging.tuned < 0.8 * judging.start


@pytest.mark.nightly
def test_a_start_that_cannot_be_bettered_is_kept_and_said(monkeypatch, tmp_path):
    """What was found is made worse than it is: nothing that is worse on other seeds is handed out."""
    real = tune.judge
    monkeypatch.setattr(tune, "judge", lambda study, o, found, *how: real(study, o, {"L": [[1.9], [0.0]]}, *how))
    found = pcbench.tune("cart/slow", "pccebo", out=tmp_path / "out", **SMALL)
    assert "worse than its start on the validation runs" in found.kept_start
    assert "L" not in (tmp_path / "out" / "tuned.toml").read_text().partition("options")[2]


@pytest.mark.nightly
def test_an_observer_without_slopes_is_searched():
    given = SMALL | {"training_seeds": (0, 4), "validation_seeds": (10, 14), "budget": 5}
    found = pcbench.tune("cart/slow", "pccebo", **given | {"objective": "settling_time"})
    assert found.method == "search"
    assert len(found.points) == 5


MISTAKES = {
    ("cart/slow", "model-only"): "without free parameters",
    ("cart/slow", "pccebo", "--objective", "beauty"): "'beauty' is no metric to tune for",
    ("cart/slow", "pccebo", "--budget", "0"): "--budget: got 0, expected 1 or more",
    ("cart/slow", "pccebo", "--training-seeds", "0:64", "--validation-seeds", "63:99"): "which overlap",
    ("cart/slow", "pccebo", "--training-seeds", "5"): "expected FIRST:END",
    ("cart/slow", "pccebo", "--training-seeds", "0:1"): "two seeds or more",
    ("cart/slow", "pccebo", "--signal", "speed"): "'speed' is no signal",
    ("cart/slow", "pccebo", "--only", "gain"): "got 'gain' to tune, expected L",
    ("cart/slow", "pccebo", "--optimizer", "prayer"): "expected descent or search",
    ("cart/slow", "pccebo", "--objective", "settling_time", "--optimizer", "descent"): "settling_time has no gradient",
    ("cart/slow", "pccebo", "--set", "options.pccebo.L=[[2.5],[0.0]]"): "is not certified",
    ("cart/slow", "pccebo", "--set", "options.pccebo.L=[[2.5]]"): "expected a matrix of shape [2, 1]",
    ("cart/slow", "nobody"): "'nobody' is no observer",
    ("variable-sampling", "pco"): "expected one here",
}


@pytest.mark.ci
@pytest.mark.parametrize("words", MISTAKES, ids=" ".join)
def test_mistakes_are_one_sentence(words, tmp_path):
    done = call("tune", *words, cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert MISTAKES[words] in done.stderr
    assert done.stderr.count("\n") == 1, done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.nightly
def test_the_command_says_what_it_found(tmp_path):
    words = [
        "cart/slow",
        "pccebo",
        "--budget",
        "2",
        "--training-seeds",
        "0:4",
        "--validation-seeds",
        "4:8",
        "--out",
        str(tmp_path / "out"),
    ]
    done = call("tune", *words)
    assert "tuned - start" in done.stdout, done.stderr
    assert "Compare it: pcbench run" in done.stdout
    again = json.loads(call("tune", *words, "--json").stdout)
    assert again["points"] == 2
    assert again["goal"] == {"metric": "rmse", "signal": "position", "unit": "m"}


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["kf", "mine.py:nudge"])
def test_the_printed_command_compares_what_was_tuned(observer, tmp_path):
    (page,) = (b.text for b in code_blocks("your_own_observer.md") if b.title == "mine.py")
    (tmp_path / "mine.py").write_text(page)
    words = ["--budget", "2", "--training-seeds", "0:4", "--validation-seeds", "4:8", "--out", "out"]
    done = call("tune", "cart/white", observer, *words, cwd=tmp_path)
    printed = next(line for line in done.stdout.splitlines() if line.startswith("Compare it: pcbench "))
    again = call(*shlex.split(printed)[3:], "--seeds", "2", cwd=tmp_path)
    assert again.returncode == 0, again.stderr
    assert observer.rpartition(":")[2] in again.stdout


@pytest.mark.ci
def test_options_of_another_observer_have_no_part_in_a_tuning(tmp_path):
    scenario = {"name": "two", "scenarios": ["cart/white"], "observers": ["kf", "pccebo"]}
    studies = [scenario | {"options": {"pccebo": {"q": R}}} for R in (0.02, 0.03)]
    one, two = (
        tune.tune(each, "kf", budget=2, training_seeds=(0, 4), validation_seeds=(4, 8), out=tmp_path / "t")
        for each in studies
    )
    assert (one.best, one.judgements) == (two.best, two.judgements)
