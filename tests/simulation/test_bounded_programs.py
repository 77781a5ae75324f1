"""Compiled programs: a process keeps a bounded number of them, and with them its memory mappings."""

import resource
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Barrier

import numpy as np
import pytest

from pcbench.runtime import program_cache

MAPPED = Path(__file__).parents[1] / "support" / "mapped.py"
START, EACH = 2500, 600  # mappings of a process that has imported all, and of a program


@pytest.mark.ci
def test_a_bounded_function_drops_its_programs():
    power = program_cache.jit_with_limit(lambda n, x: x**n, 0)
    for n in range(3 * program_cache.MOST):
        assert power(n, np.full(2, 2.0)).tolist() == [2.0**n, 2.0**n]
        assert power._cache_size() <= program_cache.MOST


@pytest.mark.ci
def test_programs_that_were_asked_for_last_are_kept():
    programs = program_cache.Programs()
    for i in range(program_cache.MOST):
        programs.ask(i, lambda i=i: [i])
    assert programs.ask(0, list) == [0]
    programs.ask("new", lambda: ["new"])
    assert list(programs) == [*range(2, program_cache.MOST), 0, "new"]
    assert programs.compilations == program_cache.MOST + 1


def test_different_programs_are_made_side_by_side_and_one_is_made_once():
    programs, both = program_cache.Programs(), Barrier(2, timeout=30)

    def new():
        both.wait()  # breaks unless the other one is being made too
        return [0]

    with ThreadPoolExecutor(4) as threads:
        found = list(threads.map(lambda key: programs.ask(key, new), "abab"))
    assert found[0] is found[2]
    assert found[1] is found[3]
    assert found[0] is not found[1]
    assert programs.compilations == 2


def test_a_program_that_cannot_be_made_is_asked_for_again():
    programs = program_cache.Programs()
    with pytest.raises(ZeroDivisionError):
        programs.ask("one", lambda: 1 / 0)
    assert programs.compilations == 0
    assert programs.ask("one", lambda: 1) == 1
    assert programs.ask("one", lambda: 2) == 1


@pytest.mark.parametrize(("each", "kept"), [(600, 16), (1000, 10), (4000, 2), (6000, 1), (20_000, 1)])
def test_fewer_are_kept_of_programs_with_many_mappings(monkeypatch, each, kept):
    """Those of everything else in the process do not count."""
    programs, mapped = program_cache.Programs(), [40_000]
    monkeypatch.setattr(program_cache, "_mappings", lambda: mapped[0])

    def new():
        mapped[0] += each
        return each

    for i in range(20):
        programs.ask(i, new)
        assert len(programs) == min(i + 1, kept)
    assert list(programs) == list(range(20 - kept, 20))


@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="mappings are counted on Linux")
def test_mappings_are_those_of_the_process():
    with open("/proc/self/maps") as lines:
        assert abs(program_cache._mappings() - sum(1 for _ in lines)) < 50


def resident():
    """Megabytes of this process that are in memory."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize() // 2**20


@pytest.mark.skipif(not hasattr(program_cache._libc(), "malloc_trim"), reason="glibc keeps memory that was freed")
def test_memory_that_was_freed_goes_back_when_a_program_is_made():
    before, blocks = resident(), [b"x" * 100_000 for _ in range(3000)]
    blocks = blocks[-1:]  # the last one keeps all before it from being given back
    assert resident() - before > 200
    program_cache.Programs().ask("one", list)
    assert resident() - before < 50
    assert len(blocks) == 1


@pytest.mark.nightly
@pytest.mark.skipif(not Path("/proc/self/maps").exists(), reason="mappings are counted on Linux")
def test_mappings_stay_bounded_after_40_programs(tmp_path):
    command = [sys.executable, str(MAPPED), "40"]
    found = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, timeout=600, check=True)
    assert int(found.stdout.split()[-1]) < START + EACH * program_cache.MOST
