"""Two results of one study: equal where they must be, changed where they are, other studies refused."""

import json
import shutil
from pathlib import Path

import hurried
import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from commands import call
from scipy.stats import ttest_ind_from_stats
from small_study import STUDY, reseal

import pcbench
from pcbench.dataset import compare, merge, parquet_io, storage
from pcbench.errors import UserError


@pytest.fixture(scope="module")
def elsewhere(tmp_path_factory):
    """The same study on other draws."""
    out = tmp_path_factory.mktemp("other") / "out"
    pcbench.run(STUDY, out=out, first_seed=40)
    return out


def stepwise(p):
    """Holm's adjustment by its definition: the i-th smallest of m times m - i, never less than the one before."""
    out, least, known = [np.nan] * len(p), 0.0, sorted((v, i) for i, v in enumerate(p) if v == v)
    for place, (value, i) in enumerate(known):
        least = max(least, min(1.0, value * (len(known) - place)))
        out[i] = least
    return out


def change(out, column, factor, rows):
    """Multiply numbers of stats.parquet, as another release might."""
    place = storage.target(out)
    table = parquet_io.parse_table(storage.read_buffer(place, "stats.parquet"))
    frame = table.to_pandas()
    chosen = frame.eval(rows)
    assert chosen.any()
    values = frame[column].where(~chosen, frame[column] * factor)
    i = table.schema.get_field_index(column)
    storage.write_table(
        place, "stats.parquet", table.set_column(i, table.schema.field(i), pa.array(values, pa.float64()))
    )
    reseal(out)


@pytest.mark.ci
def test_a_result_equals_itself_bit_for_bit(whole, copy):
    found = compare.compare(whole, copy)
    assert len(found.rows) == len(pd.read_parquet(whole / "stats.parquet"))
    assert (found.changed, found.only, found.made_by) == (0, (0, 0), [])
    assert found.identical
    assert found.largest == 0
    done = call("compare", whole, copy)
    assert done.returncode == 0, done.stderr
    assert "bit for bit equal" in done.stdout


def test_rounding_is_no_change_and_its_size_is_said(whole, copy):
    change(copy, "mean", 1 + 3e-13, "metric == 'mae' and signal == 'position'")
    found = compare.compare(whole, copy)
    assert found.changed == 0
    assert not found.identical
    assert found.largest == pytest.approx(3e-13, rel=0.01, abs=0)
    assert "at most 3.0e-13" in call("compare", whole, copy).stdout


def test_welch_and_holm_agree_with_scipy_on_other_draws(whole, elsewhere):
    rows = compare.compare(whole, elsewhere).rows
    assert not rows.same_draws.any()
    tested = rows[rows.p_value.notna()]
    assert len(tested) >= 50
    for r in tested.itertuples():
        sides = [(m, se * np.sqrt(n), n) for m, se, n in ((r.mean_a, r.se_a, r.n_a), (r.mean_b, r.se_b, r.n_b))]
        expected = ttest_ind_from_stats(*sides[0], *sides[1], equal_var=False).pvalue
        assert r.p_value == pytest.approx(expected, rel=1e-9), r
        assert r.difference == r.mean_b - r.mean_a
    np.testing.assert_allclose(rows.p_holm, stepwise(list(rows.p_value)), rtol=1e-12)
    assert not rows.changed.any(), "both are draws of one distribution"


def test_unequal_numbers_of_runs_count_as_they_are():
    p = compare.welch(*(np.array([v]) for v in (1.0, 0.1, 20.0, 1.3, 0.05, 7.0)))
    expected = ttest_ind_from_stats(1.0, 0.1 * 20**0.5, 20, 1.3, 0.05 * 7**0.5, 7, equal_var=False).pvalue
    assert p[0] == pytest.approx(expected, rel=1e-12)
    assert np.isnan(compare.welch(*(np.array([v]) for v in (1.0, 0.1, 1.0, 1.3, 0.1, 7.0)))[0]), "one run"


