"""An observer of a user's file beside the same one built in: speed in one process, and under Dask workers without the file.

    python benchmarks/own_code.py              # some ten minutes
    python benchmarks/own_code.py --only here
    python benchmarks/own_code.py --small      # every row and check, few runs and pairs: its figures mean nothing then

The user's file is a copy of pcbench/observers/kf.py in a folder that is removed once the study is read: from there on its code
is what travels. Both run the same study (cart/white), in pairs that alternate, A B B A: the machine's drift meets both alike.

here:    calls of 1024 runs each, the programs compiled and warm
workers: a study's blocks filled by two local Dask workers, planning and statistics left out, after both have made both programs

Seconds on the clock, and those that the processors worked for it: on a machine that others use the latter say more.

Printed: the ratio of the medians, the user's over the built-in one, and the median of the ratios within a pair; each with its
95 % interval (bootstrap over the pairs).
Checked: both leave the same bits; both workers have worked, and no file was there. Exit code 1 where that does not hold, or,
but for --small, where the last interval of the processors' seconds lies outside 3 % of 1 as a whole.
"""

import argparse
import shutil
import tempfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any, NamedTuple

import jax
import numpy as np
import psutil
from numpy.typing import NDArray

from pcbench import planning
from pcbench.dataset import block_files, executors, manifest, run_missing, storage
from pcbench.engine import runner
from pcbench.observers import kf
from pcbench.planning import padding
from pcbench.runtime import config
from pcbench.runtime.progress import Progress
from pcbench.study import parse
from pcbench.study.grid import Grid

ALIKE = 0.03  # that the ratio may be off 1
LANES, SEEDS, PAIRS = 1024, 8192, {"here": 400, "workers": 150}
FEW = {"duration": 0.5, "steady_start": 0.2}  # s, with --small
CLOCKS = ("on the clock", "of processors")  # what a turn's seconds are


class Turn(NamedTuple):
    """What one turn left, the same for both, and what it took."""

    left: Any
    seconds: tuple[float, float]  # as CLOCKS says


Way = Callable[[], Turn]
Pairs = NDArray[np.float64]  # [pairs, 2] s: built in, the user's


class Both(NamedTuple):
    """One study twice: with the observer built in, and with the copy of its file, which is not there any more."""

    built_in: Grid
    own: Grid


def studies(seeds: int, small: bool) -> Both:
    """Return the study with either observer."""
    raw = {"name": "own-code", "scenario": {"base": "cart/white", **(FEW if small else {})}, "seeds": seeds}
    with tempfile.TemporaryDirectory() as folder:
        shutil.copy(kf.__file__, Path(folder) / "copied.py")
        own = {"copied": {"use": f"{folder}/copied.py:OBSERVER"}}
        return Both(parse.grid_of(raw | {"observers": ["kf"]}, {}, []), parse.grid_of(raw | {"observers": own}, {}, []))


def alternating(what: str, a: Way, b: Way, many: int) -> NDArray[np.float64]:
    """Return what every turn took, [clocks, pairs, 2], A B, then B A, and so on; exit where they leave other bits."""
    alike(what, a().left, b().left)
    took = []
    for pair in range(many):
        first, second = (a, b) if pair % 2 == 0 else (b, a)
        turns = [first().seconds, second().seconds]
        took.append(turns if pair % 2 == 0 else turns[::-1])
    return np.moveaxis(np.array(took), -1, 0)


def ratio(pairs: Pairs) -> tuple[float, float, float]:
    """Return the ratio of the medians, the user's over the built-in one, and the ends of its interval."""
    drawn = np.random.default_rng(0).integers(0, len(pairs), (4000, len(pairs)))
    each = np.median(pairs[drawn], 1)
    low, high = np.quantile(each[:, 1] / each[:, 0], [0.025, 0.975])
    whole = np.median(pairs, 0)
    return float(whole[1] / whole[0]), float(low), float(high)


def within(pairs: Pairs) -> tuple[float, float, float]:
    """Return the median of the pairs' own ratios, and the ends of its interval."""
    return ratio(np.stack([np.ones(len(pairs)), pairs[:, 1] / pairs[:, 0]], 1))


