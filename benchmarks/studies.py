"""What a study costs besides its simulation: writing, workers, memory. Ratios within one run; the machine may be shared.

    python benchmarks/studies.py              # a few minutes
    python benchmarks/studies.py --only memory
    python benchmarks/studies.py --only maps --against ../older   # two studies in full, beside an older checkout in turn
    python benchmarks/studies.py --small      # every row and check, a few short runs each: its figures mean nothing then

writing: the time that tasks spend on their files, of the time that all devices have; and what the same tasks take longer
         with files than without, in turn (on a shared machine good to some per cent).
workers: the same study on one and on two local Dask workers, warm; time on one / (2 x time on two). The same of bare
         processes that only simulate, in turn: what the machine gives where both cores are busy.
memory:  peak resident memory of studies with more and more seeds, and with more and more cells, one program each.
maps:    two studies of many cells in full, each in a process of its own: 300 cells of 1000 seeds, and 10,000 of 64; where the
         time goes, and beside another checkout (--against) the ratio of both, in turn. Programs are in the cache by then.

Checked: files or not, workers or not, the same number of runs is done; a study with 256 times the seeds takes less than twice
the memory. Exit code 1 where that does not hold.
"""

import argparse
import json
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import ExitStack, nullcontext
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pcbench import api
from pcbench.dataset import executors, manifest, run_missing, storage, task, timing
from pcbench.engine import runner
from pcbench.runtime import config, provenance
from pcbench.runtime.progress import Progress
from pcbench.scenarios import SCENARIOS
from pcbench.study import parse

STUDY = {"name": "cost", "scenarios": ["cart/white"], "observers": ["pccebo", "kfbo", "kf"]}
FEW = ["pccebo"]  # of a small form: every program is one observer's
MAPS: dict[str, dict[str, Any]] = {
    "300 cells of 1000 seeds": {
        "name": "map",
        "scenarios": ["cart/gaussian"],
        "observers": ["pccebo", "kfbo", "kf"],
        "seeds": 1000,
        "axes": {
            "sampling_period": [0.1, 0.15, 0.2, 0.25, 0.3],
            "delay": [0.1, 0.15, 0.2, 0.25, 0.3],
            "noise_std": [0.1, 0.3, 0.6, 1.0],
            "parameter_drift": [0.0, 0.5, 1.0],
        },
    },
    "10,000 cells of 64 seeds": {
        "name": "map",
        "scenarios": ["cart/gaussian"],
        "observers": ["pccebo", "kfbo", "kf"],
        "seeds": 64,
        "axes": {
            "sampling_period": [0.05 * i for i in range(1, 11)],
            "delay": [0.05 * i for i in range(1, 11)],
            "noise_std": [0.1 * i for i in range(1, 11)],
            "parameter_drift": [0.1 * i for i in range(10)],
        },
    },
}
WRITTEN = {  # a third of a minute on two cores, in the blocks of a minute's study; from the cheapest runs to dear ones
    "cart/white": (200_000, 4096, ["pccebo", "kfbo", "kf"]),
    "csth/10s-noise": (120_000, 4096, ["chain", "equal-delay", "kf"]),
    "arm/sampled": (3_072, 1024, ["smo", "pio", "kf"]),
}


def shortened(scenario: str, observers: list[str]) -> dict[str, Any]:
    """Return a study of a scenario until its first samples have arrived, as small forms have it."""
    measured = SCENARIOS[scenario].sampling
    until = 2 * (max(measured.sampling_period) + max(measured.delay))
    table = {"base": scenario, "duration": until, "steady_start": until / 2}
    return {"name": "cost", "scenario": table, "observers": observers}


def without_files(work: task.Work, one: task.Task, hold: Callable[[], Any]) -> task.Report:
    """Simulate a task's seeds and leave it at that."""
    with hold() as device:
        p, _, made, _ = task.simulate_task(work, one, device)
    cost = timing.Cost(one.runs, {("", 0): made.compile_seconds})
    return task.Report(p.cell.key, cost, provenance.versions(), {})


