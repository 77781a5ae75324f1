"""Break the code on purpose, one line at a time, and see the tests fail: `python tests/mutate.py`.

`mutations.toml` beside this file lists what to break and which tests are about it. For each of them a copy of the package is
changed, never the checkout, and the tests are run on that copy until one fails. Before that they all must pass on a copy that
is not changed. Exit code 1 where a mutation survives that is not explained, or one that cannot be tried.

Programs that were compiled and gains that were solved are kept for all copies: a program is known by its own text and gains by
the problem's bits and the text that states it; where `synthesis` itself is changed, gains are solved anew.
"""

import argparse
import os
import resource
import shutil
import signal
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import suppress
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
LONGEST = 300  # s: tests that take longer under a mutation never end
LARGEST = 8 * 2**30  # bytes of a process: a loop that never ends may fill the memory first
PASSED, FAILED = 0, 1  # what pytest returns where all tests pass, and where some fail


class Mutation(NamedTuple):
    """One line broken on purpose."""

    file: str  # below pcbench/
    old: str  # stands there once
    new: str
    tests: tuple[str, ...]  # below tests/: FILE, or FILE::TEST
    why: str  # what is wrong then
    harmless: str = ""  # why no test can fail; empty: one must

    @property
    def title(self) -> str:
        """Return where it is and what is wrong."""
        return f"{self.file}: {self.why}"


class Tried(NamedTuple):
    """What came of a mutation."""

    mutation: Mutation
    outcome: str
    seconds: float
    said: str = ""  # pytest's last words

    @property
    def fine(self) -> bool:
        """Return whether a test has failed that should, or none can."""
        return self.outcome in ("caught", "explained")


def listed() -> list[Mutation]:
    """Return the list beside this file."""
    raw = tomllib.loads((TESTS / "mutations.toml").read_text(encoding="utf-8"))
    return [Mutation(**{**each, "tests": tuple(each["tests"])}) for each in raw["mutation"]]


def mutated(m: Mutation, text: str) -> str:
    """Return a file's text with the mutation in it; raise ValueError where that has no one place."""
    if text.count(m.old) != 1:
        raise ValueError(f"{m.title}: {m.old!r} stands there {text.count(m.old)} times, expected once")
    return text.replace(m.old, m.new)


class Workshop:
    """A folder for copies of the package, and what they share."""

    def __init__(self, folder: str) -> None:
        self.folder, self.running, self.stopped = Path(folder), set[subprocess.Popen[str]](), False
        for shared in ("programs", "gains"):
            (self.folder / shared).mkdir()

    def copy(self, name: str, m: Mutation | None = None) -> Path:
        """Make a copy of the package, with a mutation in it; return the folder it is in."""
        place = self.folder / name
        shutil.copytree(ROOT / "pcbench", place / "pcbench")
        if m:
            path = place / "pcbench" / m.file
            path.write_text(mutated(m, path.read_text(encoding="utf-8")), encoding="utf-8")
            for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
                compiled.unlink()
        cache = place / f"pcbench-tests-{os.getuid()}-{os.getpid()}"  # where conftest.py looks for it
        cache.mkdir()
        for shared in ("programs", "gains"):
            if shared == "programs" or not (m and m.file.startswith("synthesis/")):
                (cache / shared).symlink_to(self.folder / shared)
        return place

    def pytest(self, place: Path, tests: Iterable[str], *how: str, longest: float = LONGEST) -> tuple[int, str]:
        """Run tests on a copy, of whole files those that are not slow; return what pytest returns and says."""
        tests = list(tests)
        which = "not slow or slow" if all("::" in test for test in tests) else "not slow"
        given = ["-m", "pytest", f"--rootdir={ROOT}", "-c", str(ROOT / "pyproject.toml"), *how]
        given += ["-q", "-n", "0", "-m", which, "-p", "no:cacheprovider", "--hypothesis-seed=0", "--durations=0"]
        return self.python(place, *given, *(str(TESTS / test) for test in tests), longest=longest)

    def python(self, place: Path, *words: str, longest: float = LONGEST) -> tuple[int, str]:
        """Run Python where a copy is the package that is imported; return its exit code and what it says."""
        env = os.environ | {"PYTHONPATH": str(place), "TMPDIR": str(place)}
        process = subprocess.Popen(
            [sys.executable, *words], cwd=place, env=env, text=True, start_new_session=True,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )  # fmt: skip
        self.running.add(process)
        if hasattr(resource, "prlimit"):
            resource.prlimit(process.pid, resource.RLIMIT_DATA, (LARGEST, LARGEST))
        try:
            said, _ = process.communicate(timeout=longest)
            return process.returncode, said
        except subprocess.TimeoutExpired:
            self.end(process)
            return FAILED, f"never ends (after {longest:g} s)"
        finally:
            self.running.discard(process)

    def end(self, process: subprocess.Popen[str]) -> None:
        """End a process and all that it has started."""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def stop(self) -> None:
        """End whatever runs, and start no more."""
        self.stopped = True
        for process in list(self.running):
            self.end(process)

    def attempt(self, number: int, m: Mutation) -> Tried:
        """Try one mutation."""
        start = perf_counter()
        if self.stopped:
            return Tried(m, "not tried", 0.0)
        place = self.copy(f"mutation-{number}", m)
        code, said = self.pytest(place, m.tests, "-x")
        shutil.rmtree(place, ignore_errors=True)
        outcome = {PASSED: "explained" if m.harmless else "SURVIVED", FAILED: "caught"}.get(code, "BROKEN")
        return Tried(m, outcome, perf_counter() - start, "\n".join(said.splitlines()[-25:]))

    def unbroken(self, tests: Iterable[str]) -> str:
        """Return what is wrong with the tests on a copy that is not changed; empty: nothing."""
        place = self.copy("unbroken")
        _, found = self.python(place, "-c", "import pcbench; print(pcbench.__file__)")
        if Path(found.strip()) != place / "pcbench" / "__init__.py":
            return f"the package that is imported is {found}, expected the copy"
        tests = list(tests)
        code, said = self.pytest(place, tests, longest=LONGEST * max(len(tests), 1))  # all of them in one go
        return "" if code == PASSED else said