def said(what: str, took: NDArray[np.float64], small: bool) -> None:
    """Print the ratios by each clock; exit with a sentence where that of processors is surely not 1 to 3 %."""
    for clock, pairs in zip(CLOCKS, took, strict=True):
        words = [f"{middle:.3f} ({low:.3f} .. {high:.3f})" for middle, low, high in (ratio(pairs), within(pairs))]
        a, b = np.median(pairs, 0)
        print(
            f"{what}, {clock}: {b:.3f} s / {a:.3f} s = {words[0]}; within a pair {words[1]}; {len(pairs)} pairs",
            flush=True,
        )
    _, low, high = within(took[-1])
    if not small and (low > 1 + ALIKE or high < 1 - ALIKE):
        raise SystemExit(f"own_code: {what}: got a ratio of {low:.3f} .. {high:.3f}, expected 1 within {ALIKE:g}.")


def alike(what: str, a: Any, b: Any) -> None:
    """Exit with a sentence where two results are not the same bits."""
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    if not all(np.asarray(x).tobytes() == np.asarray(y).tobytes() for x, y in pairs):
        raise SystemExit(f"own_code: {what}: got other bits of the user's file, expected those of the built-in one.")


def here(both: Both, pairs: int, small: bool) -> None:
    """Print the ratios of calls in this process."""
    said("here", alternating("here", *(calling(grid) for grid in both), pairs), small)


def calling(grid: Grid) -> Way:
    """Return what simulates one call of a study's runs on one thread, its program compiled and warm."""
    (p,) = padding.fit(list(planning.drafts(grid.cells)))
    job = runner.Job(p.problem, 0, np.arange(LANES))
    made = runner.program(p.layout, job)

    def way() -> Turn:
        wall, cpu = perf_counter(), process_time()
        _, left = next(runner.serial(made, [job]))
        return Turn(left, (perf_counter() - wall, process_time() - cpu))

    return way


def workers(both: Both, pairs: int, small: bool) -> None:
    """Print the ratios of a study filled by two workers, which have no file of the user's."""
    with executors.dask("local", 2) as execute:
        said("workers", alternating("workers", *(partial(filled, grid, execute) for grid in both), pairs), small)


def filled(grid: Grid, execute: executors.Executor) -> Turn:
    """Fill a study's blocks; the time is from the first task on. Exit with a sentence where one of two workers did nothing."""
    began: list[float] = []
    planned = Progress(begin=lambda what, many: began.extend((perf_counter(), of_workers())))
    with tempfile.TemporaryDirectory() as out:
        target = storage.target(out)
        owned = manifest.claim(target, grid)
        cost = run_missing.run_blocks(
            target, owned, [], execute, run_missing.required_seeds(owned, []), run_missing.Sizes(LANES), planned
        )
        took = perf_counter() - began[0], of_workers() - began[1]
        if (busy := len({name for name, _ in cost.compiled})) != 2:
            raise SystemExit(f"own_code: got {busy} workers that worked, expected 2.")
        tables = [block_files.read_block(target, block) for block in block_files.present(target)]
        return Turn([[c.to_numpy() for c in table.columns if c.type == "double"] for table in tables], took)


def of_workers() -> float:
    """Return the seconds that the processes below this one have computed."""
    each = [child.cpu_times() for child in psutil.Process().children(recursive=True)]
    return float(sum(times.user + times.system for times in each))


def main() -> None:
    """Parse, check, time, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=PAIRS, help="here or workers; default both")
    parser.add_argument("--pairs", type=int, help="of turns [default: 400 here, 100 with workers]")
    parser.add_argument("--small", action="store_true", help="half a second, few runs and pairs; every row and check")
    options = parser.parse_args()
    config.setup()
    with config.float64():
        for name in [options.only] if options.only else PAIRS:
            seeds = 4 * LANES if options.small else SEEDS
            pairs = options.pairs or (2 if options.small else PAIRS[name])
            {"here": here, "workers": workers}[name](studies(seeds, options.small), pairs, options.small)


if __name__ == "__main__":
    main()
