"""What suffices, asked of runs: the answer stands in the tables of a study that goes on; a mistake is one sentence."""

import io
import re

import numpy as np
import pytest
from commands import call

import pcbench
from pcbench.cli.render import limits
from pcbench.cli.render.tables import Screen
from pcbench.dataset import verify
from pcbench.errors import DesignError, UserError
from pcbench.limits import find_limit
from pcbench.limits.search import axis_of, notes, question, scale_of
from pcbench.planning import memo
from pcbench.scenarios import SCENARIOS
from pcbench.statistics.limit_verdicts import EXCEEDS, SUFFICES, Point
from pcbench.study.load import raw_of
from pcbench.study.parse import FROM_HERE, build_study

pytestmark = pytest.mark.usefixtures("in_a_hurry")
ASKED = {"axis": "noise_std", "threshold": 0.2, "metric": "steady_rmse", "seeds": 16, "observers": ["kf", "model-only"]}
BETWEEN = {"between": (0.05, 3.2), "tol": 0.2, "max_seeds": 64}
TWO_CLOCKS = """
[lti]
A = [[0.0, 1.0], [-1.0, -0.4]]
B = [[0.0], [1.0]]
C = [[1.0, 0.0], [0.0, 1.0]]
sampling_period = [0.04, 0.02]
delay = [0.06, 0.02]
noise_std = [0.05, 0.1]
process_std = [0.0, 0.02]
tick = 0.02
duration = 2.0
observers = ["kf"]
"""


def refusals():
    return find_limit.Refusals({}, {}, {})


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    out = tmp_path_factory.mktemp("suffices") / "out"
    return pcbench.find_limit("cart/slow", out=out, **ASKED, **BETWEEN), out


@pytest.mark.ci
def test_the_answer_is_what_the_tables_say(asked):
    """By NumPy, from the runs themselves: the mean over seeds, and Student's interval of its logarithm."""
    table, out = asked
    row = table.set_index("observer").loc["kf"]
    assert row.answer == "up to"
    runs = pcbench.open_result(out).runs
    values = runs.steady_rmse[(runs.observer == "kf") & (runs.signal == "position") & (runs.noise_std == row.largest)]
    n, mean, t = len(values), values.mean(), {16: 2.131449545559323, 64: 1.998340542520746}
    if n in t:
        part = t[n] * values.std(ddof=1) / np.sqrt(n) / mean
        assert row.ci_high == pytest.approx(mean * np.exp(part), rel=1e-10)
    assert row["mean"] == pytest.approx(mean, rel=1e-12)
    assert row.ci_high < 0.2 < row.exceeds_ci_low
    assert row.largest < row.exceeds
    stats = pcbench.open_result(out).stats.query(
        "metric == 'steady_rmse' and signal == 'position' and observer == 'kf'"
    )
    sure = stats[(stats.ci_high < 0.2) & (stats.diverged == 0)].noise_std
    assert row.largest == sure.max()
    assert row["values"] == len(stats)
    assert table.attrs["unit"] == "m"


@pytest.mark.ci
def test_what_is_left_is_a_study_like_any_other(asked):
    _, out = asked
    found = verify.verify(out, 1, 0)
    assert (found.wrong, found.differing) == ([], [])
    assert all(share.seeds == share.wanted for share in verify.status(out).shares)


@pytest.mark.nightly
def test_asked_again_it_runs_nothing_and_of_another_limit_only_what_is_new(asked):
    table, out = asked
    before = {p: p.stat().st_mtime_ns for p in out.rglob("cell-*.parquet")}
    again = pcbench.find_limit("cart/slow", out=out, **ASKED, **BETWEEN)
    assert again.equals(table)
    assert {p: p.stat().st_mtime_ns for p in out.rglob("cell-*.parquet")} == before
    other = pcbench.find_limit("cart/slow", out=out, **ASKED | {"threshold": 0.5}, **BETWEEN)
    assert other.largest[0] > table.largest[0]
    assert before.items() <= {p: p.stat().st_mtime_ns for p in out.rglob("cell-*.parquet")}.items()


@pytest.mark.ci
def test_stopped_it_goes_on_to_the_same_answer(asked, tmp_path):
    table, _ = asked

    def stop(many):
        raise KeyboardInterrupt

    progress = pcbench.runtime.progress.Progress(step=stop)
    with pytest.raises(KeyboardInterrupt):
        pcbench.find_limit("cart/slow", out=tmp_path / "out", progress=progress, **ASKED, **BETWEEN)
    assert list((tmp_path / "out").rglob("cell-*.parquet")), "what is finished stands"
    done = pcbench.find_limit("cart/slow", out=tmp_path / "out", **ASKED, **BETWEEN)
    assert done.equals(table)


