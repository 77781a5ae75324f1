"""A small file that unpacks to much memory is one sentence before it takes that memory."""

import resource
import subprocess
import sys
import zlib

import numpy as np
import pytest
from scipy.io import loadmat, savemat

from pcbench import toml_text
from pcbench.errors import UserError
from pcbench.logs import unpacked

OPEN = """
import resource, sys
from pcbench.errors import UserError
from pcbench.logs import matlab
from pathlib import Path
resource.setrlimit(resource.RLIMIT_AS, (4 * 2**30, 4 * 2**30))
try:
    next(matlab.reader([""])(Path(sys.argv[1]), "", ["x"], set(), None, "log"))
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
    unpacked.require_small_mat(path, "log")
    np.testing.assert_array_equal(loadmat(path)["x"].ravel(), x)


def test_what_is_damaged_or_of_another_format_is_left_to_the_reader(tmp_path):
    path = tmp_path / "bad.mat"
    for content in (b"", b"\0" * 200, b" " * 126 + b"IM" + b"\x0f\0\0\0\xff\0\0\0" + zlib.compress(b"a")[:4]):
        path.write_bytes(content)
        assert unpacked.require_small_mat(path, "log") is None, "no opinion of its own"


def test_a_chunk_may_be_some_times_larger_than_packed():
    unpacked.require_small(60 * 2**20, 1, "log")
    unpacked.require_small(100 * 2**20, 4 * 2**20, "log")
    with pytest.raises(UserError, match=r"log: got 0.022 MB that unpack to more than 67.1 MB"):
        unpacked.require_small(1_500_000_000, 22_000, "log")
    with pytest.raises(UserError, match="expected at most 50 times as much"):
        unpacked.require_small(201 * 2**20, 4 * 2**20, "log")


@pytest.mark.parametrize("text", ["{} = 1", "[{}]", "x = {{{} = 1}}", "[[{}]]", 'b = 1\n"q" . {} = 2'])
def test_a_key_of_many_parts_is_refused_before_it_takes_memory(text):
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(ValueError, match="nested deeper than 64"):
        toml_text.parse(text.format(".".join(["a"] * 20_000)))
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 100_000
    assert toml_text.parse("a.b.c = 1\nx = [" + "0.5, " * 5000 + "1.0]")["a"] == {"b": {"c": 1}}
