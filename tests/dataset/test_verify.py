"""Looking at a dataset: how far it is, whether it is whole, whether it comes out again."""

import numpy as np
import pyarrow as pa
import pytest
from commands import call
from small_study import STUDY

import pcbench
from pcbench.dataset import block_files, storage, verify


def test_status_says_how_far_a_study_is(copy):
    found = verify.status(copy)
    assert found.closed
    assert [(s.observer, s.cells, s.seeds, s.wanted) for s in found.shares] == [
        ("pccebo", 2, 80, 80),
        ("kfbo", 2, 80, 80),
    ]
    files = sorted((copy / "runs").rglob("*.parquet"))
    files[0].unlink()
    files[1].write_bytes(b"PAR1")
    found = verify.status(copy)
    assert not found.closed
    assert len(found.damaged) == 1
    assert sum(s.seeds for s in found.shares) == 160 - 16


@pytest.fixture
def mine(tmp_path):
    """The small study in blocks of 16 seeds."""
    pcbench.run(STUDY, out=tmp_path / "mine", block_size=16)
    return tmp_path / "mine"


def test_verify_finds_a_number_that_was_changed_and_nothing_else(mine):
    found = verify.verify(mine, None, 0)
    assert (found.files, len(found.recomputed), found.wrong, found.differing) == (12, 12, [], [])
    place = storage.target(mine)
    b = block_files.present(place)[5]
    table = block_files.read_block(place, b)
    i = table.schema.get_field_index("rmse")
    values = table["rmse"].to_numpy().copy()
    values[7] = np.nextafter(values[7], 1e9)
    changed = table.set_column(i, table.schema.field(i), [values])
    storage.write_table(place, b.name, block_files.seal_block(changed, block_files.about(table)))
    found = verify.verify(mine, None, 0)
    assert len(found.differing) == 1
    assert b.name in found.differing[0]
    assert "rounding" in found.differing[0]
    assert [w.split(":")[0] for w in found.wrong] == ["stats.parquet", "pairs.parquet"], "they do not follow any more"


@pytest.mark.nightly
def test_commands_on_a_dataset_answer(copy, tmp_path):
    assert "All runs and their statistics are complete" in call("status", str(copy)).stdout
    done = call("verify", str(copy), "--sample", "1")
    assert "all 12 blocks are intact; 1 of 1 recomputed blocks are equal" in " ".join(done.stdout.split()), done.stderr
    assert "none was recomputed" in " ".join(call("verify", str(copy), "--sample", "0").stdout.split())
    done = call("merge", str(copy), str(copy), "--out", str(tmp_path / "m"))
    assert "160 runs were in more than one dataset" in " ".join(done.stdout.split()), done.stderr
    for words in (
        ["status", str(tmp_path)],
        ["verify", str(tmp_path)],
        ["verify", str(copy), "--sample", "-3"],
        ["merge", str(copy), "--out", str(tmp_path / "n")],
    ):
        done = call(*words)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1, done.stderr


def errors(**columns):
    """Two runs of a signal whose largest error is 1000, and other numbers of them."""
    return pa.table({"signal": ["x", "x"], "max_abs_error": [1e3, 10.0]} | columns)


@pytest.mark.parametrize(
    ("metric", "part"), [("rmse", 1e-10), ("steady_rmse", 1e-10), ("mse", 1e-13), ("steady_mse", 1e-13)]
)
def test_what_is_left_of_zero_is_a_part_of_the_largest_error_and_of_a_square_of_its_square(metric, part):
    found = verify.difference(errors(**{metric: [1.0, 1e-7]}), errors(**{metric: [1.0, 2e-7]}))
    assert found == pytest.approx((0.5, part), rel=1e-12)


def test_a_number_that_is_missing_on_one_side_is_no_matter_of_size():
    assert verify.difference(errors(rmse=[1.0, 2.0]), errors(rmse=[1.0, None])) is None
    assert verify.difference(errors(rmse=[1.0, None]), errors(rmse=[1.0, None])) == (0, 0)
