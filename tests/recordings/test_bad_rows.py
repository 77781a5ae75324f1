"""What is wrong with a log is one sentence that names the file and the row."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from logged import MOTOR, plain, rows

import pcbench
from pcbench.cli.render.recordings import describe_irregularities
from pcbench.errors import UserError
from pcbench.playback.replay import describe_out_of_sequence
from pcbench.recordings import readers, tables
from pcbench.recordings.survey import channel_rows, survey


def spoilt(column, row, value):
    """The plain log with one entry changed; rows count from 1."""
    out = plain()
    out[column] = list(out[column])
    out[column][row - 1] = value
    return out


def without(column):
    return {name: v for name, v in plain().items() if name != column}


@pytest.mark.parametrize("kind", ["csv", "parquet"])
@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (spoilt("arrived", 7, 0.1), "row 7 of channel y1: got a sample that arrived 0.2 s before it was sampled"),
        (spoilt("value", 5, np.inf), "row 5 of channel y1: got the value inf"),
        (spoilt("sampled", 9, np.nan), "row 9 of channel y1: got a sample without a time"),
        (without("value"), "'value' is no column here"),
        (without("channel"), "'channel' is no column here"),
        (without("arrived"), "got no column 'arrived'"),
        (plain() | {"sampled": plain()["sampled"] * 1e9 + 1.7e18}, "got 1.7e+18 without a unit, expected seconds"),
    ],
)
def test_a_bad_row_is_named(tmp_path, kind, columns, sentence):
    with pytest.raises(UserError) as caught:
        survey(readers.open_log(rows(tmp_path / "log", columns, kind=kind)))
    assert sentence in str(caught.value)
    assert str(caught.value).count(". ") == 0


def test_the_first_stamp_that_goes_back_is_told_with_its_row(tmp_path):
    """It is no mistake: rows may stand in any order, and each counts at its stamp. `replay` says so too."""
    log = readers.open_log(rows(tmp_path / "log", spoilt("sampled", 9, 0.012)))
    found = survey(log)
    (row,) = channel_rows(found)
    assert (row["out_of_order"], row["out_of_order_row"]) == (1, 9)
    assert "1 out-of-sequence sample, the first in row 9" in describe_irregularities(row)
    assert describe_out_of_sequence(found)[0].startswith(
        "row 9 of channel y1 is out-of-sequence, the first of 1: each is used"
    )


@pytest.mark.parametrize("column", ["channel", "sampled", "arrived", "value"])
def test_a_column_of_another_kind_is_named(tmp_path, column):
    folder = rows(tmp_path / "log", plain() | {column: [[1.0, 2.0]] * 40}, kind="parquet")
    with pytest.raises(UserError, match=f"measurements.parquet: {column}: got list<element: double>, expected n"):
        survey(readers.open_log(folder))


@pytest.mark.parametrize(
    ("column", "value"), [("t", "much"), ("t", [1.0]), ("x", "much"), ("x", [1.0]), ("x", pd.Timedelta(1))]
)
def test_a_column_of_another_kind_in_a_table_of_any_shape_is_named(tmp_path, column, value):
    table = {"t": np.arange(3.0), "x": np.ones(3)} | {column: [value] * 3}
    pd.DataFrame(table).to_parquet(tmp_path / "run.parquet", index=False)
    (tmp_path / "log.toml").write_text('log = "run.parquet"\n[channels.y1]\nfield = "x"\nunit = "m"\ndelay = 0.0')
    with pytest.raises(UserError, match=f"^log.toml: {column}: got .*, expected numbers.*; correct the column"):
        survey(readers.open_log(tmp_path / "log.toml"))


def test_a_word_among_numbers_is_quoted(tmp_path):
    folder = rows(tmp_path / "log", spoilt("value", 3, "much"))
    with pytest.raises(UserError, match="'much'"):
        survey(readers.open_log(folder))


def test_where_memory_runs_out_the_file_is_not_blamed(tmp_path, monkeypatch):
    folder = rows(tmp_path / "log", plain())

    def full(*_, **__):
        raise pa.ArrowMemoryError("malloc of 1048576 failed")

    monkeypatch.setattr(tables.csv, "open_csv", full)
    with pytest.raises(UserError) as caught:
        readers.open_log(folder)
    assert str(caught.value).endswith(
        "memory ran out while it was read (malloc of 1048576 failed), expected more; end other programs."
    )


@pytest.mark.parametrize(("head", "scale"), [("sampled [ms]", 1e3), ("sampled [ns]", 1e9), ("sampled", 1.0)])
def test_a_head_says_the_unit_of_time(tmp_path, head, scale):
    columns = plain()
    columns[head] = columns.pop("sampled") * scale
    found = survey(readers.open_log(rows(tmp_path / "log", columns)))
    assert found.channels["y1"].delays.mean == pytest.approx(0.1, abs=1e-9)


@pytest.mark.parametrize(
    ("table", "head"), [("measurements", "value [mm]"), ("inputs", "u1 [mV]"), ("truth", "angle [°]")]
)
def test_unit_of_values_in_a_head_is_refused(tmp_path, table, head):
    """The plant's is meant, and nothing would convert it."""
    frames = {"measurements": plain(), "inputs": {"t": [0.0], "u1": [0.5]}, "truth": {"t": [0.0], "angle": [0.1]}}
    frames[table] = {head if name in ("value", "u1", "angle") else name: v for name, v in frames[table].items()}
    for name, columns in frames.items():
        pd.DataFrame(columns).to_csv(tmp_path / f"{name}.csv", index=False, encoding="latin-1")
    with pytest.raises(UserError) as caught:
        readers.open_log(tmp_path)
    assert f"{table}.csv: got the column '{head}', expected '{head.split()[0]}' in the unit of the plant" in str(
        caught.value
    )