def tried(shop: Workshop, mutations: list[Mutation], jobs: int) -> Iterator[Tried]:
    """Try mutations, some at a time, and yield them as they are done."""
    with ThreadPoolExecutor(jobs) as pool:
        waiting = [pool.submit(shop.attempt, i, m) for i, m in enumerate(mutations)]
        try:
            for done in as_completed(waiting):
                yield done.result()
        except BaseException:
            shop.stop()
            raise


def chosen(only: str) -> list[Mutation]:
    """Return the mutations whose file, words, texts or tests have `only` in them."""
    return [m for m in listed() if only in " ".join((m.title, m.old, m.new, *m.tests))]


def show(mutations: list[Mutation], console: Any) -> None:
    """Print what would be tried."""
    for m in mutations:
        console.print(f"{m.title}{' (harmless)' if m.harmless else ''}", markup=False, highlight=False)
        for sign, text in (("-", m.old), ("+", m.new)):
            for line in text.splitlines():
                console.print(f"    {sign} {line}", markup=False, highlight=False)
    console.print(f"{len(mutations)} mutations", highlight=False)


def run(mutations: list[Mutation], jobs: int, console: Any) -> int:
    """Try mutations, say what comes of each, and return the exit code."""
    from rich.progress import MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    columns = TextColumn("{task.description}"), MofNCompleteColumn(), TimeElapsedColumn()
    done: list[Tried] = []
    with tempfile.TemporaryDirectory(prefix="pcbench-mutations-", ignore_cleanup_errors=True) as folder:
        shop = Workshop(folder)
        with Progress(*columns, console=console, transient=True) as progress:
            bar = progress.add_task("the tests without mutations", total=len(mutations))
            try:
                if wrong := shop.unbroken(dict.fromkeys(test for m in mutations for test in m.tests)):
                    console.print(wrong, "The tests do not pass without any mutation.", sep="\n", markup=False)
                    return 1
                for each in tried(shop, mutations, jobs):
                    done.append(each)
                    console.print(
                        f"{each.outcome:9} {each.seconds:5.1f} s  {each.mutation.title}", markup=False, highlight=False
                    )
                    if each.outcome == "BROKEN":
                        console.print(each.said, markup=False, highlight=False)
                    progress.update(bar, advance=1, description="mutations")
            except KeyboardInterrupt:
                shop.stop()
                progress.stop()
                console.print(f"Stopped; {len(done)} of {len(mutations)} mutations were tried.", highlight=False)
                return 130
    many = {name: sum(t.outcome == name for t in done) for name in ("caught", "explained", "SURVIVED", "BROKEN")}
    console.print(f"{len(done)} mutations: " + ", ".join(f"{n} {name}" for name, n in many.items()), highlight=False)
    return 0 if all(t.fine for t in done) else 1


def main() -> int:
    from rich.console import Console

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", metavar="SUBSTRING", help="only where this stands in file, text or tests")
    parser.add_argument("--list", action="store_true", help="show the mutations and try none")
    parser.add_argument("--jobs", type=int, default=1, help="how many to try at a time [default: 1]")
    given = parser.parse_args()
    console = Console(soft_wrap=True)
    mutations = chosen(given.only)
    if given.list:
        show(mutations, console)
        return 0
    return run(mutations, max(given.jobs, 1), console)


if __name__ == "__main__":
    sys.exit(main())