@pytest.mark.ci
def test_an_observer_without_gains_at_some_values_is_left_out_there(tmp_path, monkeypatch):
    real = memo.run_design

    def picky(observer, entry, known, given):
        if observer == "kf" and known.noise_std[0] > 1:
            raise DesignError("cart/slow: kf has no gains there.")
        return real(observer, entry, known, given)

    monkeypatch.setattr(memo, "run_design", picky)
    how = {"between": (0.5, 2.0), "tol": 1.0, "max_seeds": 4, "seeds": 4, "axis": "noise_std", "threshold": 1e3}
    table = pcbench.find_limit("cart/slow", observers=["kf", "model-only"], out=tmp_path / "out", **how)
    row = table.set_index("observer").loc["kf"]
    assert row.largest == 1.0
    assert "no gains there" in row.sentence
    assert table.set_index("observer").answer["model-only"] == "every value"
    assert verify.verify(tmp_path / "out", None, 0).differing == []
    monkeypatch.setattr(find_limit, "_without_gains", lambda cell, o: "nothing works.")
    with pytest.raises(UserError, match="nothing works"):
        pcbench.find_limit("cart/slow", observers=["kf"], **how | {"between": (1.5, 2.0)})


def test_a_frontier_has_the_largest_value_at_each_value_of_the_first_axis(tmp_path, monkeypatch):
    """Runs are replaced by an error of noise_std times sampling_period, below 0.3 up to 0.3 / sampling_period."""
    folders = []

    def look_of(q, folder, how):
        (period,) = q.study.axes["sampling_period"]
        folders.append(folder)

        def point(value):
            verdict = SUFFICES if value * period < q.threshold else EXCEEDS
            return Point(value, verdict, value * period, value * period, value * period, 4)

        return lambda values, seeds: {"kf": [point(v) for v in sorted(values)]}

    monkeypatch.setattr(find_limit, "look_of", look_of)
    how = {"threshold": 0.3, "tol": 0.01, "observers": ["kf"], "out": tmp_path / "out"}
    study = {"name": "f", "scenarios": ["cart/slow"], "axes": {"sampling_period": [1.0, 0.5], "noise_std": [0.1, 1.7]}}
    table = pcbench.find_limit(study, axis=["sampling_period", "noise_std"], **how)
    assert list(table.columns[:2]) == ["sampling_period", "observer"]
    assert list(table.sampling_period) == [0.5, 1.0]
    np.testing.assert_allclose(table.largest, [0.6, 0.3], atol=0.01)
    assert (table.largest <= 0.3 / table.sampling_period).all()
    assert table.attrs["over"] == ["sampling_period", "noise_std"]
    assert table.attrs["between"] == [(0.5, 1.0), (0.1, 1.7)]
    assert folders == [f"{tmp_path}/out/sampling_period={v}" for v in ("0.5", "1")]
    ranges = pcbench.find_limit(study, axis=["sampling_period", "noise_std"], between=[(0.4, 2.0), (0.05, 0.4)], **how)
    assert list(ranges.sampling_period) == [0.4, 0.5, 0.6, 0.9, 1.0, 1.3, 2.0], "five of the range, and the study's two"
    assert list(ranges.answer[:1]) == ["every value"]
    second = pcbench.find_limit(study, axis=["sampling_period", "noise_std"], between=[None, (0.05, 0.4)], **how)
    assert second.attrs["between"] == [(0.5, 1.0), (0.05, 0.4)]
    screen = Screen(file=io.StringIO(), width=100)
    limits.frontier(table, screen)
    assert re.search(r"0\.5 +0\.59\b.*\n +1 +0\.29\b", screen.file.getvalue()), screen.file.getvalue()


@pytest.mark.parametrize(
    ("axis", "words"),
    [
        (["delay", "loss", "noise_std"], "got 3 axes, expected one or two"),
        (["delay", "delay[0]"], "got delay twice"),
        (["delay", "nothing"], "nothing"),
    ],
)
def test_a_frontier_of_other_than_two_axes_is_one_sentence(axis, words):
    with pytest.raises(UserError, match=words):
        pcbench.find_limit("cart/slow", axis=axis, threshold=1.0)


@pytest.mark.parametrize("between", [(0.1, 0.2, 0.3), (0.1, None), [(0.1, 0.2)], [(0.1, 0.2, 0.3), None], 0.1])
def test_a_frontier_of_a_malformed_range_is_one_sentence(between):
    with pytest.raises(UserError, match=r"^between: got .*, expected the two ends of a range for one axis"):
        pcbench.find_limit("cart/slow", axis=["sampling_period", "noise_std"], between=between, threshold=1.0)


def axis_question(study, axis):
    raw = raw_of(study, [], FROM_HERE)
    return question(build_study(raw, "x", FROM_HERE), "x", axis, "rmse", None, 0.1)


def test_an_observer_that_cannot_be_run_over_the_axis_is_left_out_and_says_so():
    q, why = (
        axis_question({"name": "x", "scenarios": ["cart/slow"], "observers": ["kfbo", "kf"]}, "delay_jitter"),
        refusals(),
    )
    grid = find_limit._grid(q, [0.0, 0.2], why)
    assert [list(cell.options) for cell in grid.cells] == [["kf"], ["kf"]]
    assert grid.study.observers == ["kf"]
    assert "expected one constant delay" in why.observers["kfbo"]


