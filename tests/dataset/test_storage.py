"""A file appears whole or not at all, in a folder and in an object store; what a file system refuses is one sentence."""

import errno
import os
import subprocess
import sys
import threading
from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.fs as pafs
import pyarrow.parquet as pq
import pytest

import pcbench
from pcbench.dataset import merge, parquet_io, storage, verify
from pcbench.errors import UserError

TABLE = pa.table({"seed": list(range(1000)), "mae": [0.1 * i for i in range(1000)]})


@pytest.fixture
def place(tmp_path):
    made = storage.target(tmp_path / "out")
    storage.create_folder(made)
    return made


@pytest.fixture(scope="module")
def s3():
    """A place in an S3 store of this process."""
    server = pytest.importorskip("moto.server").ThreadedMotoServer(port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    ours = {"AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test", "AWS_EC2_METADATA_DISABLED": "true"}
    before = {k: os.environ.get(k) for k in ours}
    os.environ.update(ours)
    where = f"endpoint_override={host}:{port}&scheme=http&region=us-east-1&allow_bucket_creation=true"
    fs, _ = pafs.FileSystem.from_uri(f"s3://bench?{where}")
    fs.create_dir("bench")
    yield lambda name: f"s3://bench/{name}?{where}"
    server.stop()
    for k, v in before.items():
        os.environ.pop(k) if v is None else os.environ.__setitem__(k, v)


def test_what_is_put_is_there_in_a_folder_and_in_a_bucket(place, s3):
    for each in (place, storage.target(s3("a/b"))):
        storage.write_table(each, "runs/scenario=x/part.parquet", TABLE)
        storage.write_json(each, "provenance.json", {"a": 1})
        assert storage.file_names(each) == ["provenance.json", "runs/scenario=x/part.parquet"]
        assert parquet_io.parse_table(storage.read_buffer(each, "runs/scenario=x/part.parquet")).equals(TABLE)
        assert storage.read_buffer(each, "nothing") is None
        storage.remove(each, "provenance.json")
        storage.remove(each, "provenance.json")
        assert storage.file_names(each) == ["runs/scenario=x/part.parquet"]


@pytest.mark.ci
@pytest.mark.usefixtures("in_a_hurry")
def test_a_study_in_a_bucket_is_that_in_a_folder(s3, tmp_path):
    study = {"name": "far", "scenarios": ["cart/slow"], "observers": ["kfbo"], "seeds": 6}
    here = pcbench.run(study, out=tmp_path / "out", block_size=4)
    pcbench.run(study, out=s3("far"), seeds=5, block_size=4)
    there = pcbench.run(study, out=s3("far"), block_size=4)
    pd.testing.assert_frame_equal(here.runs, there.runs)
    pd.testing.assert_frame_equal(here.stats, there.stats)
    assert verify.status(s3("far")).closed
    assert not verify.verify(s3("far"), None, 0).differing
    assert merge.merge([s3("far"), tmp_path / "out"], s3("both")).duplicates == 6


def test_equal_tables_give_equal_bytes():
    assert parquet_io.encode_table(TABLE).equals(parquet_io.encode_table(TABLE.slice(0)))


def test_a_page_that_was_touched_is_seen():
    content = bytearray(parquet_io.encode_table(TABLE))
    content[len(content) // 2] ^= 1
    with (
        pytest.raises(OSError, match=r"(?i)crc|checksum|corrupt|decompress"),
        pq.ParquetFile(pa.BufferReader(bytes(content)), page_checksum_verification=True) as file,
    ):
        file.read()


def refusing(monkeypatch, name, code):
    def refuse(*args, **kwargs):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(storage.os, name, refuse)


@pytest.mark.parametrize("call", ["fsync", "replace"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EROFS, errno.EACCES, errno.EDQUOT, errno.EIO])
def test_a_refusal_is_one_sentence_and_keeps_the_old_file(place, monkeypatch, call, code):
    storage.write_json(place, "a.json", {"old": 1})
    refusing(monkeypatch, call, code)
    with pytest.raises(UserError, match=rf"a.json: cannot be written \({os.strerror(code)}\)") as caught:
        storage.write_json(place, "a.json", {"new": 1})
    assert "\n" not in str(caught.value)
    monkeypatch.undo()
    assert storage.read_bytes(place, "a.json") == b'{\n  "old": 1\n}\n'
    assert storage.file_names(place) == ["a.json"]
    assert [p.name for p in Path(place.root).iterdir()] == ["a.json"], "nothing unfinished is left"


def test_a_folder_that_was_removed_is_not_made_again(place):
    Path(place.root).rmdir()
    with pytest.raises(UserError, match="No such file or directory"):
        storage.write_table(place, "runs/part.parquet", TABLE)
    assert not Path(place.root).exists()


@pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root may mount")
def test_a_disk_that_is_full_indeed(tmp_path):
    mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=64k", "none", str(tmp_path)], capture_output=True)
    if mounted.returncode:
        pytest.skip("no mount here")
    try:
        full = storage.target(tmp_path)
        storage.write_file(full, "small", b"x" * 1000)
        with pytest.raises(UserError, match="No space left on device"):
            storage.write_file(full, "large", b"x" * 100_000)
        assert storage.file_names(full) == ["small"]
        assert [p.name for p in tmp_path.iterdir()] == ["small"]
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


def test_what_a_killed_writer_left_is_cleared_and_a_living_ones_is_not(place):
    code = "import os; print(os.getpid(), flush=True); os.kill(os.getpid(), 9)"
    dead = int(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout)
    host, root = storage.socket.gethostname(), Path(place.root)
    for name in (
        f".{host}-{dead}-0.partial",
        f".{host}-{os.getpid()}-7.partial",
        ".elsewhere-1-0.partial",
        ".x.partial",
    ):
        (root / name).write_bytes(b"half")
    os.utime(root / ".elsewhere-1-0.partial", (0, 0))
    storage.create_folder(place)
    assert {p.name for p in root.iterdir()} == {f".{host}-{os.getpid()}-7.partial", ".x.partial"}, "one is not ours"
    assert storage.file_names(place) == []


def test_two_writers_of_one_name_leave_one_whole_file(place):
    content = parquet_io.encode_table(TABLE).to_pybytes()
    threads = [threading.Thread(target=storage.write_file, args=(place, "runs/a.parquet", content)) for _ in range(8)]
    for t in threads:
        t.start()
    for t in threads:
        t.join()
    assert storage.read_bytes(place, "runs/a.parquet") == content
    assert storage.file_names(place) == ["runs/a.parquet"]


@pytest.mark.parametrize(
    "uri", ["nosuch://a/b", pytest.param("s3://", marks=pytest.mark.nightly), "hdfs://nowhere:1/x"]
)
def test_a_place_that_cannot_be_reached_is_one_sentence(uri):
    with pytest.raises(UserError, match=r"cannot be|no place") as caught:
        storage.file_names(storage.target(uri))
    assert "\n" not in str(caught.value)
