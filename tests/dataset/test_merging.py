"""Several folders of one study made one."""

import shutil

import pandas as pd
import pyarrow.compute as pc
import pytest
from commands import call
from small_study import STUDY, same, tables

import pcbench
from pcbench.dataset import block_files, manifest, merge, moments_tables, parquet_io, storage, verify
from pcbench.dataset.result import open_result
from pcbench.errors import UserError

LTI = {
    "A": [[0.0, 1.0], [-2.0, -0.4]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "x0": [1.0, 0.0], "prior_std": [0.3, 0.2],
    "tick": 0.1, "duration": 2.0, "steady_start": 1.0, "noise_std": 0.1, "sampling_period": 0.2, "delay": 0.1, "input": "sine",
}  # fmt: skip
SURE = {"name": "sure", "lti": LTI, "observers": ["kf", "model-only"], "axes": {"noise_std": [0.1, 0.5]}}


@pytest.mark.ci
def test_two_halves_merged_are_the_whole(whole, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=25, block_size=16)
    pcbench.run(STUDY, out=b, seeds=24, first_seed=16, block_size=10)
    made = merge.merge([b, a], tmp_path / "both")
    assert (made.missing, made.duplicates) == (0, 2 * 2 * 9)
    same(tmp_path / "both", whole)
    named = manifest.load_manifest(storage.target(tmp_path / "both")).study
    assert (named.first_seed, named.seeds) == (0, 40)
    again = pcbench.run(STUDY, out=tmp_path / "both")
    assert again.provenance["merged"]
    assert "All runs were complete already" in call("run", str(a / "study.toml"), "--out", str(a)).stdout
    same(tmp_path / "both", whole)


@pytest.mark.ci
def test_cells_numbered_otherwise_are_merged_by_what_they_are(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=9)
    pcbench.run(STUDY | {"axes": {"noise_std": [0.5, 0.1]}}, out=b, seeds=5, first_seed=9)
    merge.merge([a, b], tmp_path / "both")
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=14)
    same(tmp_path / "both", tmp_path / "at-once")


@pytest.mark.ci
def test_a_gap_between_merged_parts_is_said_and_can_be_filled(whole, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=10)
    pcbench.run(STUDY, out=b, seeds=20, first_seed=20)
    made = merge.merge([a, b], tmp_path / "both")
    assert made.missing == 2 * 2 * 10
    assert not (tmp_path / "both" / "stats.parquet").exists()
    pcbench.run(STUDY, out=tmp_path / "both")
    same(tmp_path / "both", whole)


def test_parts_that_disagree_are_not_merged(copy, whole, tmp_path):
    place = storage.target(copy)
    b = block_files.present(place)[0]
    table = block_files.read_block(place, b)
    i = table.schema.get_field_index("mae")
    changed = table.set_column(i, table.schema.field(i), [table["mae"].to_numpy() * (1 + 1e-12)])
    storage.write_table(place, b.name, block_files.seal_block(changed, block_files.about(table)))
    with pytest.raises(UserError, match=r"differ by 1.0e-12 of themselves"):
        merge.merge([whole, copy], tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_other_studies_are_not_merged(whole, tmp_path):
    pcbench.run(STUDY | {"options": {"kfbo": {"R": 0.7}}}, out=tmp_path / "b", seeds=3)
    with pytest.raises(UserError, match=r"options of cart/slow.kfbo.R: 0.3 there, 0.7 here"):
        merge.merge([whole, tmp_path / "b"], tmp_path / "both")


@pytest.fixture(scope="module")
def exact_parts(in_a_hurry, tmp_path_factory):
    a, b = (tmp_path_factory.mktemp("exact") / name for name in "ab")
    pcbench.run(SURE, out=a, seeds=4, evaluation="exact")
    pcbench.run(SURE | {"axes": {"noise_std": [0.5, 0.1]}}, out=b, seeds=4, first_seed=4, evaluation="exact")
    return a, b


@pytest.mark.ci
def test_a_part_without_exact_numbers_takes_the_others_cell_by_cell(exact_parts, tmp_path):
    a, b = (shutil.copytree(part, tmp_path / part.name) for part in exact_parts)
    (a / "exact.parquet").unlink()
    shutil.rmtree(a / "moments")
    merge.merge([a, b], tmp_path / "both")
    one, both = open_result(exact_parts[0]), open_result(tmp_path / "both")
    pd.testing.assert_frame_equal(one.stats, both.stats, rtol=1e-12)
    pd.testing.assert_frame_equal(one.moments, both.moments, rtol=1e-12)


@pytest.mark.ci
def test_what_is_merged_is_whole_and_not_made_again(exact_parts, tmp_path):
    assert merge.merge(exact_parts, tmp_path / "both").missing == 0
    before = tables(tmp_path / "both")
    assert before["exact.parquet"]
    assert len([name for name in before if name.startswith("moments/")]) == 2
    assert not verify.verify(tmp_path / "both", None, 0).wrong
    owned = manifest.load_manifest(storage.target(tmp_path / "both"))
    assert not moments_tables.make(storage.target(tmp_path / "both"), owned, pytest.fail)


@pytest.mark.ci
@pytest.mark.parametrize(("factor", "refused"), [(1 + 1e-12, False), (1 + 1e-6, True)])
def test_more_than_rounding_is_refused(exact_parts, tmp_path, factor, refused):
    b = storage.target(shutil.copytree(exact_parts[1], tmp_path / "b"))
    table = moments_tables.load_exact_rows(b)
    i = table.schema.get_field_index("mean")
    column = pc.multiply(table["mean"], factor)
    storage.write_table(b, "exact.parquet", parquet_io.seal_table(table.set_column(i, table.schema.field(i), column)))
    if refused:
        with pytest.raises(UserError, match=r"exact.parquet: differs from .*by more than rounding"):
            merge.merge([exact_parts[0], b.root], tmp_path / "both")
        assert not (tmp_path / "both").exists()
    else:
        merge.merge([exact_parts[0], b.root], tmp_path / "both")


@pytest.mark.ci
def test_a_reason_may_name_its_cell_by_another_number(exact_parts, tmp_path):
    b = storage.target(shutil.copytree(exact_parts[1], tmp_path / "b"))
    table = moments_tables.load_exact_rows(b)
    other = parquet_io.with_column(table, "reason", ["cart/slow, cell 7: is not affine"] * len(table))
    storage.write_table(b, "exact.parquet", parquet_io.seal_table(other))
    assert merge.merge([exact_parts[0], b.root], tmp_path / "both").missing == 0


@pytest.mark.ci
def test_a_damaged_part_and_another_method_are_refused(exact_parts, tmp_path):
    pcbench.run(SURE, out=tmp_path / "c", seeds=4, evaluation="both")
    with pytest.raises(UserError, match="evaluation: exact there, both here"):
        merge.merge([exact_parts[0], tmp_path / "c"], tmp_path / "both")
    b = shutil.copytree(exact_parts[1], tmp_path / "b")
    (b / "exact.parquet").write_bytes((b / "exact.parquet").read_bytes()[:-9] + b"123456789")
    with pytest.raises(UserError, match=r"exact.parquet: is damaged"):
        merge.merge([exact_parts[0], b], tmp_path / "both")