def test_a_stated_delay_stands_for_arrivals(tmp_path):
    folder = rows(tmp_path / "log", without("arrived"))
    assert survey(readers.open_log(folder, 0.25)).channels["y1"].delays.mean == pytest.approx(0.25)
    with pytest.raises(UserError, match="expected 0 s or more"):
        readers.open_log(folder, -1.0)
    with pytest.raises(UserError, match="expected one of them"):
        readers.open_log(rows(tmp_path / "other", plain()), 0.1)


@pytest.mark.parametrize(
    ("inputs", "sentence"),
    [
        ({"t": [0.0, 0.2, 0.1], "u1": [1.0, 2.0, 3.0]}, "row 3: got the time 0.1 s after 0.2 s, expected later times"),
        ({"t": [0.0, 0.2, 0.2], "u1": [1.0, 2.0, 3.0]}, "row 3: got the time 0.2 s after 0.2 s"),
        ({"t": [0.0, 0.2], "u1": [1.0, np.inf]}, "row 2: got inf as u1, expected a finite number"),
        ({"t": [0.0, 0.2], "u1": [1.0, 2.0], "u2": [0.0, 1.0]}, "expected one for each of the plant's 1 inputs"),
        ({"t": [0.0, 0.2]}, "got the column t alone"),
    ],
)
def test_a_bad_row_of_inputs_is_named(tmp_path, inputs, sentence):
    folder = rows(tmp_path / "log", plain(), inputs)
    with pytest.raises(UserError) as caught:
        pcbench.replay(folder, MOTOR, "model-only")
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("columns", "sentence"),
    [
        (spoilt("sampled", 9, 0.301), "got a sample on the same tick"),
        (
            plain() | {"sampled": plain()["sampled"] * 200, "arrived": plain()["sampled"] * 200},
            "10 s without a sample before row 2",
        ),
        (plain() | {"channel": ["y1", "y2"] * 20}, "got the channels y1, y2, expected one for each of the 1 outputs"),
    ],
)
def test_a_log_that_does_not_fit_a_plant_is_one_sentence(tmp_path, columns, sentence):
    with pytest.raises(UserError) as caught:
        pcbench.replay(rows(tmp_path / "log", columns), MOTOR, "model-only")
    assert sentence in str(caught.value)


def test_what_is_no_log_is_one_sentence(tmp_path):
    with pytest.raises(UserError, match="no such file"):
        readers.open_log(tmp_path / "none")
    with pytest.raises(UserError, match=r"a folder without measurements\.parquet"):
        readers.open_log(tmp_path)
    (tmp_path / "flight.bag").write_bytes(b"")
    (tmp_path / "run.csv").write_text("t,y\n0,1\n")
    for name in ("flight.bag", "run.csv"):
        with pytest.raises(UserError, match=rf"expected a TOML that maps .* pcbench info .*{name} --toml"):
            readers.open_log(tmp_path / name)