def test_what_changed_is_named_first_and_counted(whole, elsewhere, tmp_path):
    here = tmp_path / "here"
    pcbench.run(STUDY, out=here, first_seed=40)
    change(here, "mean", 1.5, "metric == 'mae' and signal == 'position' and observer == 'kfbo' and cell == 1")
    found = compare.compare(whole, here)
    first = found.rows.iloc[0]
    assert found.changed == 1
    assert (first.observer, first.signal, first.metric, first["where"]) == ("kfbo", "position", "mae", "noise_std=0.5")
    assert first.difference > 0
    assert bool(first.changed)
    done = call("compare", whole, here, "--json")
    assert done.returncode == 1, done.stderr
    said = json.loads(done.stdout)
    assert (said["changed"], said["rows"], len(said["moved"])) == (1, len(found.rows), 1)
    assert "kfbo" in call("compare", whole, here).stdout


def frame(**columns):
    """Matched rows as `judged` takes them."""
    one = {"scenario": "s", "where_a": "", "observer": "o", "signal": "x", "metric": "mae", "unit_a": "m"}
    one |= {"draws_a": "0", "draws_b": "0", "narrowed_a": False, "n_a": 9, "n_b": 9, "bits_a": b"", "bits_b": b""}
    one |= {"certified_a": None, "certified_b": None, "method_a": "runs", "method_b": "runs"}
    return pd.DataFrame([one | {k: v[i] for k, v in columns.items()} for i in range(len(columns["mean_a"]))])


def test_numbers_without_spread_change_by_more_than_rounding_and_in_existing():
    nan = float("nan")
    rows = compare.compare_rows(
        frame(
            mean_a=[1.0, 1.0, 1e-15, 1.0, nan],
            mean_b=[1.0 + 1e-12, 1.001, 4e-15, nan, nan],
            se_a=[0.0, 0.0, 0.0, 0.1, nan],
            se_b=[0.0, 0.0, 0.0, nan, nan],
            signal=["rounding", "more", "zero", "gone", "never"],
        )
    )
    assert dict(zip(rows.signal, rows.changed, strict=True)) == {
        "rounding": False,
        "more": True,
        "zero": False,
        "gone": True,
        "never": False,
    }


def test_one_run_each_on_other_draws_decides_nothing():
    rows = compare.compare_rows(
        frame(
            mean_a=[1.0],
            mean_b=[2.0],
            se_a=[float("nan")],
            se_b=[float("nan")],
            n_a=[1],
            n_b=[1],
            draws_b=["0: [[5, 6]]"],
        )
    )
    assert not rows.changed.any()


def test_where_only_some_draws_are_common_those_are_compared(whole, copy, elsewhere, tmp_path):
    """Welch's t supposes that no draws are common: over those that are, the same runs come out."""
    merge.merge([whole, elsewhere], tmp_path / "both")
    found = compare.compare(whole, tmp_path / "both")
    assert len(found.rows) == len(pd.read_parquet(whole / "stats.parquet"))
    assert found.rows.same_draws.all()
    assert found.rows.narrowed.all()
    assert (found.changed, found.identical, set(found.rows.n_b)) == (0, True, {40})
    said = call("compare", whole, tmp_path / "both").stdout
    assert "bit for bit equal" in said
    assert f"{len(found.rows)} of them over the common seeds" in " ".join(said.split())
    one = compare.compare(elsewhere, tmp_path / "both").rows
    assert one.identical.all(), "the later seeds too"


def test_a_damaged_block_is_no_equal_result(whole, copy):
    block = sorted((copy / "runs").rglob("*.parquet"))[0]
    block.write_bytes(block.read_bytes()[:-50])
    done = call("compare", whole, copy)
    assert (done.returncode, done.stdout) == (2, "")
    assert f"{block.relative_to(copy)}: is damaged, expected a complete block" in done.stderr


