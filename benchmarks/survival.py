"""Kill a study again and again while others read it: is what stands in the end what an undisturbed run leaves?

    python benchmarks/survival.py --kills 100 [--dask] [--small]

A study is started, killed with SIGKILL at a random moment, and started again in the same folder until it ends by itself; then
its files are compared, byte for byte, with those of a run that nobody disturbed; and so on until there were so many kills.
With --small the study has one observer, an eighth of the seeds, a tenth of the ticks, and is killed twice, each time when it
has written one to four blocks.
Meanwhile a reader polls the folder with pyarrow, DuckDB
and Polars: whatever it sees must be whole blocks, no row twice.
"""

import argparse
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import duckdb
import polars as pl
import pyarrow.dataset as ds

STUDY = ["cart/white", "--observers", "pccebo,kfbo,kf", "--set", "axes.noise_std=[0.1, 0.2, 0.4]"]
ROWS = 64 * 2  # of a block: seeds x signals
SEEDS = ["--seeds", "2048"]
SHORT = ["--seeds", "256", "--observers", "kfbo"]  # and each run a tenth as long
SHORT += [
    "--set",
    'scenario={base="cart/white", name="short", duration=1.0, steady_start=0.5}',
    "--set",
    'scenarios=["short"]',
]


def command(out: Path, extra: list[str]) -> list[str]:
    """Return the command line of the study."""
    return [sys.executable, "-m", "pcbench", "run", *STUDY, "--block-size", "64", "--out", str(out), "--quiet", *extra]


def files(out: Path) -> dict[str, bytes]:
    """Return a folder's tables by name."""
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*.parquet"))}


def tables(out: Path) -> int:
    """Return how many tables a folder has."""
    return sum(1 for _ in out.rglob("*.parquet"))


def poll(out: Path, stop: threading.Event, seen: Counter[str]) -> None:
    """Read the runs with three libraries until told to stop; count reads, and what was wrong."""
    while not stop.is_set():
        for name, read in READERS.items():
            if not any(out.rglob("*.parquet")):
                continue
            try:
                rows, apart = read(out)
                seen[name] += 1
                seen[f"{name}: part of a block"] += rows % ROWS != 0
                seen[f"{name}: a row twice"] += rows != apart
            except Exception as error:
                seen[f"{name}: {type(error).__name__}: {error}"[:300]] += 1
        time.sleep(0.05)


def with_pyarrow(out: Path) -> tuple[int, int]:
    """Return the rows, and how many differ in their key."""
    t = ds.dataset(out / "runs", partitioning="hive").to_table(["scenario", "observer", "cell", "seed", "signal"])
    return len(t), t.group_by(t.schema.names).aggregate([]).num_rows


def with_duckdb(out: Path) -> tuple[int, int]:
    """The same with DuckDB."""
    found = duckdb.sql(
        "select count(*), count(distinct (scenario, observer, cell, seed, signal)) "
        f"from read_parquet('{out}/runs/**/*.parquet', hive_partitioning=true)"
    ).fetchall()
    return found[0][0], found[0][1]


def with_polars(out: Path) -> tuple[int, int]:
    """The same with Polars."""
    t = pl.read_parquet(out / "runs", columns=["scenario", "observer", "cell", "seed", "signal"])
    return t.height, t.unique().height


READERS = {"pyarrow": with_pyarrow, "duckdb": with_duckdb, "polars": with_polars}


def runs_still(process: subprocess.Popen[bytes], out: Path, longest: float | None, draw: random.Random) -> bool:
    """Wait for a random moment, or without `longest` for some more tables; return whether the process has not ended before."""
    if longest is not None:
        with suppress(subprocess.TimeoutExpired):
            process.wait(draw.uniform(0, longest))
        return process.poll() is None
    enough = tables(out) + draw.randint(1, 4)
    while process.poll() is None and tables(out) < enough:
        time.sleep(0.01)
    return process.poll() is None


def disturbed(out: Path, longest: float | None, most: int, extra: list[str], draw: random.Random) -> int:
    """Run the study to its end under kills; return how many there were, `most` at most."""
    kills = 0
    while True:
        process = subprocess.Popen(command(out, extra), start_new_session=True, stdout=subprocess.DEVNULL)
        if kills < most and runs_still(process, out, longest, draw):
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()
            kills += 1
            continue
        if code := process.wait():
            raise SystemExit(f"survival: the study ended with {code}, expected 0.")
        return kills


def main() -> None:
    """Kill, resume, compare; exit 1 where anything differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=None, help="default 100, or 2 of a small study")
    parser.add_argument("--small", action="store_true", help="fewer and shorter runs, fewer kills; every check")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--dask", action="store_true", help="run on two local Dask workers")
    options = parser.parse_args()
    most = options.kills or (2 if options.small else 100)
    extra = [*(SHORT if options.small else SEEDS), *(["--dask", "local", "--workers", "2"] if options.dask else [])]
    draw, seen, kills, rounds = random.Random(options.seed), Counter[str](), 0, 0
    with tempfile.TemporaryDirectory() as folder:
        for name in ("whole",) if options.small else ("warm", "whole"):  # compiled programs are kept
            start = time.perf_counter()
            subprocess.run(command(Path(folder) / name, extra), check=True, stdout=subprocess.DEVNULL)
        alone = time.perf_counter() - start
        want = files(Path(folder) / "whole")
        print(f"undisturbed: {alone:.1f} s, {len(want)} tables", flush=True)
        while kills < most:
            out, stop = Path(folder) / f"killed-{rounds}", threading.Event()
            out.mkdir()
            reader = threading.Thread(target=poll, args=(out, stop, seen))
            reader.start()
            kills += disturbed(out, None if options.small else alone, most - kills, extra, draw)
            stop.set()
            reader.join()
            got, rounds = files(out), rounds + 1
            left = [p.name for p in out.rglob("*") if p.is_file() and str(p.relative_to(out)) not in got]
            if got != want or set(left) != {"study.toml", "provenance.json"}:
                raise SystemExit(f"survival: after {kills} kills {sorted(set(got) ^ set(want))} {left} differ.")
            print(f"{kills} kills, {rounds} studies ended, each byte for byte as undisturbed", flush=True)
    for what, many in sorted(seen.items()):
        print(f"reader, {what}: {many}")
    wrong = sum(many for what, many in seen.items() if ":" in what)  # reads are counted under the library's name alone
    raise SystemExit(1 if wrong else 0)


if __name__ == "__main__":
    main()
