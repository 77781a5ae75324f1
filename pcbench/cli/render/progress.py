"""Progress bars on standard error, if it is a terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from rich import progress as rich
from rich.console import Console
from rich.text import Text

from pcbench.errors import printable
from pcbench.runtime.progress import COMPILING, SILENT, Progress


class Rate(rich.ProgressColumn):
    """Runs per second."""

    def render(self, task: rich.Task) -> Text:
        """Show the number of runs per second; nothing if the task does not count runs."""
        has_rate = task.speed and task.fields.get("what") == "runs"
        return Text(f"{task.speed:,.0f} runs/s" if has_rate else "", style="progress.data.speed")


class Remaining(rich.TimeRemainingColumn):
    """Estimated time that remains, once every program is compiled."""

    def render(self, task: rich.Task) -> Text:
        """Show the estimate; nothing while a program compiles, which takes longer than any step."""
        return Text("") if COMPILING in task.description else super().render(task)


@contextmanager
def bar(quiet: bool, first: str = "") -> Iterator[Progress]:
    """Yield a Progress that draws a line per activity if standard error is a terminal and `quiet` is not set.

    An activity of unknown length, such as the `first`, is replaced by the next. More of the same work extends its line.
    """
    console = Console(stderr=True)
    if quiet or not console.is_terminal:
        yield SILENT
        return
    columns = [
        rich.TextColumn("{task.description}", markup=False),
        rich.BarColumn(16),
        rich.MofNCompleteColumn(),
        Rate(),
    ]
    columns += [rich.TimeElapsedColumn(), Remaining()]
    with rich.Progress(*columns, console=console, transient=True) as lines:
        yield draw_progress(lines, first)


def draw_progress(lines: rich.Progress, first: str = "") -> Progress:
    """Return a Progress that draws lines."""

    def begin(activity: str, total: int | None) -> None:
        activity = printable(activity)
        last = lines.tasks[-1] if lines.tasks else None
        if last and last.total is None:
            lines.update(last.id, description=activity, total=total, what=activity)
        elif last and last.fields["what"] == activity:
            lines.update(last.id, description=activity, total=(last.total or 0) + (total or 0))
        else:
            lines.add_task(activity, total=total, what=activity)

    def step(count: int) -> None:
        lines.advance(lines.tasks[-1].id, count)

    def note(text: str) -> None:
        lines.update(lines.tasks[-1].id, description=printable(text))

    if first:
        begin(first, None)
    return Progress(begin, step, note)
