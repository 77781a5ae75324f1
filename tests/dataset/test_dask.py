"""Dask's workers leave what this process leaves, byte for byte; one that dies costs nothing but time."""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import pytest
from small_study import tables

import pcbench
from pcbench.dataset import executors
from pcbench.errors import UserError

distributed = pytest.importorskip("distributed")
STUDY = {"name": "shared", "scenarios": ["cart/slow"], "observers": ["pccebo", "kfbo"], "seeds": 600, "root_seed": 3}
SMALL = {"block_size": 25}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    out = tmp_path_factory.mktemp("whole") / "out"
    pcbench.run(STUDY, out=out, **SMALL)
    return tables(out)


@pytest.mark.nightly
@pytest.mark.parametrize("workers", [1, 2, 4])
def test_workers_leave_the_same_bytes(whole, tmp_path, workers):
    pcbench.run(STUDY, out=tmp_path / "out", dask="local", workers=workers, **SMALL)
    assert tables(tmp_path / "out") == whole


@pytest.mark.nightly
def test_a_killed_worker_costs_nothing_but_time(tmp_path):
    study = STUDY | {"scenarios": ["cart/white"], "seeds": 8192, "axes": {"noise_std": [0.1, 0.2, 0.4, 0.8]}}
    out, killed, over = tmp_path / "out", [], threading.Event()

    def kill():
        """Kill a worker whenever some more blocks stand."""
        import psutil

        for many in (4, 10, 16):
            while len(list(out.rglob("cell-*.parquet"))) < many and not over.is_set():
                time.sleep(0.05)
            mine = [p for p in psutil.Process().children(recursive=True) if "spawn_main" in " ".join(p.cmdline())]
            if mine and not over.is_set():
                youngest = max(mine, key=lambda p: p.cpu_times().user)
                os.kill(youngest.pid, signal.SIGKILL)
                killed.append(youngest.pid)

    killer = threading.Thread(target=kill)
    killer.start()
    pcbench.run(study, out=out, dask="local", workers=2, block_size=1024)
    over.set()
    killer.join()
    assert killed
    pcbench.run(study, out=tmp_path / "undisturbed", block_size=1024)
    assert tables(out) == tables(tmp_path / "undisturbed")


@pytest.mark.nightly
def test_a_study_whose_scheduler_is_killed_ends_in_a_sentence_and_continues_without_it(tmp_path):
    study = STUDY | {"scenarios": ["cart/white"], "seeds": 8192, "axes": {"noise_std": [0.1, 0.2, 0.4, 0.8]}}
    out, address_file, over = tmp_path / "out", tmp_path / "scheduler.json", threading.Event()
    scheduler = [sys.executable, "-m", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", "0"]
    worker = [sys.executable, "-m", "distributed.cli.dask_worker", "--nthreads", "2", "--no-nanny"]
    processes = [subprocess.Popen([*scheduler, "--no-dashboard", "--scheduler-file", str(address_file)])]

    def kill():
        """Kill the scheduler as soon as some blocks stand."""
        while len(list(out.rglob("cell-*.parquet"))) < 4 and not over.is_set():
            time.sleep(0.05)
        processes[0].kill()

    try:
        while not address_file.exists() or not address_file.read_text():
            time.sleep(0.1)
        address = json.loads(address_file.read_text())["address"]
        processes.append(subprocess.Popen([*worker, "--scheduler-file", str(address_file)]))
        killer = threading.Thread(target=kill)
        killer.start()
        with pytest.raises(UserError, match="the scheduler has ended"):
            pcbench.run(study, out=out, dask=address, block_size=1024)
    finally:
        over.set()
        for process in processes:
            process.kill()
            process.wait()
    assert 4 <= len(list(out.rglob("cell-*.parquet"))) < 2 * 4 * 8
    pcbench.run(study, out=out, block_size=1024)
    pcbench.run(study, out=tmp_path / "undisturbed", block_size=1024)
    assert tables(out) == tables(tmp_path / "undisturbed")


@pytest.mark.ci
def test_a_mistake_on_a_worker_is_its_sentence():
    def work(task, device):
        if task == 3:
            raise UserError("disk: is full, expected room; make some.")
        return task

    with executors.dask("local", 1) as execute, pytest.raises(UserError, match="disk: is full"):
        list(execute(work, range(6)))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", "nonsense", "tcp:/x"])
def test_a_scheduler_that_is_not_there_is_one_sentence(address, monkeypatch):
    monkeypatch.setattr(executors, "CONNECT_TIMEOUT", "1s")
    with pytest.raises(UserError, match="--dask: got") as caught, executors.dask(address):
        pass
    assert "\n" not in str(caught.value)


@pytest.mark.nightly
def test_a_script_that_workers_cannot_import_is_one_sentence(tmp_path):
    """They are spawned: each imports the script, and would start workers of its own."""
    (tmp_path / "mine.py").write_text(
        "import pcbench\npcbench.run('quick', seeds=2, out='out', dask='local', workers=1)\n"
    )
    done = subprocess.run([sys.executable, "mine.py"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (
        "pcbench.errors.UserError: --dask: the workers did not start, expected a script that runs below" in done.stderr
    )


class Unreadable:
    """What no worker can read: it ends, and the one that is started in its place likewise."""

    def __reduce__(self):
        return fails_in_a_child, ()


def fails_in_a_child():
    if multiprocessing.parent_process() is not None:
        raise ModuleNotFoundError("not here")
    return Unreadable()


def echo(task, hold):
    return task


@pytest.mark.slow
def test_workers_that_end_for_good_end_the_study_in_a_sentence(monkeypatch):
    """It waited for ever."""
    monkeypatch.setattr(executors, "NO_WORKER_TIMEOUT", "3s")
    with executors.dask("local", 1) as execute:
        assert list(execute(echo, [1, 2])) == [1, 2]
        with pytest.raises(UserError, match="all workers have ended and none restarted"):
            list(execute(echo, [Unreadable()]))