def test_a_value_at_which_the_scenario_does_not_fit_together_is_left_out():
    q, why = axis_question("cart/slow", "sampling_jitter"), refusals()
    assert [cell.scenario.sampling.sampling_jitter for cell in find_limit._grid(q, [0.1, 0.6], why).cells] == [0.1]
    assert "half the shortest interval" in why.values[0.6]
    with pytest.raises(UserError, match="half the shortest interval"):
        find_limit._grid(q, [0.6], why)


def test_one_of_several_channels_is_varied_and_the_others_stay(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(TWO_CLOCKS)
    q = axis_question(path, "delay[0]")
    cells = find_limit._grid(q, [0.02, 0.06], refusals()).cells
    assert [cell.scenario.sampling.delay for cell in cells] == [(0.02, 0.02), (0.06, 0.02)]
    assert list(find_limit._by_value(q, cells)) == [0.02, 0.06]
    with pytest.raises(UserError, match=r"whose 2 numbers differ in lti .*write delay\[0\]"):
        axis_question(path, "delay")


@pytest.mark.parametrize(
    ("name", "ends"),
    [
        ("sampling_period", (0.001, 1.75)),
        ("delay", (0.0, 1.75)),
        ("loss", (0.0, 0.9)),
        ("noise_std", (0.06, 6.0)),
        ("plant.lam", (122.0, 244.0)),
        ("parameter_drift", (0.0, 2.0)),
        ("sampling_jitter", (0.0, 0.099)),
    ],
)
def test_a_scenario_suggests_where_to_search(name, ends):
    s = SCENARIOS["cart/white"]
    axis = axis_of(name, s, None, s.name)
    assert scale_of(axis, s, None, None)[:2] == ends
    assert scale_of(axis_of(name, s, [ends[0], ends[1]], s.name), s, None, None)[:2] == ends, (
        "or the study's own values"
    )


BAD = {
    "axis": ({"axis": "sampling_perod"}, "'sampling_perod' is no axis of cart/slow; did you mean 'sampling_period'"),
    "words": ({"axis": "sampling_pattern"}, "whose values are words"),
    "no channel": ({"axis": "loss[0]"}, "where loss is one number"),
    "channel": ({"axis": "delay[1]"}, "expected delay[0] to delay[0]"),
    "metric": ({"metric": "rmsd"}, "'rmsd' is no metric to be kept below a limit; did you mean 'rmse'"),
    "more coverage is better": ({"metric": "interval_coverage"}, "whose smaller values are not better"),
    "less is not better": ({"metric": "rms_efficiency"}, "whose smaller values are not better"),
    "not of this scenario": ({"metric": "tracking_rmse"}, "tracking_rmse of position, which cart/slow does not have"),
    "signal": ({"signal": "posision"}, "did you mean 'position'"),
    "limit": ({"threshold": 0.0}, "--threshold: got 0, expected a number above 0"),
    "no limit": ({"threshold": float("nan")}, "--threshold: got nan"),
    "range": ({"between": (0.4, 0.2)}, "expected the lower end first; write --range 0.2 0.4"),
    "half a tick": ({"axis": "delay", "between": (0.0, 0.2005)}, "--range: got 0.2005 s, expected a whole number"),
    "no range": (
        {"axis": "plant.input_bias", "between": None},
        "--range: cart/slow suggests none for plant.input_bias",
    ),
    "precision": ({"axis": "delay", "tol": 1e-4, "between": None}, "at least a tick, 0.001 s"),
    "budget": ({"max_seeds": 0}, "--max-seeds: got 0"),
    "two scenarios": ({"study": "cart"}, "got 6 scenarios, expected one"),
    "another axis": ({"overrides": ["axes.delay=[0.1,0.2]"]}, "axes.delay: got 2 values, expected one while noise_std"),
}


@pytest.mark.ci
@pytest.mark.parametrize("name", BAD)
def test_a_question_without_an_answer_is_one_sentence(name, tmp_path):
    changes, said = BAD[name]
    asked = {"study": "cart/slow", **ASKED, "seeds": 2, "between": (0.5, 1.0), "out": tmp_path / "out"} | changes
    with pytest.raises(UserError) as caught:
        pcbench.find_limit(asked.pop("study"), **asked)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_where_a_plant_decays_by_itself_it_is_said(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(TWO_CLOCKS.replace("process_std = [0.0, 0.02]", ""))
    assert "the model alone wins in the end" in notes(axis_question(path, "delay[0]"))[-1]
    path.write_text(TWO_CLOCKS)
    assert len(notes(axis_question(path, "delay[0]"))) == 1


@pytest.mark.ci
def test_the_command_shows_a_row_for_each_observer_and_where_it_stands(asked, tmp_path):
    table, out = asked
    words = ["--axis", "noise_std", "--threshold", 0.2, "--seeds", 16, "--observers", "kf,model-only"]
    words += ["--range", 0.05, 3.2, "--tol", 0.2, "--max-seeds", 64, "--out", out]
    done = call("find-limit", "cart/slow", *words)
    assert done.returncode == 0, done.stderr
    assert f"{table.largest[0]:g}" in done.stdout
    assert "cart/slow: steady_rmse of position below 0.2 m, over noise_std from 0.05 to 3.2" in done.stdout
    assert f"pcbench report {out}" in done.stdout