def timed(study: dict[str, Any], execute: executors.Executor, block: int | None = None) -> tuple[float, float]:
    """Return the seconds in which a study's blocks are filled, planning and statistics left out, and those of writing.

    Exits with a sentence where other runs were done than asked for.
    """
    with tempfile.TemporaryDirectory() as out, config.float64():
        target, began = storage.target(out), []
        owned = manifest.claim(target, parse.grid_of(study, {}, []))
        planned = Progress(begin=lambda what, many: began.append(time.perf_counter()))
        cost = run_missing.run_blocks(
            target, owned, [], execute, run_missing.required_seeds(owned, []), run_missing.Sizes(block), planned
        )
        took, asked = time.perf_counter() - began[0], study["seeds"] * len(study["observers"])
        if cost.runs != asked:
            raise SystemExit(f"studies: got {cost.runs} runs, expected {asked}.")
        return took, cost.writing_seconds


def writing(turns: int, small: bool) -> None:
    """Print what files cost of studies of about a minute."""
    whole = task.compute
    for scenario, (seeds, block, observers) in WRITTEN.items():
        seeds, block, observers = (32, 16, observers[:1]) if small else (seeds, block, observers)
        study = {"name": "cost", "scenarios": [scenario], "observers": observers}
        study = shortened(scenario, observers) if small else study
        with executors.local_executor() as execute:
            timed(study | {"seeds": 16 if small else 2048}, execute)
            longer, share, base = [], [], []
            for _ in range(turns):
                task.compute = without_files
                base.append(timed(study | {"seeds": seeds}, execute, block)[0])
                task.compute = whole
                took, wrote = timed(study | {"seeds": seeds}, execute, block)
                longer.append(took / base[-1] - 1)
                share.append(wrote / (took * len(runner.devices())))
        each = ", ".join(f"{100 * more:+.1f}" for more in longer)
        print(
            f"writing: {scenario}: {100 * statistics.median(share):.2f} % of {base[0]:.0f} s; longer by {each} %",
            flush=True,
        )


def workers(turns: int, small: bool) -> None:
    """Print how much of two workers a study gets, on work that costs more than its files, and what the machine would give."""
    study = {"name": "cost", "scenarios": ["arm/sampled"], "observers": ["smo", "pio"], "seeds": 512 * 8}
    study = shortened("cart/white", FEW) | {"seeds": 32} if small else study
    seconds: dict[str, list[float]] = {}
    with ExitStack() as stack:
        clusters = [stack.enter_context(executors.dask("local", count)) for count in (1, 2)]
        pool = stack.enter_context(ProcessPoolExecutor(2, get_context("spawn"), config.setup))
        ways = {f"{n} bare": partial(bare, pool, study, n) for n in (2, 1)}
        ways |= {f"{n} Dask": partial(timed, study, clusters[n - 1], 512) for n in (2, 1)}
        for turn in range(turns + 1):
            for name, way in ways.items():
                took = way()[0]
                print(f"workers: turn {turn}: {name}: {took:.1f} s", file=sys.stderr, flush=True)
                if turn:  # before, every process made its program
                    seconds.setdefault(name, []).append(took)
    for one, two, per, what in (
        ("1 Dask", "2 Dask", 2, "efficiency of two workers"),
        ("1 bare", "2 bare", 2, "efficiency of two bare processes, the machine's own"),
        ("2 bare", "2 Dask", 1, "two workers do, of what two bare processes do,"),
    ):
        each = list(zip(seconds[one], seconds[two], strict=True))
        turns_ = ", ".join(f"{a:.1f} / {per} x {b:.1f}" for a, b in each)
        print(f"workers: {what} {statistics.median(a / (per * b) for a, b in each):.3f} ({turns_})", flush=True)


