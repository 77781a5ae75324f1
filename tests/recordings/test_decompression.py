"""A small file that unpacks to much memory is one sentence before it takes that memory."""

import resource
import subprocess
import sys
import tracemalloc
import zlib
from functools import partial

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from pcbench import toml_text
from pcbench.errors import UserError
from pcbench.recordings import decompression, rosbag
from pcbench.recordings import mcap as mcap_reader
from pcbench.recordings.log import Source

OPEN = """
import resource, sys
from pcbench.errors import UserError
from pcbench.recordings import matlab
from pcbench.recordings.log import Source
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, 4 * 2**30))
try:
    next(matlab.columns(Source(Path(sys.argv[1]), "", ["x"], set(), None, "log", {""}, {})))
except UserError as error:
    print(error)
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024)
"""


@pytest.mark.nightly
def test_a_matlab_file_that_unpacks_to_much_memory_is_refused(tmp_path):
    path = tmp_path / "zeros.mat"
    savemat(path, {"x": np.zeros(12_000_000)}, do_compression=True)
    assert path.stat().st_size < 1e6
    done = subprocess.run([sys.executable, "-c", OPEN, path], capture_output=True, text=True, timeout=120, check=True)
    sentence, most = done.stdout.splitlines()
    assert "MB that unpack to more than 67.1 MB" in sentence
    assert int(most) < 1000


@pytest.mark.parametrize("packed", [True, False])
def test_a_matlab_file_of_a_recording_is_read(packed, tmp_path):
    path = tmp_path / "run.mat"
    x = np.random.default_rng(0).normal(size=100_000)
    savemat(path, {"x": x, "s": {"y": x.astype(np.float32)}}, do_compression=packed)
    decompression.require_small_mat(path, "log")
    np.testing.assert_array_equal(loadmat(path)["x"].ravel(), x)


def test_what_is_damaged_or_of_another_format_is_left_to_the_reader(tmp_path):
    path = tmp_path / "bad.mat"
    for content in (b"", b"\0" * 200, b" " * 126 + b"IM" + b"\x0f\0\0\0\xff\0\0\0" + zlib.compress(b"a")[:4]):
        path.write_bytes(content)
        assert decompression.require_small_mat(path, "log") is None, "no opinion of its own"


def test_a_chunk_may_be_some_times_larger_than_packed():
    decompression.require_small(60 * 2**20, 1, "log")
    decompression.require_small(100 * 2**20, 4 * 2**20, "log")
    with pytest.raises(UserError, match=r"log: got 0.022 MB that unpack to more than 67.1 MB"):
        decompression.require_small(1_500_000_000, 22_000, "log")
    with pytest.raises(UserError, match="expected at most 50 times as much"):
        decompression.require_small(201 * 2**20, 4 * 2**20, "log")


ZEROS = bytes(2**28)


def mcap(folder, codec, summary):
    """An MCAP whose one message is 256 MB of zeros, with a summary, without one, or with one that says it is small."""
    from mcap.reader import make_reader
    from mcap.writer import CompressionType, IndexType, Writer

    path = folder / "zeros.mcap"
    with path.open("wb") as file:
        index = IndexType.ALL if summary else IndexType.NONE
        writer = Writer(file, compression=CompressionType[codec], index_types=index, use_statistics=False)
        writer.start()
        channel = writer.register_channel("/a", "json", writer.register_schema("a", "jsonschema", b"{}"))
        writer.add_message(channel, 0, ZEROS, 0)
        writer.finish()
    if summary == "false":
        with path.open("rb") as file:
            (chunk,) = make_reader(file).get_summary().chunk_indexes
        size, content = chunk.uncompressed_size.to_bytes(8, "little"), path.read_bytes()
        ends = (
            content.index(size),
            content.rindex(size),
        )  # in the chunk and in its index; in between perhaps that of lz4
        for at in ends:
            content = content[:at] + (1000).to_bytes(8, "little") + content[at + 8 :]
        path.write_bytes(content)
    return path, mcap_reader.columns


def bag(folder, ros, how):
    """A bag whose one message is 256 MB of zeros."""
    from rosbags import rosbag1, rosbag2
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    if ros == 1:
        path, writer = folder / "zeros.bag", rosbag1.Writer(folder / "zeros.bag")
        writer.set_compression(rosbag1.Writer.CompressionFormat[how])
    else:
        path, writer = folder / "zeros", rosbag2.Writer(folder / "zeros", version=9)
        writer.set_compression(rosbag2.CompressionMode[how], rosbag2.CompressionFormat.ZSTD)
    with writer:
        writer.write(writer.add_connection("/a", "std_msgs/msg/String", typestore=store), 0, ZEROS)
    return path, rosbag.columns


LARGE = {
    f"MCAP {c}, summary {s}": partial(mcap, codec=c, summary=s) for c in ("ZSTD", "LZ4") for s in ("", "true", "false")
}
HOW = ((1, "BZ2"), (1, "LZ4"), (2, "FILE"), (2, "MESSAGE"))
LARGE |= {f"ROS {ros}, {how}": partial(bag, ros=ros, how=how) for ros, how in HOW}


@pytest.mark.ci
@pytest.mark.parametrize("name", LARGE)
def test_a_bag_that_unpacks_to_much_memory_is_refused_before_it_takes_it(name, tmp_path):
    path, columns = LARGE[name](tmp_path)
    tracemalloc.start()
    try:
        with pytest.raises(UserError, match=r"MB that unpack to more than 67.1 MB, expected at most 50 times as much"):
            next(columns(Source(path, "/a", ["data"], set(), None, "log", {"/a"}, {})))
        assert tracemalloc.get_traced_memory()[1] < 2**27
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("text", ["{} = 1", "[{}]", "x = {{{} = 1}}", "[[{}]]", 'b = 1\n"q" . {} = 2'])
def test_a_key_of_many_parts_is_refused_before_it_takes_memory(text):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="nested deeper than 64"):
        toml_text.parse(text.format(".".join(["a"] * 20_000)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000
    assert toml_text.parse("a.b.c = 1\nx = [" + "0.5, " * 5000 + "1.0]")["a"] == {"b": {"c": 1}}
