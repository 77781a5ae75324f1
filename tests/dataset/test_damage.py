"""Damage anywhere in a dataset is seen, named in one sentence, and mended by running the study again."""

import json
import os
import socket
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from commands import call
from small_study import STUDY, same, tables

import pcbench
from pcbench.dataset import block_files, parquet_io, storage, verify
from pcbench.errors import UserError
from pcbench.plots import one_run


def assert_one_sentence(done, code=2):
    """One sentence and no traceback."""
    assert done.returncode == code, done.stderr
    assert "Traceback" not in done.stderr + done.stdout
    assert done.stderr.count("\n") <= 1, done.stderr
    return done.stderr


@pytest.mark.parametrize(
    "text", ["[1, 2]", *(pytest.param(t, marks=pytest.mark.nightly) for t in ("3", "", "{", '{"schema": "0"}', "null"))]
)
def test_a_provenance_that_is_none_is_seen_and_made_anew(whole, copy, text):
    (copy / "provenance.json").write_text(text)
    assert "provenance.json: is damaged; run the study again" in assert_one_sentence(call("report", copy))
    assert_one_sentence(call("compare", whole, copy))
    found = verify.status(copy)
    assert not found.closed
    assert found.damaged == ["provenance.json"]
    assert call("status", copy).returncode == 1
    pcbench.run(STUDY, out=copy)
    assert verify.status(copy).damaged == []
    same(whole, copy)


@pytest.mark.parametrize("closed", [False, True])
def test_what_a_killed_writer_of_closing_tables_leaves_is_cleared_away(whole, copy, closed):
    writer = subprocess.Popen([sys.executable, "-c", ""])
    writer.wait()
    (copy / f".{socket.gethostname()}-{writer.pid}-9.partial").write_bytes(b"half")
    if not closed:
        (copy / "provenance.json").unlink()
    pcbench.run(STUDY, out=copy)
    assert {p.name for p in copy.iterdir()} == {p.name for p in whole.iterdir()}


@pytest.mark.ci
@pytest.mark.parametrize("name", ["stats.parquet", "pairs.parquet", "provenance.json"])
def test_a_flipped_bit_anywhere_in_a_closing_file_is_seen(copy, name):
    """In a page, a footer or a word: drawn over the file, its first and last bytes among them."""
    content, rng = (copy / name).read_bytes(), np.random.default_rng(5)
    for at in (0, len(content) - 2, *rng.integers(0, len(content) - 1, 12)):
        spoilt = bytearray(content)
        spoilt[at] ^= 1 << int(rng.integers(8))
        if name.endswith(".json") and _alike(spoilt, content):
            continue  # blanks
        (copy / name).write_bytes(bytes(spoilt))
        assert verify.status(copy).damaged == [name], at
        with pytest.raises(UserError):
            pcbench.open_result(copy)
    (wrong,) = verify.verify(copy, 0, 0).wrong
    assert name in wrong
    pcbench.run(STUDY, out=copy)
    assert verify.verify(copy, 0, 0).wrong == []


def _alike(spoilt, content):
    try:
        return json.loads(spoilt) == json.loads(content)
    except ValueError:
        return False


@pytest.mark.nightly
def test_a_flipped_bit_in_an_example_is_seen_and_made_anew(copy):
    study = pcbench.open_result(copy).study
    made = one_run.frame_of(study, "cart/slow", copy)
    (path,) = (copy / "examples").iterdir()
    content, table = (
        path.read_bytes(),
        parquet_io.parse_table(storage.read_buffer(storage.target(copy), f"examples/{path.name}")),
    )
    values = table["value"].to_numpy().copy()
    values[3] += 1.0
    changed = table.set_column(table.schema.get_field_index("value"), "value", [values])
    storage.write_table(storage.target(copy), f"examples/{path.name}", changed)  # the pages' checksums are right
    (wrong,) = verify.verify(copy, 0, 0).wrong
    assert wrong.startswith("examples/")
    assert one_run.frame_of(study, "cart/slow", copy).equals(made)
    assert path.read_bytes() == content


@pytest.mark.parametrize("cut", [50, pytest.param(1, marks=pytest.mark.nightly)])
def test_a_block_cut_short_is_one_sentence_wherever_it_is_read(whole, copy, cut):
    block = sorted((copy / "runs").rglob("*.parquet"))[2]
    block.write_bytes(block.read_bytes()[:-cut])
    name = str(block.relative_to(copy))
    for words in (["report", copy], ["compare", whole, copy], ["merge", copy, whole, "--out", copy / "m"]):
        assert name in assert_one_sentence(call(*words)), words
    done = call("status", copy)
    assert done.returncode == 1
    assert name in done.stdout
    assert assert_one_sentence(call("verify", copy, "--sample", "0"), 1) == ""
    pcbench.run(STUDY, out=copy)
    same(whole, copy)