def test_cells_are_matched_by_what_they_are_and_not_by_number(whole, tmp_path):
    turned = tmp_path / "turned"
    pcbench.run(STUDY | {"axes": {"noise_std": [0.5, 0.1]}}, out=turned)
    found = compare.compare(whole, turned)
    assert found.identical
    assert found.changed == 0
    assert len(found.rows) == len(pd.read_parquet(whole / "stats.parquet"))


def test_another_root_seed_is_other_draws_of_the_same_study(whole, tmp_path):
    pcbench.run(STUDY | {"root_seed": 1}, out=tmp_path / "r")
    rows = compare.compare(whole, tmp_path / "r").rows
    assert len(rows)
    assert not rows.same_draws.any()


@pytest.mark.ci
def test_other_studies_and_unfinished_ones_are_refused_in_a_sentence(whole, copy, tmp_path):
    with hurried.programs():
        pcbench.run(STUDY | {"observers": ["pccebo", "kf"]}, out=tmp_path / "o")
    with pytest.raises(UserError, match=r"is of another study than .*kfbo there, not here.*expected the same study"):
        compare.compare(whole, tmp_path / "o")
    text = (copy / "study.toml").read_text()
    (copy / "study.toml").write_text(text.replace("parameter_drift = 0.0", "parameter_drift = 5.0", 1))
    with pytest.raises(
        UserError, match=r"\(cart/\S+drift: 0.0 there, 5.0 here\), expected"
    ):  # once, and this way round
        compare.compare(whole, copy)
    (copy / "study.toml").write_text(text)
    kept = shutil.copytree(copy, tmp_path / "kept")
    next((copy / "runs").rglob("*.parquet")).unlink()
    with pytest.raises(UserError, match=r"stats.parquet: is not of the blocks in \S+runs, expected a finished study"):
        compare.compare(whole, copy)
    copy = kept
    (copy / "stats.parquet").unlink()
    done = call("compare", whole, copy)
    assert done.returncode == 2
    assert "stats.parquet: is not there or damaged" in done.stderr
    assert done.stderr.count("\n") == 1


def test_releases_and_devices_that_differ_are_said(whole, copy):
    versions = json.loads((copy / "provenance.json").read_text())["versions"]
    reseal(copy, versions=versions | {"jax": "0.0.1"}, wall_seconds=-1.0)
    (phrase,) = compare.compare(whole, copy).made_by
    assert phrase.startswith("versions.jax: ")
    assert phrase.endswith("there, 0.0.1 here")


def test_an_exact_number_is_compared_with_runs_by_their_error_alone():
    """Nine runs of error 0.1 are three of them away from an exact value: Student's p for 8 degrees of freedom, 0.017."""
    known = {"n_a": [0, 0], "se_a": [0.0, 0.0], "method_a": ["exact", "none"]}
    rows = compare.compare_rows(
        frame(mean_a=[1.0, float("nan")], mean_b=[1.3, 1.0], se_b=[0.1, 0.1], signal=["far", "runs only"], **known)
    ).set_index("signal")
    assert rows.p_value["far"] == pytest.approx(0.01707168, rel=1e-5)
    assert dict(rows.changed) == {"far": True, "runs only": False}


@pytest.mark.ci
def test_a_copy_of_a_tuned_study_with_an_observer_of_ones_own_is_the_same_study(tmp_path, monkeypatch):
    shutil.copy(Path(__file__).parents[1] / "support" / "own_observer.py", tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    study = {
        "name": "mine",
        "scenarios": ["cart/slow"],
        "observers": ["nudge"],
        "seeds": 4,
        "custom_observers": {"nudge": "mine.py:nudge"},
    }
    study |= {"tuning": ["published", "tuned"], "tune": {"budget": 2, "training": 4}}
    pcbench.run(study, out="o")
    shutil.copytree("o", "copy")
    assert compare.compare("o", "copy").identical
