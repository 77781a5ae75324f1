"""Every table says which gains have no certificate."""

from pathlib import Path

import pandas as pd
import pytest

import pcbench
from pcbench.cli.render import folder, results
from pcbench.cli.render.tables import Screen
from pcbench.dataset import close, verify
from pcbench.dataset.compare import compare
from pcbench.report import headline
from pcbench.synthesis.certificate import NO_GAIN, Certificate, is_certified, no_certificate

SOURCE = (Path(__file__).parents[1] / "support" / "own_observer.py").read_text()
PROOF = 'Certificate("none: for tests", 1.0, "none", "none")'
PROVEN = {"nudge": False, "kfbo": True, "model-only": None}
STUDY = {"name": "proofs", "scenarios": ["cart/slow"], "observers": ["mine.py:nudge", "kfbo", "model-only"], "seeds": 4}


@pytest.fixture(scope="module")
def out(tmp_path_factory):
    """A study with an observer whose gains nothing proves."""
    here = tmp_path_factory.mktemp("proofs")
    assert PROOF in SOURCE
    (here / "mine.py").write_text(SOURCE.replace(PROOF, 'pcbench.no_certificate("by hand")'))
    pcbench.run(STUDY | {"observers": [f"{here}/mine.py:nudge", "kfbo", "model-only"]}, out=here / "out")
    return here / "out"


def rendered_text(show, *what):
    """What a person reads."""
    console = Screen(record=True, width=140)
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
        (no_certificate("by hand"), False),
        (no_certificate("by hand")._replace(margin=1.0), False),
    ]
    for certificate, said in each:
        assert is_certified(certificate._asdict()) is said, certificate


@pytest.mark.ci
def test_the_tables_say_whether_gains_are_certified(out):
    result = pcbench.open_result(out)
    for frame in (result.stats, pd.read_parquet(out / "stats.parquet")):
        assert frame.groupby("observer").certified.unique().map(list).to_dict() == {o: [p] for o, p in PROVEN.items()}
    for row in result.pairs.itertuples():
        assert (row.certified_a, row.certified_b) == (PROVEN[row.observer_a], PROVEN[row.observer_b])


@pytest.mark.ci
def test_every_table_for_a_person_marks_what_nothing_proves(out):
    result = pcbench.open_result(out)
    closing = rendered_text(lambda console: results.closing(result, console, "steady_rmse"))
    assert "* No certificate for the gains of nudge (by hand)." in closing
    (table,) = headline.headlines(result, "cart/slow", "position", "steady_rmse")
    state = rendered_text(folder.status, verify.status(out), "out")
    found = compare(out, out)
    rows = found.rows[found.rows.observer != "model-only"].assign(changed=True)  # few enough to be all shown
    changed = rendered_text(folder.comparison, found._replace(rows=rows), "there", "here")
    for text in (closing, "\n".join(row.cells[0] + " " for row in table.rows), state, changed):
        assert "nudge * " in text
        assert "kfbo *" not in text
        assert "model-only *" not in text


def test_of_several_cells_the_weakest_proof_is_kept():
    some = {"inequality": "radius < 1", "margin": 0.2, "status": "solved"}
    none = {"inequality": "none: by hand", "margin": None, "status": "uncertified"}
    nothing = {"inequality": NO_GAIN, "margin": None, "status": "not needed"}
    assert sorted([nothing, some, none], key=close._strength) == [none, some, nothing]
