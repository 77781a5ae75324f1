"""Compiled programs: a process keeps a bounded number of them, and with them its memory mappings."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from pcbench.simulation import compiling

MAPPED = Path(__file__).parents[1] / "support" / "mapped.py"
START, EACH = 2500, 600  # mappings of a process that has imported all, and of a program


def test_a_bounded_function_drops_its_programs():
    power = compiling.bounded(lambda n, x: x**n, 0)
    for n in range(3 * compiling.MOST):
        assert power(n, np.full(2, 2.0)).tolist() == [2.0**n, 2.0**n]
        assert power._cache_size() <= compiling.MOST


def test_a_cache_keeps_the_entries_that_were_asked_for_last():
    cache = {}
    for i in range(compiling.MOST):
        compiling.newest(cache, i, lambda i=i: [i])
    assert compiling.newest(cache, 0, list) == [0]
    compiling.newest(cache, "new", lambda: ["new"])
    assert list(cache) == [*range(2, compiling.MOST), 0, "new"]


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="mappings are counted on Linux")
def test_mappings_stay_bounded_after_40_programs(tmp_path):
    command = [sys.executable, str(MAPPED), "40"]
    found = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600, check=True)
    assert int(found.stdout.split()[-1]) < START + EACH * compiling.MOST
