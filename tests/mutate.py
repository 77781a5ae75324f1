"""Break the package at random places and see the tests fail: `python tests/mutate.py pcbench/simulation --sample 40`.

cosmic-ray makes the mutants, each one change of an operator, a number, a comparison or a loop. A sample of them is tried: the
change is made in a copy of the package, and the tests of the module's folder are run on that copy until one fails. Before that
they all must pass on a copy without a change. What survives is printed as a difference, and the score last: the share of
mutants on which a test fails, with its 95 % interval (Wilson). Exit code 1 where the score is below `--least`.
"""

import argparse
import difflib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import NamedTuple

from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
LONGER = 5  # times as long as the tests take without a change: beyond, a mutant never ends, which is a failure
# no mutants of types (X | None), of decorators, of exceptions' classes, and none that cosmic-ray needs words for
WITHOUT = ("BitOr", "RemoveDecorator", "ExceptionReplacer", "NoOp", "VariableReplacer", "VariableInserter")
MORE = {  # folders with tests that are about a folder of the package, besides its own
    "simulation": ("invariants", "observers"),
    "engine": ("simulation", "invariants"),
    "observers": ("invariants", "plants"),
    "dynamics": ("plants", "observers"),
    "statistics": ("limits",),
}


RUNNING: set["subprocess.Popen[bytes]"] = set()  # which Ctrl-C ends


class Mutant(NamedTuple):
    """One place of the package, changed."""

    file: Path  # below the repository
    operator: str
    occurrence: int
    line: int

    @property
    def title(self) -> str:
        """Return where it is and what is changed."""
        return f"{self.file}:{self.line} {self.operator.split('/')[-1]}"

    def text(self) -> str:
        """Return the file's text with the change in it."""
        changed = mutate_code(
            (ROOT / self.file).read_text(encoding="utf-8"), get_operator(self.operator)(), self.occurrence
        )
        return str(changed)

    def difference(self) -> str:
        """Return what is changed."""
        old = (ROOT / self.file).read_text(encoding="utf-8").splitlines()
        lines = difflib.unified_diff(old, self.text().splitlines(), n=0, lineterm="")
        return "\n".join(line for line in lines if line[:1] in "+-" and line[:3] not in ("+++", "---"))


def mutants(file: Path) -> Iterator[Mutant]:
    """Yield all mutants of a file."""
    tree = get_ast((ROOT / file).read_text(encoding="utf-8"))
    for name in operator_names():
        operator = get_operator(name)
        if any(word in name for word in WITHOUT) or operator.arguments():
            continue
        positions = (start for node in ast_nodes(tree) for start, _ in operator().mutation_positions(node))
        for i, (line, _) in enumerate(positions):
            yield Mutant(file, name, i, line)


def tests_of(file: Path) -> list[str]:
    """Return the test files that are about a file's folder; first those that name the file most often, such as kf-larsen."""
    folder = file.parts[1] if len(file.parts) > 2 else "house"
    found = [test for each in (folder, *MORE.get(folder, ())) for test in sorted((TESTS / each).rglob("test_*.py"))]
    names = {file.stem, file.stem.replace("_", "-")}
    texts = {test: test.read_text(encoding="utf-8") for test in found}
    found.sort(key=lambda test: -sum(texts[test].count(name) for name in names))
    return [str(test.relative_to(TESTS)) for test in found]


def pytest(place: Path, tests: list[str], marks: str, longest: float | None) -> int:
    """Run tests on the copy of the package in a folder; return pytest's exit code, 1 where they take too long [s]."""
    words = ["-m", "pytest", f"--rootdir={ROOT}", "-c", str(ROOT / "pyproject.toml"), "-x", "-q", "-n", "0"]
    words += ["-p", "no:cacheprovider", "--hypothesis-seed=0"]
    words += ["-m", marks, *(str(TESTS / test) for test in tests)]
    env = os.environ | {"PYTHONPATH": str(place), "PCBENCH_CACHE": str(place / "cache")}
    (place / "cache").mkdir(mode=0o700)
    quiet = subprocess.DEVNULL
    process = subprocess.Popen(
        [sys.executable, *words], cwd=place, env=env, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True
    )
    RUNNING.add(process)
    try:
        return process.wait(timeout=longest)
    except subprocess.TimeoutExpired:
        return 1
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
        RUNNING.discard(process)


