"""Bars for long work, on standard error, where that is a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text


class Rate(ProgressColumn):
    """Runs a second."""

    def render(self, task: Any) -> Text:
        """Show the task's speed in runs a second."""
        return Text(f"{task.speed:,.0f} runs/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def shown(quiet: bool, *beside: ProgressColumn) -> Iterator[Progress]:
    """Yield a bar, with columns `beside` it, that is drawn where standard error is a terminal and nobody wants it quiet."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), *beside, TimeRemainingColumn()]
    console = Console(stderr=True)
    bar = Progress(*columns, console=console, transient=True, disable=quiet or not console.is_terminal)
    with nullcontext() if bar.disable else bar:  # one that begins and ends writes a line, even if it is disabled
        yield bar


@contextmanager
def progress(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` for `pcbench.run` that draws a bar with rate and time left on standard error."""
    with shown(quiet, Rate()) as bar:
        task = bar.add_task("designing gains", total=None)

        def tell(event: str, value: float) -> None:
            if event == "planned":
                bar.update(task, total=(bar.tasks[0].total or 0) + value, description="compiling")
            elif event == "runs":
                bar.update(task, advance=value, description="simulating")
            elif event == "closing":
                bar.update(task, description="statistics")
            elif event.startswith(("tuning", "comparing")):
                bar.update(task, description=event)

        yield tell


@contextmanager
def counting(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` that draws a bar for files and blocks: an event with its number begins one, `...ed` goes on."""
    with shown(quiet) as bar:
        current: list[Any] = []

        def tell(event: str, value: float) -> None:
            if event in ("checked", "compared", "merged", "reproduced"):
                bar.advance(current[-1], value)
            else:
                current.append(bar.add_task(event, total=value or None))

        yield tell


@contextmanager
def tuning(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` for a tuning: a bar over its budget with the least objective so far, on standard error."""
    with shown(quiet) as bar:
        task = bar.add_task("designing gains", total=None)

        def tell(event: str, value: float) -> None:
            if event == "begin":
                bar.update(task, total=value, description="compiling")
            elif event == "point":
                bar.update(task, advance=1, description=f"least so far {value:.5g}")
            elif event == "judging":
                bar.update(task, description="judging on other seeds")

        yield tell
