"""What built-in studies take: a new user's first run, with empty caches, and the same again. Each run is a process of its own.

    python benchmarks/first_use.py                              # all studies: half an hour on two cores
    python benchmarks/first_use.py quick cart --turns 3
    python benchmarks/first_use.py quick --against ../older     # ratios to another checkout, in turn
    python benchmarks/first_use.py quick --against 746ae6a --at-most 1.2  # a commit; exit code 1 if a ratio is larger
    python benchmarks/first_use.py --small                      # one short study: its figures mean nothing

A row per study: wall seconds and processor seconds of the first run and of the next one, peak memory, how many programs were
compiled for at least 0.3 s, and processor seconds that compiling took. `new-plant` is a linear plant in a TOML file, two
observers, 256 runs; `900000-runs` are three observers with 300,000 runs each.

Ratios to another state are of the least processor seconds of all turns, because other work on the machine only adds to them;
in one turn they differ by up to a quarter for the same code. Checked: the second run compiles nothing, and both do the same
number of runs. Exit code 1 if not.
"""

import argparse
import json
import math
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import NamedTuple

from pcbench.study import builtin

HERE = Path(__file__).resolve().parent.parent
NEW_PLANT = """name = "new-plant"
seeds = 256

[lti]
A = [[0.0, 1.0], [-2.0, -0.6]]
B = [[0.0], [1.5]]
C = [[1.0, 0.0]]
x0 = [1.0, 0.0]
sampling_period = 0.1
delay = 0.2
noise_std = 0.05
observers = ["kf", "pccebo"]
"""
MANY = """name = "900000-runs"
scenarios = ["cart/gaussian"]
observers = ["pccebo", "kfbo", "kf"]
seeds = 300000
"""
SHORT = """name = "short"
seeds = 16
observers = ["pccebo"]

[scenario]
base = "cart/white"
duration = 1.0
steady_start = 0.5
"""
FILES = {"new-plant": NEW_PLANT, "900000-runs": MANY, "short": SHORT}
STUDIES = (*builtin.STUDIES, "new-plant", "900000-runs")


class Took(NamedTuple):
    """What one run took."""

    wall: float  # s
    cpu: float  # s, of all its threads
    peak: float  # MiB
    programs: int  # in the cache after it
    compiling: float  # s, of a processor
    runs: int


def once(study: str, checkout: Path, cache: Path) -> Took:
    """Run a study with the checkout's command line, its results thrown away."""
    environment = os.environ | {"PCBENCH_CACHE": str(cache), "PYTHONPATH": str(checkout)}
    for name in ("JAX_COMPILATION_CACHE_DIR", "PYTHONDONTWRITEBYTECODE"):  # an installed package has its bytecode
        environment.pop(name, None)
    with tempfile.TemporaryDirectory() as place:
        name = study
        if study in FILES:
            name = str(Path(place) / f"{study}.toml")
            Path(name).write_text(FILES[study])
        words = [sys.executable, "-m", "pcbench", "run", name, "--out", f"{place}/out", "--quiet"]
        start = time.perf_counter()
        process = subprocess.Popen(words, cwd=place, env=environment, stdout=subprocess.DEVNULL)
        _, status, usage = os.wait4(process.pid, 0)
        wall = time.perf_counter() - start
        if status:
            raise SystemExit(f"first_use: pcbench run {study} ended with {os.waitstatus_to_exitcode(status)}.")
        record = json.loads((Path(place) / "out" / "provenance.json").read_text())
    programs = len(list((cache / "programs").glob("*-cache")))
    cpu, peak = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024
    return Took(wall, cpu, peak, programs, record.get("compile_seconds", 0.0), record["runs_added"])


def first_and_again(study: str, checkout: Path) -> tuple[Took, Took]:
    """Run a study with empty caches, and again; raise SystemExit if the second run compiles, or does other runs."""
    with tempfile.TemporaryDirectory() as place:
        first, again = (once(study, checkout, Path(place)) for _ in range(2))
    # programs that compile in about 0.3 s are kept in the cache or not, by chance
    if first.runs != again.runs or again.compiling > 1 + 0.5 * first.compiling:
        raise SystemExit(
            f"first_use: {study}: got {again.runs} runs and {again.compiling:.1f} s of compiling the second time, expected "
            f"{first.runs} and none."
        )
    return first, again


@contextmanager
def checkout_of(state: str) -> Iterator[Path]:
    """Give the folder of another checkout, or a checkout of that commit for as long as it is needed."""
    if Path(state).is_dir():
        yield Path(state).resolve()
        return
    with tempfile.TemporaryDirectory() as place:
        git = ["git", "-C", str(HERE), "worktree"]
        if subprocess.run([*git, "add", "--quiet", "--detach", f"{place}/commit", state], check=False).returncode:
            raise SystemExit(f"first_use: {state} is not a folder and not a commit of this repository.")
        try:
            yield Path(place) / "commit"
        finally:
            subprocess.run([*git, "remove", "--force", f"{place}/commit"], check=True)


def compare(study: str, here: list[tuple[Took, Took]], there: list[tuple[Took, Took]]) -> float:
    """Print how the processor seconds of two checkouts compare; return the larger ratio, that of the first run or the next."""
    ratios = [min(run[i].cpu for run in here) / min(run[i].cpu for run in there) for i in (0, 1)]
    print(f"{study}: {ratios[0]:.3f} of the other's processor seconds first, {ratios[1]:.3f} again", flush=True)
    return max(ratios)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("studies", nargs="*", help="names of built-in studies [default: all of them]")
    parser.add_argument("--turns", type=int, default=1, help="how often; medians are printed [default: 1]")
    parser.add_argument("--against", metavar="STATE", help="folder of another checkout, or a commit, run in turn")
    parser.add_argument("--at-most", type=float, default=math.inf, metavar="RATIO", help="exit code 1 above it")
    parser.add_argument("--small", action="store_true", help="one short study")
    given = parser.parse_args()
    print("study: first, again [s] (processor s); peak [MiB]; programs, compiling [s]", flush=True)
    with checkout_of(given.against) if given.against else nullcontext() as other:
        slower = []
        for study in ["short"] if given.small else given.studies or STUDIES:
            took: dict[Path, list[tuple[Took, Took]]] = {place: [] for place in (HERE, other) if place}
            for turn in range(given.turns):
                for place in sorted(took, key=list(took).index, reverse=turn % 2 == 1):
                    took[place].append(first_and_again(study, place))
            for place, turns in took.items():
                first, again = (
                    Took(*map(statistics.median, zip(*run, strict=True))) for run in zip(*turns, strict=True)
                )
                print(
                    f"{study}{f' in {place}' if other else ''}: {first.wall:.1f}, {again.wall:.1f} "
                    f"({first.cpu:.1f}, {again.cpu:.1f}); {max(first.peak, again.peak):.0f}; "
                    f"{first.programs:.0f}, {first.compiling:.1f}",
                    flush=True,
                )
            if other and compare(study, took[HERE], took[other]) > given.at_most:
                slower.append(study)
    if slower:
        raise SystemExit(
            f"first_use: more than {given.at_most:g} times the processor seconds of {given.against}: {slower}."
        )


if __name__ == "__main__":
    main()
