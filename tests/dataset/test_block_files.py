"""Blocks on disk: every seed once, whoever cut them; names say what they hold; damage is seen."""

import itertools
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import pcbench
from pcbench.dataset import block_files, parquet_io, storage
from pcbench.dataset.block_files import Block
from pcbench.dataset.seed_ranges import Seeds, gaps, seed_range
from pcbench.errors import UserError


def block(first, last, observer="o"):
    return Block("s/t", observer, 3, Seeds(first, last))


@pytest.mark.ci
@given(st.text(min_size=1), st.text(min_size=1), st.integers(0, 10**6), st.integers(0, 10**9), st.integers(1, 10**6))
def test_a_name_says_its_block(scenario, observer, cell, first, many):
    made = Block(scenario, observer, cell, seed_range(first, many))
    assert block_files.block_of(made.name) == made
    assert made.name.count("/") == 3


RANGES = st.lists(st.tuples(st.integers(0, 200), st.integers(1, 60)), max_size=8)


@settings(max_examples=300)
@given(RANGES, st.integers(0, 100), st.integers(1, 200), st.integers(1, 70))
def test_gaps_and_blocks_hold_every_seed_once(ranges, first, many, size):
    """Whatever stands, what is settled and the gaps between hold each wanted seed exactly once, in pieces of the grid."""
    kept = block_files.drop_overlaps(block(a, a + n) for a, n in ranges)
    assert set(kept) <= {block(a, a + n) for a, n in ranges}
    missing = gaps([k.seeds for k in kept], seed_range(first, many), size)
    count = np.zeros(600, int)
    for a, b in [*(k.seeds for k in kept), *missing]:
        count[a:b] += 1
    assert count.max(initial=0) <= 1
    assert (count[first : first + many] == 1).all()
    for a, b in missing:
        assert first <= a < b <= first + many
        assert a // size == (b - 1) // size, "no piece crosses the grid"
    ends = sorted(kept, key=lambda b: b.seeds.first)
    assert all(x.seeds.stop <= y.seeds.first for x, y in itertools.pairwise(ends))


@given(RANGES)
def test_what_is_settled_depends_on_no_order(ranges):
    blocks = [block(a, a + n) for a, n in ranges]
    assert block_files.drop_overlaps(blocks) == block_files.drop_overlaps(blocks[::-1])


def test_blocks_that_follow_one_another_double_nothing():
    row = [block(0, 8), block(8, 12), block(12, 20), block(30, 31)]
    assert block_files.drop_overlaps(row) == row
    assert block_files.drop_overlaps([*row, block(19, 20)]) == row


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    out = tmp_path_factory.mktemp("ledger") / "out"
    pcbench.run("cart/slow", observers=["kfbo"], seeds=6, block_size=4, out=out)
    return out


def damage(dataset, tmp_path, change):
    """What is found wrong with a block that was changed."""
    place, b = storage.target(dataset), block_files.present(storage.target(dataset))[0]
    cell = block_files.about(block_files.read_block(place, b))["cell"]
    assert block_files.damage(place, b, cell) is None
    path = tmp_path / b.name
    path.parent.mkdir(parents=True)
    path.write_bytes(change((dataset / b.name).read_bytes()))
    found = block_files.damage(storage.target(tmp_path), b, cell)
    if found is not None:
        assert "\n" not in found
    return found


@pytest.mark.ci
@pytest.mark.parametrize("keep", [0, 4, 100, -1, -8])
def test_a_file_cut_short_is_damaged(dataset, tmp_path, keep):
    assert damage(dataset, tmp_path, lambda content: content[:keep])


@pytest.mark.ci
@settings(max_examples=60)
@given(st.floats(0, 1, exclude_max=True), st.integers(0, 7))
def test_a_flipped_bit_is_seen_or_changes_nothing(dataset, tmp_path_factory, where, bit):
    """A flip is found, or the rows are what they were (flipped was what no reader looks at)."""
    tmp_path = tmp_path_factory.mktemp("flip")

    def flip(content):
        changed = bytearray(content)
        changed[int(where * len(changed))] ^= 1 << bit
        return bytes(changed)

    if damage(dataset, tmp_path, flip) is None:
        b = block_files.present(storage.target(tmp_path))[0]
        found, want = (
            block_files.read_block(storage.target(tmp_path), b),
            pq.read_table(dataset / b.name, partitioning=None),
        )
        assert found.equals(want)
        assert block_files.about(found) == block_files.about(want)