def bare(pool: ProcessPoolExecutor, study: dict[str, Any], count: int) -> tuple[float, float]:
    """Return the seconds that so many processes take for a study's runs with neither Dask nor files."""
    each = [pool.submit(timed, study | {"seeds": study["seeds"] // count}, simulating, 512) for _ in range(count)]
    return max(took.result() for took in each)


def simulating(work: partial[Any], tasks: Iterable[task.Task]) -> Iterator[task.Report]:
    """Simulate tasks one after the other, and write nothing."""
    for one in tasks:
        yield partial(without_files, *work.args)(one, nullcontext)


def memory(turns: int, small: bool) -> None:
    """Print the peak memory of studies of several sizes, each in a process of its own."""
    base = shortened("cart/white", FEW) if small else STUDY
    sizes: dict[str, tuple[int, dict[str, Any]]] = {
        f"{many} seeds, 1 cell": (many, {}) for many in ((16,) if small else (1024, 16384, 262144))
    }
    many_cells = (8,) if small else (16, 256)
    sizes |= {f"64 seeds, {n} cells": (64, {"noise_std": [0.01 * (1 + i) for i in range(n)]}) for n in many_cells}
    found = []
    for what, (seeds, axes) in sizes.items():
        code = f"from benchmarks import studies; studies.peak({base | {'seeds': seeds, 'axes': axes}!r})"
        done = subprocess.run(
            [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=Path(__file__).parent.parent
        )
        found.append(int(done.stdout))
        print(f"memory: {what}: peak {found[-1]} MiB", flush=True)
    if max(found) >= 2 * found[0]:
        raise SystemExit(f"studies: got a peak of {max(found)} MiB, expected less than twice {found[0]} MiB.")


def maps(turns: int, small: bool, against: str | None = None) -> None:
    """Print what whole studies take, and where the time goes."""
    here = str(Path(__file__).parent.parent)
    for name, study in list(MAPS.items())[: 1 if small else None]:
        given = shortened("cart/white", FEW) | {"seeds": 16, "axes": {"noise_std": [0.1, 0.2]}} if small else study
        seconds: dict[str, list[float]] = {}
        for turn in range(turns if small else turns + 1):
            for place in (here, against) if against else (here,):
                found = json.loads(_child(f"import map_study; map_study.say({given!r})", place))
                if turn or small:  # before, programs were made
                    seconds.setdefault(place, []).append(found["seconds"])
                    print(f"maps: {name}: {place if against else 'here'}: {_parts(found)}", flush=True)
        if against:
            ratio = statistics.median(a / b for a, b in zip(*seconds.values(), strict=True))
            print(f"maps: {name}: takes {ratio:.3f} of what the other takes", flush=True)


def _parts(found: dict[str, float]) -> str:
    each = ", ".join(
        f"{what.removesuffix('_seconds')} {found[what]:.1f}" for what in found if what.endswith("_seconds")
    )
    rest = f"{found['cpu']:.1f} s of CPU, {found['runs']:,.0f} runs, peak {found['peak_mib']:.0f} MiB"
    return f"{found['seconds']:.1f} s ({each}), {rest}"


def _child(code: str, place: str) -> str:
    """What a process with the checkout of a place says last."""
    paths = os.pathsep.join([place, str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
    environment = os.environ | {"PYTHONPATH": paths}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, env=environment)
    return done.stdout.splitlines()[-1]


def peak(study: dict[str, Any]) -> None:
    """Run a study and print the most memory that this process held."""
    config.setup()
    with tempfile.TemporaryDirectory() as out:
        api.run(study, out=out)
    status = Path(
        "/proc/self/status"
    )  # the most of this program alone; of what started it too, where that is not there
    kib = status.read_text().partition("VmHWM:")[2].split()[0] if status.exists() else resource.getrusage(0).ru_maxrss
    print(f"{float(kib) / 1024:.0f}")


def main() -> None:
    """Print the figures."""
    config.setup()
    parts: dict[str, Callable[[int, bool], None]] = {
        "writing": writing,
        "workers": workers,
        "memory": memory,
        "maps": lambda turns, small: maps(1, small, options.against),
    }
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", choices=parts)
    parser.add_argument("--small", action="store_true", help="a few runs, one turn; every row and check")
    parser.add_argument("--against", metavar="FOLDER", help="another checkout, whose maps are made in turn")
    options = parser.parse_args()
    for name, part in parts.items():
        if options.only in (None, name):
            part(1 if options.small else 3, options.small)


if __name__ == "__main__":
    main()
