"""Which engine computes a study: written into its dataset, and kept from then on."""

import shutil

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

import pcbench
from pcbench.dataset import block_files, compare, manifest, merge, storage, table_diff, verify
from pcbench.engine import jaxpr_compat
from pcbench.errors import UserError
from pcbench.study import parse

KEYS = ["cell", "observer", "seed", "signal"]
RANDOM = {
    "name": "engines",
    "observers": ["kf", "kf-ignore-delay", "ukf"],
    "axes": {"loss": [0.2], "delay_jitter": [0.05]},
    "options": {"scenario": {"random_initial_state": True}},
    "lti": {
        "A": [[0.0, 1.0], [-2.0, -0.6]],
        "B": [[0.0], [1.5]],
        "C": [[1.0, 0.0]],
        "sampling_period": 0.1,
        "delay": 0.05,
        "noise_std": 0.3,
        "process_std": [0.02, 0.05],
        "tick": 0.01,
        "duration": 2.0,
    },
}
STUDY = {"name": "engines", "scenarios": ["cart/white"], "observers": ["kf"], "seeds": 4}
pytestmark = pytest.mark.usefixtures("in_a_hurry")


@pytest.mark.ci
def test_a_dataset_keeps_its_engine_and_rows_differ_by_rounding(tmp_path):
    """More seeds do not change the engine; another one is refused by name; both give the same numbers."""
    for engine in ("steps", "definition"):
        pcbench.run(STUDY | {"engine": engine}, out=tmp_path / engine)
    assert pcbench.run(STUDY, out=tmp_path / "definition").cost.runs == 0
    grown = pcbench.run(STUDY | {"seeds": 6}, out=tmp_path / "definition")
    assert (grown.cost.runs, grown.study.engine) == (2, "definition")
    with pytest.raises(UserError, match="engine: 'definition' there, 'steps' here"):
        pcbench.run(STUDY | {"engine": "steps"}, out=tmp_path / "definition")
    assert pcbench.open_result(tmp_path / "steps").study.engine == "steps"
    a, b = (pd.read_parquet(tmp_path / e / "runs").sort_values(["seed", "signal"]) for e in ("definition", "steps"))
    a = a[a.seed < 4]
    for name in ("rmse", "max_abs_error", "settling_time"):
        np.testing.assert_allclose(a[name], b[name], rtol=1e-11)
    assert compare.compare(tmp_path / "steps", tmp_path / "definition").largest < 1e-11


@pytest.mark.ci
def test_a_dataset_without_its_text_keeps_the_engine_of_its_blocks(tmp_path):
    pcbench.run(STUDY | {"engine": "definition"}, out=tmp_path / "out")
    (tmp_path / "out" / "study.toml").unlink()
    claimed = manifest.claim(storage.target(str(tmp_path / "out")), parse.grid_of(STUDY, {}, []))
    assert claimed.study.engine == "definition"
    assert {cell.engine for cell in claimed.cells} == {"definition"}


def test_an_engine_that_is_none_is_refused():
    with pytest.raises(UserError, match="engine: got 'plain', expected 'definition' or 'steps'"):
        parse.grid_of(STUDY | {"engine": "plain"}, {}, [])


@pytest.mark.ci
def test_an_engine_that_is_none_in_a_dataset_is_refused(tmp_path):
    pcbench.run(STUDY, out=tmp_path / "out")
    path = tmp_path / "out" / "study.toml"
    path.write_text(path.read_text().replace('engine = "steps"', "engine = 5"))
    for read_again in (lambda: pcbench.run(STUDY, out=tmp_path / "out"), lambda: pcbench.open_result(tmp_path / "out")):
        with pytest.raises(UserError, match="engine: got 5, expected 'definition' or 'steps'"):
            read_again()


def rows(study, **changes):
    runs = pcbench.run(study | {"engine": "definition"} | changes).runs
    return runs.set_index(KEYS).sort_index()


