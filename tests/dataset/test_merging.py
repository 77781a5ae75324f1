"""Several folders of one study made one."""

import pytest
from commands import call
from small_study import STUDY, same

import pcbench
from pcbench.dataset import block_files, merge, ownership, store
from pcbench.errors import UserError


def test_two_halves_merged_are_the_whole(whole, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=25, block=16)
    pcbench.run(STUDY, out=b, seeds=24, first_seed=16, block=10)
    made = merge.merge([b, a], tmp_path / "both")
    assert (made.missing, made.doubled) == (0, 2 * 2 * 9)
    same(tmp_path / "both", whole)
    named = ownership.opened(store.target(tmp_path / "both")).study
    assert (named.first_seed, named.seeds) == (0, 40)
    again = pcbench.run(STUDY, out=tmp_path / "both")
    assert again.provenance["merged"]
    assert "Nothing was left to do" in call("run", str(a / "study.toml"), "--out", str(a)).stdout
    same(tmp_path / "both", whole)


def test_cells_numbered_otherwise_are_merged_by_what_they_are(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=9)
    pcbench.run(STUDY | {"axes": {"noise_std": [0.5, 0.1]}}, out=b, seeds=5, first_seed=9)
    merge.merge([a, b], tmp_path / "both")
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=14)
    same(tmp_path / "both", tmp_path / "at-once")


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
    place = store.target(copy)
    b = block_files.present(place)[0]
    table = block_files.read(place, b)
    i = table.schema.get_field_index("mae")
    changed = table.set_column(i, table.schema.field(i), [table["mae"].to_numpy() * (1 + 1e-12)])
    store.put_table(place, b.name, block_files.sealed(changed, block_files.about(table)))
    with pytest.raises(UserError, match=r"differ by 1.0e-12 of themselves"):
        merge.merge([whole, copy], tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_other_studies_are_not_merged(whole, tmp_path):
    pcbench.run(STUDY | {"options": {"kfbo": {"R": 0.7}}}, out=tmp_path / "b", seeds=3)
    with pytest.raises(UserError, match=r"options of cart/slow.kfbo.R: 0.3 there, 0.7 here"):
        merge.merge([whole, tmp_path / "b"], tmp_path / "both")
