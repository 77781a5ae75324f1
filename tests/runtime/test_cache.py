"""The cache folder: its owner's alone, and refused before anything is read where others may have written."""

import os
import stat
from typing import NamedTuple

import pytest

from pcbench import UserError
from pcbench.runtime import cache, config
from pcbench.synthesis import solvers


class Found(NamedTuple):
    """What a solver finds."""

    x: float


PARTS = [(), ("programs",), ("programs", "whole"), ("gains",)]


@pytest.fixture
def place(tmp_path, monkeypatch):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path / "cache"))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    return tmp_path / "cache"


@pytest.mark.parametrize("parts", PARTS)
def test_it_is_made_for_its_owner_alone(place, parts):
    before = os.umask(0)
    try:
        found = cache.folder(*parts)
        cache.keep(found / "deep" / "text", "a")
    finally:
        os.umask(before)
    every = [place, *(path for path in place.rglob("*") if path.is_dir())]
    assert found in every
    assert {stat.S_IMODE(each.stat().st_mode) for each in every} == {0o700}


@pytest.mark.parametrize("mode", [0o770, 0o707, 0o777, 0o720])
@pytest.mark.parametrize("parts", PARTS)
def test_one_that_others_may_write_to_is_refused(place, parts, mode):
    cache.folder(*parts).chmod(mode)
    with pytest.raises(UserError, match=r"other users may write to, expected .* PCBENCH_CACHE") as error:
        cache.folder(*parts)
    assert "\n" not in str(error.value)


def test_that_of_another_user_is_refused_by_all_that_read_it(place, monkeypatch):
    cache.folder()
    monkeypatch.setattr(os, "geteuid", lambda: place.stat().st_uid + 1)
    for read in (
        config.setup,
        lambda: solvers.solve_or_load(Found, "name", (), lambda solver: pytest.fail("nothing is solved"), "SCS"),
    ):
        with pytest.raises(UserError, match="that another user owns"):
            read()


def test_one_that_can_be_read_by_all_and_one_that_cannot_be_made_are_taken(place):
    cache.folder().chmod(0o755)
    assert cache.folder() == place
    place.chmod(0o700)
    (place / "gains").write_text("a file where a folder is to be")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PCBENCH_CACHE", str(place / "gains" / "below"))
        assert cache.folder("programs") == place / "gains" / "below" / "programs"
