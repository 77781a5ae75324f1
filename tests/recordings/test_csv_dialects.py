"""A table is read as it was meant, whatever program has written it, and what cannot be read is one sentence with its row."""

import numpy as np
import pytest

from pcbench.errors import UserError
from pcbench.recordings import readers

T, Y = np.array([0.0, 0.05, 0.1, 0.15]), np.array([0.0, -1.25, 0.5, 2e-3])
LABVIEW = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDate\t2014/05/06\nTime\t18:42:19,71\n***End_of_Header***\t\n\n"
    "Channels\t1\t\nSamples\t4\t\n***End_of_Header***\t\t\nt\ty\tComment\n"
)


def lines(separator=",", head="t,y", decimal=".", end="\n", stamp=lambda t: f"{t:.3f}"):
    """The table as text: a head, and four rows."""
    rows = [f"{stamp(t)}{separator}{y:.4f}".replace(".", decimal) for t, y in zip(T, Y, strict=True)]
    return end.join([*([head.replace(",", separator)] if head else []), *rows]) + end


def read(folder, content, name="run.csv", keys="", field="y", sampled="t"):
    """Stamps and values of a channel of a file with this content."""
    data = content if isinstance(content, bytes) else content.encode()
    (folder / name).write_bytes(data)
    text = f'log = "{name}"\n{keys}\n[channels.y1]\nfield = "{field}"\nsampled = "{sampled}"\nunit = "m"\ndelay = 0.0'
    (folder / "log.toml").write_text(text)
    parts = list(readers.open_log(folder / "log.toml").measurements())
    return np.concatenate([p.sampled for p in parts]), np.concatenate([p.value for p in parts])


@pytest.mark.parametrize(
    "content",
    [
        lines(),
        lines(end="\r\n"),
        lines(";"),
        lines("\t"),
        lines("|"),
        lines(";", decimal=","),
        lines("\t", decimal=","),
        LABVIEW + lines("\t", head="", decimal=",").replace("\n", "\t\n"),
        lines(head="").join(['"t","y"\n', ""]),
        "# made by logger 3\n# fs = 20\n" + lines() + "# end, of, file\n",
        "#" + lines(),
        "% " + lines(" ", head="t,y"),
        lines("   ", head="t,y"),
        lines(" \t ", head="t,y").replace("\n", "  \n  "),
        lines(head="t,y\ns,m"),
        lines(head="t,y\n[s],[m]"),
        lines(head="t (s),y (m)"),
        "\ufeff" + lines(),
        lines().encode("utf-16"),
        lines(head="t,y,°C").replace("0\n", "0,3\n").encode("latin-1"),
        lines().rstrip("\n"),
        lines(head="t,y,note").replace("0\n", '0,"calm, dry"\n'),
    ],
    ids=range(22),
)
def test_table_is_read_in_any_dialect(tmp_path, content):
    t, y = read(tmp_path, content)
    np.testing.assert_array_equal(t, T)
    np.testing.assert_array_equal(y, Y)


@pytest.mark.parametrize(
    ("stamp", "start"),
    [
        (lambda t: f"2026-03-01T12:00:00.{1000 * t:03.0f}", 1772366400),
        (lambda t: f"2026-03-01 13:00:00.{1000 * t:03.0f}+01:00", 1772366400),
        (lambda t: f"2026-03-01T12:00:00.{1000 * t:03.0f}000000Z", 1772366400),
        (lambda t: f"23:59:59.{1000 * t:03.0f}", 86399),
    ],
)
def test_dates_and_times_of_day_are_seconds(tmp_path, stamp, start):
    t, _ = read(tmp_path, lines(stamp=stamp))
    np.testing.assert_allclose(t, start + T, rtol=0, atol=3e-7)  # of doubles near 1.8e9


def test_unit_of_stamps_is_that_of_head_or_line_of_units(tmp_path):
    for head in ("t [ms],y [m]", "t (ms),y (m)", "t,y\nms,m", "t [µs],y [°]".replace("µs", "ms")):
        np.testing.assert_allclose(read(tmp_path, lines(head=head))[0], 1e-3 * T)
    np.testing.assert_allclose(read(tmp_path, lines(head="t [µs],y [°]").encode("latin-1"))[0], 1e-6 * T)