def test_no_flipped_bit_ends_the_process(dataset):
    """Every 29th: pyarrow aborted the process in about 300 of all, where a column's description was damaged."""
    (name,) = {b.name for b in block_files.present(storage.target(dataset)) if b.seeds.first == 0}
    content, found = (dataset / name).read_bytes(), []
    for at in range(0, 8 * len(content), 29):
        changed = bytearray(content)
        changed[at // 8] ^= 1 << at % 8
        try:
            parquet_io.parse_table(pa.py_buffer(bytes(changed)))
        except (pa.ArrowException, OSError, ValueError) as error:
            found.append(error)
    assert len(found) > 1000


def rewritten(change):
    """A change of a block's table or of what it says of itself, sealed again."""

    def rewrite(content):
        table = pq.read_table(pa.BufferReader(content))
        said = block_files.about(table)
        return parquet_io.encode_table(block_files.seal_block(change(table, said), said)).to_pybytes()

    return rewrite


def unsealed(content):
    """A number that was changed, and nothing said."""
    table = pq.read_table(pa.BufferReader(content))
    i, values = table.schema.get_field_index("mae"), table["mae"].to_numpy().copy()
    values[3] = np.nextafter(values[3], 1.0)
    return parquet_io.encode_table(table.set_column(i, table.schema.field(i), [values])).to_pybytes()


CHANGES = {
    "other seeds": lambda t, said: (said.update(first=1), t)[1],
    "other observer": lambda t, said: (said.update(observer="pccebo"), t)[1],
    "other cell": lambda t, said: (said.update(cell="0"), t)[1],
    "a row less": lambda t, said: t.slice(1),
    "another schema": lambda t, said: t.replace_schema_metadata(t.schema.metadata | {b"pcbench.schema": b"2"}),
}


def test_a_number_that_was_changed_is_damage(dataset, tmp_path):
    assert damage(dataset, tmp_path, unsealed) == "its rows are not those that were written"


@pytest.mark.parametrize("change", CHANGES)
def test_a_block_that_is_another_than_its_name_says_is_damaged(dataset, tmp_path, change):
    assert damage(dataset, tmp_path, rewritten(CHANGES[change]))


def test_a_table_that_is_no_block_is_named(dataset, tmp_path):
    stray = tmp_path / "runs" / "scenario=x" / "mine.parquet"
    stray.parent.mkdir(parents=True)
    stray.write_bytes(Path(next((dataset / "runs").rglob("*.parquet"))).read_bytes())
    with pytest.raises(UserError, match=r"mine.parquet: is no block"):
        block_files.present(storage.target(tmp_path))


def test_a_column_of_lists_is_as_it_was_written(tmp_path):
    """Parquet names what is in a list as it likes: `item` is written, `element` may come back."""
    kind = pa.list_(pa.field("item", pa.float64()))
    table = pa.table({"seed": [0, 1], "noise_std": pa.array([[1e-3, 2e-3]] * 2, kind)})
    written = block_files.seal_block(table, {"cell": "a", "observer": "o", "first": 0, "last": 2})
    read = written.cast(written.schema.set(1, pa.field("noise_std", pa.list_(pa.field("element", pa.float64())))))
    said = block_files.about(written)
    assert str(read.schema.field(1).type) != str(written.schema.field(1).type)
    assert block_files.digest(read, said) == said["digest"]
    changed = table.set_column(1, "noise_std", pa.array([[1, 2]] * 2, pa.list_(pa.int64())))
    assert block_files.digest(changed, said) != said["digest"]


@pytest.mark.nightly
def test_a_study_with_noise_by_channel_has_nothing_left_to_do(tmp_path):
    study = {
        "name": "s",
        "scenarios": ["csth/10s"],
        "observers": ["model-only"],
        "axes": {"noise_std": [[0.1, 0.2, 0.1]]},
    }
    assert pcbench.run(study, seeds=2, out=tmp_path).cost.runs == 2
    assert pcbench.run(study, seeds=2, out=tmp_path).cost.runs == 0


def test_a_block_with_a_list_for_each_channel_is_whole_once_read():
    """Parquet has another name for what is in a list; a study over the delays of channels goes on where it stands."""
    column = pa.array([[20.0, 50.0], [20.0, 50.0]], pa.list_(pa.float64()))
    made = block_files.seal_block(pa.table({"delay": column, "mae": [0.1, 0.2]}), {})
    read = pq.read_table(pa.BufferReader(parquet_io.encode_table(made)))
    said = block_files.about(read)
    assert block_files.digest(read, said) == said["digest"]