@pytest.mark.ci
def test_a_block_that_takes_much_memory_is_one_sentence_before_it_takes_it(copy):
    (block, *_) = sorted((copy / "runs").rglob("*.parquet"))
    zeros = pa.table({"mae": np.zeros(40_000_000)})
    pq.write_table(zeros, block)
    assert block.stat().st_size < 300_000
    with pytest.raises(pa.ArrowInvalid, match="320 MB in memory"):
        parquet_io.parse_table(pa.py_buffer(block.read_bytes()))
    done = call("verify", copy)
    assert done.returncode == 1
    assert "MB that take 320 MB in memory" in done.stdout
    assert done.stderr == ""


def test_a_flipped_bit_in_a_page_is_not_drawn(copy):
    block = sorted((copy / "runs").rglob("*.parquet"))[0]
    content = bytearray(block.read_bytes())
    content[200] ^= 4
    block.write_bytes(bytes(content))
    with pytest.raises(UserError, match="is damaged"):
        pcbench.open_result(copy).runs  # noqa: B018


@pytest.mark.parametrize("last", [10**20, 10**13])
def test_a_block_of_more_seeds_than_there_can_be_is_none(copy, last):
    folder = copy / "runs" / "scenario=cart%2Fslow" / "observer=kfbo"
    (folder / f"cell-00000-seeds-0000000000-{last}.parquet").write_bytes(b"PAR1")
    assert "is no block of a study" in assert_one_sentence(call("status", copy))
    assert block_files.block_of(f"runs/scenario=s/observer=o/cell-00000-seeds-0000000009-{3:010d}.parquet") is None


@pytest.mark.parametrize("damage", ["gone", "one byte", "empty"])
def test_a_lost_study_text_is_written_anew_by_the_study_itself(whole, copy, damage):
    """Every block says whose it is: the same study goes on, another one is refused, and nothing is done again."""
    path = copy / "study.toml"
    text, before = path.read_text(), tables(copy)
    path.unlink() if damage == "gone" else path.write_text("=" + text[1:] if damage == "one byte" else "")
    for other in (
        {"options": {"kfbo": {"R": 0.7}}},
        {"root_seed": 1},
        {"name": "other"},
        {"axes": {"noise_std": [0.1]}},
    ):
        with pytest.raises(UserError, match=r"is missing or damaged, and .* is not of the study given \(.+\)"):
            pcbench.run(STUDY | other, out=copy)
    with pytest.raises(UserError, match=r"study.toml"):
        verify.status(copy)
    done = pcbench.run(STUDY, out=copy)
    assert done.cost.runs == 0
    assert path.read_text() == text
    assert tables(copy) == before


def test_a_lost_study_text_keeps_the_numbers_of_its_cells(tmp_path):
    """A study that has grown: its cells stand in another order than a new one's would."""
    out = tmp_path / "out"
    pcbench.run(STUDY | {"axes": {"noise_std": [0.5]}}, out=out, seeds=4)
    grown = STUDY | {"axes": {"noise_std": [0.1, 0.5, 0.9]}}
    pcbench.run(grown, out=out, seeds=4)
    text, before = (out / "study.toml").read_text(), tables(out)
    (out / "study.toml").unlink()
    assert pcbench.run(grown, out=out, seeds=4).cost.runs == 0
    assert (out / "study.toml").read_text() == text
    assert tables(out) == before


def test_verify_says_where_the_study_is_not_the_one_that_was_run(copy):
    path = copy / "study.toml"
    path.write_text(path.read_text().replace("seeds = 40", "seeds = 41"))
    assert any("is not of the study that was run" in w for w in verify.verify(copy, 0, 0).wrong)


def test_a_pipe_is_no_study(tmp_path):
    os.mkfifo(tmp_path / "pipe.toml")
    assert "cannot be read (it is no file)" in assert_one_sentence(call("run", tmp_path / "pipe.toml"))


@pytest.mark.ci
def test_a_mark_of_the_byte_order_is_no_mistake(tmp_path):
    (tmp_path / "marked.toml").write_bytes(b'\xef\xbb\xbfscenarios = ["cart/slow"]\nseeds = 2\n')
    done = call("run", tmp_path / "marked.toml", "--observers", "model-only", "--quiet", "--out", tmp_path / "out")
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("command", ["run quick", "merge {} {}", "report {}", "report {} --figures"])
def test_an_empty_name_is_no_folder_and_leaves_nothing(command, whole, tmp_path):
    words, before = command.format(whole, whole).split(), set(whole.rglob("*"))
    words += ["", "--quiet"] if "--figures" in words else ["--out", ""]
    assert "got an empty name" in assert_one_sentence(call(*words, cwd=tmp_path))
    assert list(tmp_path.iterdir()) == []
    assert set(whole.rglob("*")) == before
