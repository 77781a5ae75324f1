"""How the closing tables are read from the blocks: in chunks that end where seeds say, whoever cut the blocks."""

from itertools import pairwise

import numpy as np
import pytest
from small_study import rows

import pcbench
from pcbench import statistics
from pcbench.dataset import aggregate, block_files, close, manifest, parquet_io, storage
from pcbench.dataset.seed_ranges import Seeds


def parts(out, cell=0, within=None):
    """The chunks of one cell, each observer's mean absolute errors of position with it."""
    place = storage.target(out)
    blocks = block_files.series(block_files.present(place))
    return list(aggregate.chunks(aggregate.of_cell(place, manifest.load_manifest(place).cells[cell], blocks), within))


@pytest.mark.ci
@pytest.mark.parametrize("size", [12, 16, 40, 7, 1000])
@pytest.mark.parametrize("last", [None, 33])
def test_chunks_end_where_the_seed_is_a_multiple_of_their_size(whole, size, last, monkeypatch):
    """Seeds 0 .. 39 stand in blocks of 16: chunks do not care."""
    monkeypatch.setattr(statistics, "CHUNK", size)
    end, table = last or 40, rows(whole)
    edges = [*range(0, end, size), end]
    found = parts(whole, 1, last and Seeds(0, last))
    assert [len(chunk["kfbo"]["diverged"]) for chunk in found] == np.diff(edges).tolist()
    for (a, b), chunk in zip(pairwise(edges), found, strict=True):
        for observer in ("pccebo", "kfbo"):
            mine = table[(table.observer == observer) & (table.cell == 1) & table.seed.between(a, b - 1)]
            for i, signal in enumerate(("position", "velocity")):
                np.testing.assert_array_equal(chunk[observer]["mae"][i], mine[mine.signal == signal].mae)


def test_chunks_of_seeds_that_begin_elsewhere_end_at_the_same_seeds(tmp_path, monkeypatch):
    pcbench.run("cart/slow", observers=["kfbo"], seeds=20, first_seed=5, block_size=9, out=tmp_path / "out")
    monkeypatch.setattr(statistics, "CHUNK", 8)
    assert [len(chunk["kfbo"]["diverged"]) for chunk in parts(tmp_path / "out")] == [3, 8, 8, 1]


@pytest.mark.ci
def test_rows_are_the_same_however_many_cells_are_taken_together(tmp_path, monkeypatch):
    """With a cell whose runs diverge, which is taken by itself, and one that has fewer seeds."""
    study = {
        "name": "some",
        "scenario": {"base": "cart/slow", "divergence_threshold": 50.0},
        "observers": ["kfbo", "model-only"],
        "axes": {"noise_std": [0.1, 0.2, 80.0, 0.3, 0.4]},
    }
    place = storage.target(tmp_path / "out")
    pcbench.run(study, seeds=20, out=tmp_path / "out")
    known = block_files.present(place)
    there, owned = [b for b in known if (b.cell, b.seeds.first) != (4, 0)], manifest.load_manifest(place)
    tables = []
    for many in (1, 2, 32):
        monkeypatch.setattr(close, "BATCH", many)
        tables.append([parquet_io.parse_table(content) for content in close.closing_tables(place, owned, there)[1:3]])
    stats = tables[0][0].to_pandas()
    assert set(stats[stats.diverged > 0].cell) == {2}
    assert stats.diverged.max() < 20
    assert set(stats.cell) == {0, 1, 2, 3}
    for stats, pairs in tables[1:]:
        assert stats.equals(tables[0][0])
        assert pairs.equals(tables[0][1])
