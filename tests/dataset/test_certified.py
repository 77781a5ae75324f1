"""Gains that nothing proves are so called in every table, and tables of an earlier release, which do not say it, are read."""

import shutil
from pathlib import Path

import pandas as pd
import pyarrow.parquet as pq
import pytest
from rich.console import Console
from small_study import sealed_again, tables

import pcbench
from pcbench.cli.screen import comparison, folder, results
from pcbench.dataset import merge, parquet, store, summary, verify
from pcbench.dataset.compare import compare
from pcbench.report import headline
from pcbench.synthesis.certificate import NO_GAIN, Certificate, is_certified, uncertified

SOURCE = (Path(__file__).parents[1] / "support" / "own_observer.py").read_text()
PROOF = 'Certificate("none: for tests", 1.0, "none", "none")'
PROVEN = {"nudge": False, "kfbo": True, "open-loop": None}
STUDY = {"name": "proofs", "scenarios": ["cart/slow"], "observers": ["mine.py:nudge", "kfbo", "open-loop"], "seeds": 4}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A study with an observer whose gains nothing proves."""
    here = tmp_path_factory.mktemp("proofs")
    assert PROOF in SOURCE
    (here / "mine.py").write_text(SOURCE.replace(PROOF, 'pcbench.uncertified("by hand")'))
    pcbench.run(STUDY | {"observers": [f"{here}/mine.py:nudge", "kfbo", "open-loop"]}, out=here / "out")
    return here / "out"


@pytest.fixture
def old(out, tmp_path):
    """The same as a release of schema 5 left it."""
    shutil.copytree(out, tmp_path / "old")
    place = store.target(tmp_path / "old")
    for name in tables(tmp_path / "old"):
        table = pq.read_table(tmp_path / "old" / name, partitioning=None)
        table = table.drop_columns(
            [c for c in table.column_names if c.startswith("certified") or c in ("method", "reason")]
        )
        store.put(
            place,
            name,
            parquet.encoded(table.replace_schema_metadata(table.schema.metadata | {b"pcbench.schema": b"5"})),
        )
    sealed_again(tmp_path / "old", schema="5")
    return tmp_path / "old"


def shown(show, *what):
    """What a person reads."""
    console = Console(record=True, width=140)
    show(*what, console)
    return console.export_text()


def test_a_certificate_proves_with_a_margin_above_zero_and_not_by_having_nothing_to_prove():
    proven = Certificate("radius < 1", 0.2, "poles", "solved")
    each = [
        (proven, True),
        (proven._replace(margin=-0.2), False),
        (proven._replace(margin=float("nan")), False),
        (proven._replace(inequality="none: nonlinear", margin=float("inf")), False),
        (proven._replace(inequality=NO_GAIN, margin=float("inf")), None),
        (uncertified("by hand"), False),
        (uncertified("by hand")._replace(margin=1.0), False),
    ]
    for certificate, said in each:
        assert is_certified(certificate._asdict()) is said, certificate


def test_the_tables_say_whether_gains_are_certified(out):
    result = pcbench.opened(out)
    for frame in (result.stats, pd.read_parquet(out / "stats.parquet")):
        assert frame.groupby("observer").certified.unique().map(list).to_dict() == {o: [p] for o, p in PROVEN.items()}
    for row in result.pairs.itertuples():
        assert (row.certified_a, row.certified_b) == (PROVEN[row.observer_a], PROVEN[row.observer_b])


def test_every_table_for_a_person_marks_what_nothing_proves(out):
    result = pcbench.opened(out)
    closing = shown(lambda console: results.closing(result, console, "tail_rmse"))
    assert "* Nothing proves the gains of nudge (by hand)." in closing
    (table,) = headline.headlines(result, "cart/slow", "position", "tail_rmse")
    state = shown(folder.status, verify.status(out), "out")
    found = compare(out, out)
    changed = shown(comparison.comparison, found._replace(rows=found.rows.assign(changed=True)), "there", "here")
    for text in (closing, "\n".join(row["cells"][0] + " " for row in table.rows), state, changed):
        assert "nudge * " in text
        assert "kfbo *" not in text
        assert "open-loop *" not in text


def test_of_several_cells_the_weakest_proof_is_kept():
    some = {"inequality": "radius < 1", "margin": 0.2, "status": "solved"}
    none = {"inequality": "none: by hand", "margin": None, "status": "uncertified"}
    nothing = {"inequality": NO_GAIN, "margin": None, "status": "not needed"}
    assert sorted([nothing, some, none], key=summary._strength) == [none, some, nothing]


def test_a_dataset_of_schema_5_is_read_compared_verified_and_merged(out, old, tmp_path):
    result = pcbench.opened(old)
    assert result.stats.certified.isna().all(), "unknown"
    assert list(result.stats.columns) == list(pcbench.opened(out).stats.columns)
    assert result.pairs[["certified_a", "certified_b"]].isna().all(axis=None)
    assert verify.status(old).closed
    assert compare(old, out).identical
    found = verify.verify(old, 1, 0)
    assert not found.wrong
    assert not found.differing
    merge.merge([old, out], tmp_path / "both")
    assert pcbench.opened(tmp_path / "both").stats.equals(pcbench.opened(out).stats), "closed anew: known"


def test_a_table_of_schema_5_that_does_not_follow_is_named(old):
    place = store.target(old)
    table = summary.table(place, "stats.parquet")
    i = table.schema.get_field_index("mean")
    store.put_table(place, "stats.parquet", table.set_column(i, table.schema.field(i), [table["se"]]))
    sealed_again(old)
    (said,) = verify.verify(old, 0, 0).wrong
    assert said.startswith("stats.parquet: does not follow")