def test_table_without_head_has_columns_by_number(tmp_path):
    t, y = read(tmp_path, lines(head=""), name="noheader.txt", field="1", sampled="0")
    np.testing.assert_array_equal(t, T)
    np.testing.assert_array_equal(y, Y)


@pytest.mark.parametrize("head", ["# timestamp tx ty tz qx qy qz qw\n", ""])
def test_trajectory_of_tum_has_its_columns(tmp_path, head):
    rows = "".join(f"{t:.2f} 1.0 {y:.4f} 0 0 0 0 1\n" for t, y in zip(T, Y, strict=True))
    t, y = read(tmp_path, head + rows, name="groundtruth.txt", field="ty", sampled="timestamp")
    np.testing.assert_array_equal(y, Y)
    np.testing.assert_array_equal(t, T)


def test_trajectory_of_euroc_has_its_columns(tmp_path):
    rows = "".join(f"{1403636580838555648 + int(1e9 * t)},{y:.4f},1.0\n" for t, y in zip(T, Y, strict=True))
    head = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m]\n"
    t, y = read(tmp_path, head + rows, field="p_RS_R_x", sampled="timestamp")
    np.testing.assert_array_equal(y, Y)
    np.testing.assert_allclose(t - t[0], T, atol=3e-7)


def test_keys_of_toml_decide_what_is_ambiguous(tmp_path):
    _, y = read(tmp_path, "0,1\n" + lines(head=""), keys="[csv]\nhead = 1", field="1", sampled="0")
    np.testing.assert_array_equal(y, Y)
    _, y = read(tmp_path, lines(";", decimal=","), keys='[csv]\nseparator = ";"\ndecimal = ","\nencoding = "latin-1"')
    np.testing.assert_array_equal(y, Y)


@pytest.mark.parametrize(
    ("keys", "sentence"),
    [
        ('encoding = "zlib"', "encoding: 'zlib' is not a text encoding"),
        ('encoding = "none"', "encoding: unknown encoding: none"),
        ('separator = "\\n"', "run.csv: "),
        ('separator = ";;"', "csv.separator: string should have at most 1 character"),
        ('decimal = "1"', "run.csv: "),
        ("head = 99", "'y' is no column here"),
        ("skip = 1", "csv: 'skip' is no key; valid: decimal, encoding, head, separator"),
    ],
)
def test_what_a_table_csv_gives_wrong_is_one_sentence(tmp_path, keys, sentence):
    with pytest.raises(UserError) as caught:
        read(tmp_path, lines(), keys=f"[csv]\n{keys}")
    assert sentence in str(caught.value)


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        (
            lines().replace("-1.25", "much"),
            "row 2: got 'much00' as y, expected a number; correct it, or leave it empty",
        ),
        (lines().replace("-1.25", "1,25"), "row 2: got 3 cells, expected 2 as in the other rows"),
        (lines()[:-8], "row 4: got 1 cells, expected 2 as in the other rows"),
        (lines(head="t,y,y").replace("0\n", "0,1\n"), "got 2 columns 'y', expected one; rename them"),
        (
            lines(stamp=lambda t: f"01.03.2026 12:00:{t:.2f}"),
            "got '01.03.2026 12:00:0.00', expected numbers, or times such as 2026",
        ),
        (b"t,y\n0,1\n\0\0\0\0", "got bytes that are no text, expected a table"),
        (b"", "run.csv: got an empty file, expected a table as text"),
        (lines(head="a,b"), "'y' is no column here; "),
    ],
)
def test_what_cannot_be_read_is_one_sentence(tmp_path, content, sentence):
    with pytest.raises(UserError) as caught:
        read(tmp_path, content)
    assert sentence in str(caught.value)
    assert "run.csv" in str(caught.value) or "log.toml: t:" in str(caught.value)
    assert str(caught.value).count(". ") == 0