@pytest.mark.ci
@pytest.mark.usefixtures("as_users_have_it")  # compiled in a hurry the last bit depends on the processor
@pytest.mark.parametrize("study", [STUDY | {"observers": ["kf", "ukf"]}, RANDOM], ids=["shared", "random"])
def test_by_the_definition_a_run_has_its_bits_whatever_the_number_of_seeds_and_other_observers(study):
    many = rows(study, seeds=70)
    for changes in ({"seeds": 1}, {"seeds": 3}, {"seeds": 3, "observers": ["ukf"]}):
        some = rows(study, **changes)
        pd.testing.assert_frame_equal(some, many.loc[some.index], check_exact=True)


@pytest.mark.ci
@pytest.mark.usefixtures("as_users_have_it")
def test_by_the_definition_calls_of_other_shapes_make_one_block(tmp_path):
    """Runs of one call have at most two arrivals at a tick, those of another one."""
    study = RANDOM | {"axes": {"loss": [0.9], "delay_jitter": [0.1]}, "observers": ["kf"], "seeds": 200}
    study |= {"lti": RANDOM["lti"] | {"tick": 0.05, "duration": 1.0}, "engine": "definition"}
    many = pcbench.run(study, out=tmp_path / "o", block_size=200).runs.set_index(KEYS).sort_index()
    some = rows(study, seeds=3)
    pd.testing.assert_frame_equal(some, many.loc[some.index], check_exact=True)


@pytest.mark.nightly
@pytest.mark.usefixtures("as_users_have_it")
def test_by_the_definition_heavy_observers_leave_others_their_bits(tmp_path):
    study = RANDOM | {"observers": ["ukf", "particle"], "options": RANDOM["options"] | {"particle": {"particles": 20}}}
    both, one = rows(study, seeds=3), rows(study, seeds=3, observers=["ukf"])
    pd.testing.assert_frame_equal(one, both.loc[one.index], check_exact=True)
    pcbench.run(study | {"seeds": 3, "engine": "definition"}, out=tmp_path / "o")
    found = verify.verify(tmp_path / "o", None, 0)
    assert found.differing == []
    stepped = pcbench.run(study | {"seeds": 3, "engine": "steps"}).runs.set_index(KEYS).sort_index()
    np.testing.assert_allclose(stepped.rmse, both.rmse, rtol=1e-11)


@pytest.mark.ci
@pytest.mark.parametrize("engine", ["definition", "steps"])
def test_a_trace_has_heavy_observers_and_others_whatever_the_engine(engine):
    found = pcbench.simulate(RANDOM | {"engine": engine}, ["kf", "particle"])
    assert {"kf.x1", "particle.x1"} <= set(found.columns)


def stored_runs(out):
    return pcbench.open_result(out).runs.set_index(KEYS).sort_index()


@pytest.mark.ci
def test_of_two_engines_a_merge_keeps_the_rows_of_the_first_and_says_both(tmp_path):
    """Wherever its blocks begin and end."""
    first, second = tmp_path / "first", tmp_path / "second"
    pcbench.run(STUDY | {"engine": "definition", "seeds": 3}, out=first, first_seed=2, block_size=2)
    pcbench.run(STUDY | {"engine": "steps", "seeds": 6}, out=second)
    report = merge.merge([first, second], tmp_path / "both")
    assert (report.duplicates, report.missing) == (3, 0)
    both = pcbench.open_result(tmp_path / "both")
    assert both.provenance["engines"] == ["definition", "steps"]
    mine, a, b = stored_runs(tmp_path / "both"), stored_runs(first), stored_runs(second)
    pd.testing.assert_frame_equal(mine.loc[a.index], a, check_exact=True)
    rest = b.index.difference(a.index)
    pd.testing.assert_frame_equal(mine.loc[rest], b.loc[rest], check_exact=True)
    assert verify.verify(tmp_path / "both", None, 0).differing == []


@pytest.mark.ci
def test_numbers_of_any_size_and_unit_are_compared_by_their_own(tmp_path):
    """A nees of errors of 1e-5."""
    small = RANDOM["lti"] | {
        "noise_std": 3e-6,
        "process_std": [2e-7, 5e-7],
        "prior_std": [1e-5, 1e-5],
        "x0": [1e-5, 1e-5],
    }
    small = RANDOM | {"lti": small | {"input": "zero"}, "observers": ["kf"], "axes": {}, "seeds": 3}
    small |= {"options": {"scenario": {"random_initial_state": True, "consistency": True}}}
    outs = [tmp_path / engine for engine in ("definition", "steps")]
    for out in outs:
        pcbench.run(small | {"engine": out.name}, out=out)
    assert merge.merge(outs, tmp_path / "both").missing == 0


