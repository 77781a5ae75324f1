"""A place that fails in mid-run: one sentence, and every finished block kept."""

import shutil

import pytest
from small_study import STUDY, tables

import pcbench
from pcbench.dataset import storage, task, verify
from pcbench.errors import UserError


def test_a_folder_removed_while_running_is_one_sentence(tmp_path, monkeypatch):
    out, before = tmp_path / "out", task.compute
    monkeypatch.setattr(task, "compute", lambda *a: (shutil.rmtree(out, ignore_errors=True), before(*a))[1])
    with pytest.raises(UserError, match=r"cannot be written \(No such file or directory\)"):
        pcbench.run(STUDY, out=out)
    assert not out.exists()


def test_a_disk_that_fills_up_keeps_every_finished_block(whole, tmp_path, monkeypatch):
    import os

    left, sync = [5], os.fsync

    def fill_up(handle):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        sync(handle)

    monkeypatch.setattr(storage.os, "fsync", fill_up)
    with pytest.raises(UserError, match=r"No space left on device\); every file already written is complete"):
        pcbench.run(STUDY, out=tmp_path / "out", block_size=16)
    monkeypatch.undo()
    finished = tables(tmp_path / "out")
    assert 0 < len(finished) < 12
    assert all(tables(whole)[name] == content for name, content in finished.items())
    assert not verify.status(tmp_path / "out").closed
    pcbench.run(STUDY, out=tmp_path / "out", block_size=16)
    assert tables(tmp_path / "out") == tables(whole)