def attempt(
    folder: Path, tests: list[str], marks: str, m: Mutant | None, longest: float | None = None
) -> tuple[Mutant | None, bool, float]:
    """Return a mutant, whether a test fails on it, and how long that took [s]; None: the package as it is."""
    start, place = perf_counter(), Path(tempfile.mkdtemp(dir=folder))
    shutil.copytree(ROOT / "pcbench", place / "pcbench", ignore=shutil.ignore_patterns("__pycache__"))
    if m:
        (place / m.file).write_text(m.text(), encoding="utf-8")
    failed = pytest(place, tests, marks, longest) != 0
    shutil.rmtree(place, ignore_errors=True)
    return m, failed, perf_counter() - start


def interval(caught: int, many: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson)."""
    z, p = 1.96, caught / many
    middle, half = p + z * z / (2 * many), z * (p * (1 - p) / many + z * z / (4 * many**2)) ** 0.5
    return (middle - half) / (1 + z * z / many), (middle + half) / (1 + z * z / many)


def files_of(given: list[str], since: str | None) -> list[Path]:
    """Return the files of the package that are named, or that have changed since a commit."""
    if since:
        words = ["git", "-C", str(ROOT), "diff", "--name-only", "--diff-filter=d", since, "--", *(given or ["pcbench"])]
        done = subprocess.run(words, capture_output=True, text=True)
        if done.returncode:
            raise SystemExit(f"mutate.py: --since {since}: {done.stderr.splitlines()[0]}")
        return [Path(name) for name in done.stdout.split() if name.startswith("pcbench/") and name.endswith(".py")]
    places = [ROOT / each for each in given]
    for place in places:
        if not (place.exists() and place.is_relative_to(ROOT / "pcbench")):
            raise SystemExit(
                f"mutate.py: {place}: no file or folder of the package; name one, such as pcbench/simulation."
            )
    found = [file for place in places for file in ([place] if place.is_file() else sorted(place.rglob("*.py")))]
    return [file.relative_to(ROOT) for file in found]


def main() -> int:
    """Try a sample of mutants; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("where", nargs="*", help="files or folders of the package, from the repository on")
    parser.add_argument("--since", metavar="COMMIT", help="only files that have changed since a commit")
    parser.add_argument("--sample", type=int, default=40, help="how many mutants to try [default: 40]")
    parser.add_argument("--seed", type=int, default=0, help="which ones [default: 0]")
    parser.add_argument("--jobs", type=int, default=2, help="how many at a time [default: 2]")
    parser.add_argument("--tests", action="append", help="tests to run instead of those of the folder (repeatable)")
    parser.add_argument("--quick", action="store_true", help="only the tests of a plain `pytest`: never a higher score")
    parser.add_argument("--least", type=float, default=0.0, help="score below which the exit code is 1 [default: 0]")
    given = parser.parse_args()
    every = [m for file in files_of(given.where, given.since) for m in mutants(file)]
    if not every:
        parser.error(
            "there is nothing to change; name files or folders such as pcbench/simulation, or a commit with --since"
        )
    if min(given.sample, given.jobs) < 1:
        parser.error("--sample and --jobs: expected at least 1")
    some = random.Random(given.seed).sample(every, min(given.sample, len(every)))
    caught = 0
    with tempfile.TemporaryDirectory(prefix="pcbench-mutants-", ignore_cleanup_errors=True) as name:
        tests = given.tests or sorted({test for m in some for test in tests_of(m.file)})
        marks = "not slow and not ci" if given.quick else "not slow"
        _, failed, seconds = attempt(Path(name), tests, marks, None)
        if failed:
            print(f"The tests do not pass without any change: {' '.join(tests)}", file=sys.stderr)
            return 1
        pool = ThreadPoolExecutor(given.jobs)
        print(f"without a change: {seconds:.0f} s for {len(tests)} files or folders of tests", flush=True)
        longest = LONGER * max(seconds, 60)
        waiting = [pool.submit(attempt, Path(name), given.tests or tests_of(m.file), marks, m, longest) for m in some]
        try:
            for done, future in enumerate(as_completed(waiting), 1):
                m, failed, seconds = future.result()
                caught += failed
                outcome = "caught  " if failed else "SURVIVED"
                print(f"{done:4}/{len(some)} {outcome} {seconds:6.1f} s  {m.title}", flush=True)
                if not failed:
                    print(m.difference(), flush=True)
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list(RUNNING):
                with suppress(ProcessLookupError):
                    os.killpg(process.pid, signal.SIGKILL)
            return 130
    low, high = interval(caught, len(some))
    share = f"{caught / len(some):.0%}, 95 % interval {low:.0%} to {high:.0%}"
    print(f"{caught} of {len(some)} mutants caught, of {len(every)} that there are: {share}")
    return int(caught / len(some) < given.least)


if __name__ == "__main__":
    sys.exit(main())