@pytest.mark.ci
def test_rows_of_two_engines_that_differ_by_more_are_not_merged(tmp_path, monkeypatch):
    for engine in ("definition", "steps"):
        pcbench.run(STUDY | {"engine": engine}, out=tmp_path / engine)
    monkeypatch.setattr(merge, "BETWEEN_ENGINES", 0.0)
    with pytest.raises(UserError, match=r"seeds 0 \.\. 3 differ by"):
        merge.merge([tmp_path / "definition", tmp_path / "steps"], tmp_path / "both")


@pytest.mark.ci
def test_with_a_jax_that_the_engines_do_not_know_the_definition_computes_and_says_so_once(tmp_path, monkeypatch):
    pcbench.run(STUDY, out=tmp_path / "begun")
    monkeypatch.setattr(jaxpr_compat, "NEWEST", (0, 1))
    said = []
    for changes in ({}, {"engine": "steps"}):
        overwrite = pcbench.run(STUDY | changes, out=tmp_path / f"fresh{len(said)}", on_warning=said.append)
        assert overwrite.study.engine == "definition"
    assert ["the engine `definition` computes" in sentence for sentence in said] == [True, True]
    grown = pcbench.run(STUDY | {"seeds": 6}, out=tmp_path / "begun", on_warning=said.append)
    assert (grown.study.engine, len(said)) == ("steps", 3)
    place = storage.target(tmp_path / "begun")
    engines = [block_files.about_block(place, b)["engine"] for b in sorted(block_files.present(place))]
    assert engines == ["steps", "definition"]


@pytest.mark.ci
def test_two_datasets_of_one_engine_are_compared_to_the_bit_after_one_of_another(tmp_path):
    for name, engine in (("a", "definition"), ("b", "steps")):
        pcbench.run(STUDY | {"engine": engine}, out=tmp_path / name)
    shutil.copytree(tmp_path / "b", tmp_path / "c")
    place = storage.target(tmp_path / "c")
    (block,) = block_files.present(place)
    table = block_files.read_block(place, block)
    i = table.schema.get_field_index("mae")
    moved = table.set_column(i, table.schema.field(i), pa.array(table["mae"].to_numpy() * (1 + 1e-13)))
    storage.write_table(place, block.name, block_files.seal_block(moved, block_files.about(table)))
    for order in ("abc", "cba"):
        with pytest.raises(UserError, match="expected equal rows"):
            merge.merge([tmp_path / name for name in order], tmp_path / order)
    assert merge.merge([tmp_path / "a", tmp_path / "c"], tmp_path / "ac").missing == 0


@pytest.mark.parametrize(
    ("column", "before", "after", "same"),
    [
        ("final_error", [1e-17, 2e-16], [3e-16, -2e-16], True),  # zero beside a peak of 1e3
        ("rmse", [1.0, 2.0], [1.0, 2.0 + 1e-8], True),
        ("settling_time", [1.0, 2.0], [1.0, 2.0 + 1e-8], False),
        ("settling_time", [1.0, np.nan], [1.0, np.nan], True),
        ("settling_time", [1.0, np.nan], [1.0, 2.0], False),
        ("nees", [1.0, 1e9], [1.0 + 1e-3, 1e9], True),
        ("nees", [np.inf, 1.0], [np.inf, 1.0], True),
        ("nees", [np.inf, 1.0], [1.0, 1.0], False),
    ],
)
def test_a_number_is_held_against_the_largest_of_its_column_an_error_against_its_peak(column, before, after, same):
    tables = [pa.table({"signal": ["x", "x"], "max_abs_error": [1e3, 1e3], column: each}) for each in (before, after)]
    assert table_diff.of_one_run(*tables, within=1e-11) == same
