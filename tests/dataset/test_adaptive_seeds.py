"""Seeds are added until a standard error is reached or the budget ends; the same command then adds none."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench import statistics
from pcbench.dataset import adaptive_seeds
from pcbench.errors import UserError

pytestmark = pytest.mark.usefixtures("in_a_hurry")
STUDY = {
    "name": "until",
    "scenario": {"base": "cart/slow", "duration": 4.0, "steady_start": 2.0},
    "observers": ["pccebo", "kfbo"],
    "seeds": 64,
    "axes": {"noise_std": [0.0, 0.1, 0.5]},
}


@pytest.fixture(scope="module")
def done(tmp_path_factory, in_a_hurry):
    out = tmp_path_factory.mktemp("until") / "out"
    return pcbench.run(STUDY, out=out, until_se="steady_rmse=0.002", max_seeds=3000)


@pytest.mark.ci
def test_every_observer_of_every_cell_reaches_the_goal_or_the_budget(done):
    rows = done.stats[(done.stats.metric == "steady_rmse") & (done.stats.signal == "position")]
    for _, cell in rows.groupby("cell"):
        n = cell.n.iloc[0]
        assert (cell.n == n).all(), "observers of a cell have the same seeds"
        assert cell.se.max() <= 0.002 or n == 3000
    n = rows.groupby("noise_std").n.first()
    assert n[0.0] == 64, "runs that do not vary have reached it"
    assert 64 < n[0.1] < n[0.5]


@pytest.mark.ci
def test_no_more_seeds_are_added_than_were_needed(done):
    """The prediction from the first 64 seeds is at most a third off, with its margin of 5 %."""
    rows = done.stats[
        (done.stats.metric == "steady_rmse") & (done.stats.signal == "position") & (done.stats.noise_std == 0.1)
    ]
    worst = rows.loc[rows.se.idxmax()]
    needed = worst.n * (worst.se / 0.002) ** 2
    assert needed <= worst.n < 1.5 * needed


@pytest.mark.ci
def test_the_same_command_again_adds_nothing(done):
    before = {p: p.stat().st_mtime_ns for p in done.out.rglob("*.parquet")}
    pcbench.run(STUDY, out=done.out, until_se="steady_rmse=0.002", max_seeds=3000)
    pcbench.run(STUDY, out=done.out)
    assert {p: p.stat().st_mtime_ns for p in done.out.rglob("*.parquet")} == before


@pytest.mark.ci
def test_a_run_that_was_stopped_ends_as_one_that_was_not(done, tmp_path):
    """Blocks of the last round are lost, of some observers more than of others; a plain run levels them, the goal stays."""
    out = shutil.copytree(done.out, tmp_path / "out")
    want = {p.relative_to(out): p.read_bytes() for p in out.rglob("*.parquet")}
    for path in [*out.rglob("observer=kfbo/cell-00002-*"), *list(out.rglob("observer=pccebo/cell-00001-*"))[1:]]:
        path.unlink()
    plain = pcbench.run(STUDY, out=shutil.copytree(out, tmp_path / "plain"))
    assert plain.stats.groupby(["cell", "metric"]).n.nunique().max() == 1
    pcbench.run(STUDY, out=out, until_se="steady_rmse=0.002", max_seeds=3000)
    for name in ("stats.parquet", "pairs.parquet"):
        assert (out / name).read_bytes() == want[Path(name)]


@pytest.mark.ci
def test_seeds_that_were_added_are_those_that_a_longer_study_has(done, tmp_path):
    many = int(done.stats[done.stats.noise_std == 0.1].n.max())
    at_once = pcbench.run(STUDY | {"axes": {"noise_std": [0.1]}, "seeds": many}, out=tmp_path / "out")
    key = ["observer", "seed", "signal"]
    a, b = (
        pd.DataFrame(r[r.noise_std == 0.1]).sort_values(key, ignore_index=True).drop(columns="cell")
        for r in (done.runs, at_once.runs)
    )
    pd.testing.assert_frame_equal(a, b, check_exact=True)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("mae", "expected METRIC=VALUE"),
        ("mae=", "expected METRIC=VALUE"),
        ("mae=0", "above 0"),
        ("mae=nan", "above 0"),
        ("mae=-1", "above 0"),
        ("meanae=0.1", "did you mean 'mae'"),
        ("mae.posision=0.1", "did you mean 'position'"),
    ],
)
def test_a_goal_that_is_none_is_one_sentence(tmp_path, text, said):
    with pytest.raises(UserError, match=said) as caught:
        pcbench.run(STUDY, out=tmp_path / "out", until_se=text)
    assert "\n" not in str(caught.value)
    assert not (tmp_path / "out").exists(), "nothing is written"


@pytest.mark.ci
def test_a_metric_that_a_scenario_lacks_is_one_sentence(done):
    with pytest.raises(UserError, match="tracking_rmse of position, which until does not have"):
        pcbench.run(STUDY, out=done.out, until_se="tracking_rmse=0.1")


@pytest.mark.parametrize(("has", "error", "goal"), [(64, 0.3, 0.1), (100, 0.11, 0.1), (256, 0.05, 0.013)])
def test_so_many_seeds_are_asked_for_that_the_error_reaches_its_goal_by_its_root_with_a_margin(has, error, goal):
    """The error falls with the root of the seeds: with as many as are asked for it is 2.5 % below the goal, no more."""
    then = error * np.sqrt(has / adaptive_seeds.seeds_for(has, error, goal))
    assert 0.97 * goal < then < 0.98 * goal
    assert adaptive_seeds.seeds_for(has, goal, goal) == has
    assert adaptive_seeds.seeds_for(has, 0.9 * goal, goal) == has
    assert adaptive_seeds.seeds_for(has, 100 * goal, goal) == adaptive_seeds.GROWTH * has, (
        "a round adds so much at most"
    )


def test_one_seed_is_no_standard_error():
    assert adaptive_seeds.seeds_for(1, np.inf, 0.1) == adaptive_seeds.GROWTH


def test_stopping_at_a_standard_error_hardly_narrows_the_intervals():
    """The rule of `adaptive_seeds` on a skewed metric: 95 % intervals hold the mean in 93.5 to 96.5 % of experiments."""
    rng, held, repeats = np.random.default_rng(8), 0, 4000
    for _ in range(repeats):
        values = rng.gamma(4.0, size=256)
        row = statistics.size(values)
        more = adaptive_seeds.seeds_for(len(values), row["se"], 0.07)
        values = np.concatenate([values, rng.gamma(4.0, size=more - len(values))])
        row = statistics.size(values)
        held += row["ci_low"] <= 4.0 <= row["ci_high"]
    assert 0.935 <= held / repeats <= 0.965
