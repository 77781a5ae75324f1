"""A study without a seed: the same tables, files that are checked, and runs only of what has no exact answer."""

import io
import re
import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from commands import call

import pcbench
from pcbench.cli.render import folder, results
from pcbench.cli.render.tables import Screen
from pcbench.dataset import columns, compare, moments_tables, parquet_io, storage, verify
from pcbench.dataset.result import open_result
from pcbench.errors import UserError
from pcbench.plots import layout, time_series
from pcbench.report import captions, page

pytestmark = pytest.mark.usefixtures("in_a_hurry")

LTI = {
    "A": [[0.0, 1.0], [-2.0, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "x0": [1.0, 0.0], "prior_std": [0.3, 0.2],
    "tick": 0.01, "duration": 3.0, "steady_start": 1.0, "noise_std": 0.1, "sampling_period": 0.2, "delay": 0.1, "input": "sine",
}  # fmt: skip
STUDY = {"name": "sure", "lti": LTI, "observers": ["kf", "model-only"], "seeds": 8, "axes": {"delay": [0.1, 0.3]}}
SIGNED = """
import jax.numpy as jnp
from pcbench import Certificate, Design, Observer

def start(gains, xhat0): return xhat0
def note(gains, memory, now): return jnp.zeros(0)
def jump(gains, memory, now, arrival):
    return memory + 0.1 * jnp.sign(jnp.where(arrival.mask[0], arrival.value[0] - memory[0], 0.0))
def flow(gains, memory, now): return memory
def estimate(gains, memory): return memory
def design(context, options): return Design((), Certificate("none: a sign", 1.0, "none", "as it is", {}))
OBSERVER = Observer(start, note, jump, flow, estimate)
"""


@pytest.fixture(scope="module")
def out(in_a_hurry, tmp_path_factory):
    folder = tmp_path_factory.mktemp("exact") / "out"
    pcbench.run(STUDY, evaluation="exact", out=folder)
    return folder


@pytest.mark.ci
def test_the_tables_are_those_of_runs_with_a_method_and_a_reason(out):
    found = open_result(out)
    mse = found.stats[(found.stats.metric == "mse") & (found.stats.signal == "x1")]
    assert (mse.method == "exact").all()
    assert (mse.se == 0).all()
    assert len(mse) == 4
    peak = found.stats[found.stats.metric == "max_abs_error"]
    assert peak["mean"].isna().all()
    assert peak.reason.notna().all()
    with pytest.raises(UserError, match="has no runs"):
        _ = found.runs


@pytest.mark.ci
def test_differences_of_exact_numbers_are_sure(out):
    pairs = open_result(out).pairs
    row = pairs[(pairs.metric == "mse") & (pairs.signal == "x1") & (pairs.cell == 0)].iloc[0]
    wide = open_result(out).stats.set_index(["cell", "observer", "signal", "metric"])["mean"]
    assert row.mean_diff == wide[0, "kf", "x1", "mse"] - wide[0, "model-only", "x1", "mse"]
    assert (row.n, row.se, row.method) == (0, 0.0, "exact")


@pytest.mark.ci
def test_moments_over_time_stand_beside(out):
    moments = open_result(out).moments
    mine = moments[(moments.cell == 1) & (moments.observer == "kf") & (moments.signal == "x2")]
    wide = open_result(out).stats.set_index(["cell", "observer", "signal", "metric"])["mean"]
    square = mine["mean"] ** 2 + mine["std"] ** 2
    np.testing.assert_allclose(mine.t, 0.01 * np.arange(301), rtol=1e-12)
    assert square[:-1].mean() == pytest.approx(wide[1, "kf", "x2", "mse"], rel=1e-12)


def test_of_one_cell_its_own_file_is_read_alone(out, tmp_path):
    copy = shutil.copytree(out, tmp_path / "copy")
    whole = open_result(out).moments
    (other,) = copy.glob("moments/*/cell=0.parquet")
    other.write_bytes(b"PAR1")
    found = open_result(copy).moments_of("lti", 1)
    pd.testing.assert_frame_equal(found, whole[whole.cell == 1].reset_index(drop=True))
    assert open_result(copy).moments_of("lti", 7).empty
    with pytest.raises(UserError, match="is damaged"):
        _ = open_result(copy).moments


@pytest.mark.ci
def test_a_study_of_many_grid_points_has_no_file_for_each_and_the_same_tables(out, tmp_path, monkeypatch):
    monkeypatch.setattr(moments_tables, "MAX_CELLS", 1)
    many = pcbench.run(STUDY, evaluation="exact", out=tmp_path / "many")
    assert not (tmp_path / "many" / "moments").exists()
    assert many.moments.empty
    assert many.moments_of(*many.stats[["scenario", "cell"]].iloc[0]).empty
    pd.testing.assert_frame_equal(many.stats, open_result(out).stats, check_exact=True)
    assert verify.verify(tmp_path / "many", 1, 0).wrong == []


@pytest.mark.ci
def test_verify_status_and_compare_take_them(out, tmp_path):
    again = verify.verify(out, 1, 0)
    assert (again.wrong, len(again.exact), again.unlike) == ([], 1, [])
    assert verify.status(out).closed
    pcbench.run(STUDY, out=tmp_path / "runs")
    found = compare.compare(out, tmp_path / "runs")
    assert not found.changed
    assert not found.made_by, "the way of runs is nothing that exact numbers lack"
    (out / "exact.parquet").rename(tmp_path / "kept")
    (out / "exact.parquet").write_bytes((tmp_path / "kept").read_bytes()[:-9] + b"123456789")
    assert any("exact.parquet" in sentence for sentence in verify.verify(out, 0, 0).wrong)
    (tmp_path / "kept").rename(out / "exact.parquet")


@pytest.mark.ci
def test_exact_numbers_that_do_not_come_out_again_are_said(out, tmp_path):
    """One mean is 1e-6 of itself off, in a file that is whole."""
    copy = shutil.copytree(out, tmp_path / "copy")
    table = moments_tables.load_exact_rows(storage.target(copy))
    i, at = table.schema.get_field_index("mean"), table["metric"].to_pylist().index("mse")
    means = table["mean"].to_pylist()
    means[at] *= 1 + 1e-6
    column = pa.array(means, table.schema.field(i).type)
    storage.write_table(
        storage.target(copy),
        moments_tables.NAME,
        parquet_io.seal_table(table.set_column(i, table.schema.field(i), column)),
    )
    found, said = verify.verify(copy, None, 0), io.StringIO()
    folder.verdict(found, "copy", Screen(file=said, width=200))
    assert found.unlike == ["exact.parquet: lti, cell 0: the computed numbers differ."]
    assert (
        said.getvalue().splitlines()[-1]
        == "copy: exact numbers of 1 of 2 recomputed grid points are equal up to rounding."
    )


@pytest.mark.ci
def test_both_simulates_what_is_not_affine_alone(tmp_path):
    (tmp_path / "mine.py").write_text(SIGNED)
    said = []
    study = STUDY | {
        "observers": ["kf", "signed"],
        "custom_observers": {"signed": f"{tmp_path}/mine.py:OBSERVER"},
        "axes": {},
    }
    done = pcbench.run(study, evaluation="both", out=tmp_path / "out", on_warning=said.append)
    methods = done.stats[done.stats.metric == "mse"].groupby("observer").method.unique()
    assert methods["kf"].tolist() == ["exact"]
    assert methods["signed"].tolist() == ["runs"]
    assert list(done.runs.observer.unique()) == ["signed"]
    assert len(said) == 1
    assert "signed is not affine in the noise: x1 is off by" in said[0]
    assert "pcbench.run" in said[0]
    assert not verify.verify(tmp_path / "out", None, 0).differing


@pytest.mark.ci
@pytest.mark.parametrize("longest", [results.LONGEST, 1], ids=["cell by cell", "counted"])
def test_where_nothing_is_known_neither_page_nor_table_says_nan(longest, tmp_path, monkeypatch):
    """Shares of diverged runs stood there as nan %, and medians of observers that have no exact answer."""
    monkeypatch.setattr(results, "LONGEST", longest)
    (tmp_path / "mine.py").write_text(SIGNED)
    study = STUDY | {"observers": ["kf", "signed"], "custom_observers": {"signed": f"{tmp_path}/mine.py:OBSERVER"}}
    done, shown = pcbench.run(study | {"axes": {}}, evaluation="exact", out=tmp_path / "out"), io.StringIO()
    results.closing(done, Screen(file=shown, width=200), "rmse")
    html = re.sub(r"<(script|style|svg).*?</\1>", "", page.page(done), flags=re.DOTALL)
    for text in (shown.getvalue(), html):
        assert "signed" in text
        assert not re.search(r"\bnan\b", text)
    assert "Bands: 90 % of the errors over all noise, or 32 runs" in html, "of kf, and of signed"
    assert results.closing_sentence(done, "there") == "Exact numbers of one grid point are in there."


@pytest.mark.ci
def test_exact_numbers_in_a_folder_of_runs_are_kept_with_them_and_the_command_says_so(tmp_path):
    pcbench.run("cart/slow", observers=["pccebo"], seeds=2, out=tmp_path / "out")
    result = pcbench.run("cart/slow", observers=["pccebo"], seeds=2, evaluation="exact", out=tmp_path / "out")
    assert set(result.stats.method) == {"runs"}
    assert moments_tables.load_exact_rows(storage.target(tmp_path / "out")) is not None
    said = results.closing_sentence(result, "out")
    assert said.startswith("The tables in out contain its runs")
    assert "pcbench verify out --exact" in said


def test_a_sealed_table_with_lists_is_known_again():
    """Parquet calls what is in a list by another name than Arrow does: an exact study with such an axis read as damaged."""
    table = columns.table({"process_std": [[0.1, 0.0], [0.2, 0.0]], "delay": [0.1, 0.2]})
    back = parquet_io.unseal_table(parquet_io.encode_table(parquet_io.seal_table(table)))
    assert back is not None
    assert back["process_std"].to_pylist() == [[0.1, 0.0], [0.2, 0.0]]
    spoilt = table.set_column(0, "process_std", pa.array([[0.1, 0.0], [0.3, 0.0]]))
    assert (
        parquet_io.unseal_table(
            parquet_io.encode_table(spoilt.replace_schema_metadata(parquet_io.seal_table(table).schema.metadata))
        )
        is None
    )


@pytest.mark.ci
def test_of_a_plant_that_is_not_affine_it_is_said_who_and_by_how_much_in_every_row(tmp_path):
    """Nothing is computed of it: its rows had been left out, the sentence too, and the closing table ended in a traceback."""
    (tmp_path / "s.toml").write_text(BENT)
    said = call("run", str(tmp_path / "s.toml"), "--evaluation", "exact", "--out", str(tmp_path / "out"))
    sentence = "reactor/batch, cell 0: ekf is not affine in the noise: "
    assert said.returncode == 0, said.stderr
    for words in (sentence, "off by", "use runs for it", "No number in "):
        assert words in said.stdout + said.stderr
    stats = open_result(tmp_path / "out").stats
    assert {"mse", "mae", "final_error", "steady_pooled_rmse"} <= set(stats.metric)
    assert (stats.method == "none").all()
    assert stats.reason.str.startswith(sentence).all()


BENT = """
name = "bent"
scenarios = ["reactor/batch"]
observers = ["ekf"]
seeds = 8
[options.scenario]
random_initial_state = true
"""


@pytest.mark.parametrize(("exact", "of"), [("ab", "all noise"), ("a", "all noise, or 32 runs"), ("c", "32 runs")])
def test_a_picture_in_time_says_over_what_errors_are_taken(exact, of):
    assert time_series.over(frozenset("ab"), frozenset(exact)) == of
    rows = [(series, kind, 1.0) for series in "ab" for kind in ("estimate", "rms")]
    run = pd.DataFrame(rows, columns=["series", "kind", "value"])
    with layout.sheet(layout.PAPER, "") as (figure, (ax,)):
        ax.fill_between([0, 1], [0, 0], [1, 1])
    note = captions.time(run, "m", figure, frozenset(exact))[1]
    assert f"90 % of the errors over {of}" in note
    assert ("those of the next seeds" in note) == ("32" in of)
