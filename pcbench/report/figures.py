"""The page's pictures as files for a paper: SVG and PDF whose text is text, PNG."""

from collections.abc import Iterator
from pathlib import Path

from pcbench.dataset import store
from pcbench.dataset.result import Result
from pcbench.errors import unknown
from pcbench.machine.progress import SILENT, Progress
from pcbench.plots import frames
from pcbench.plots.files import KINDS, saved
from pcbench.report import pictures
from pcbench.report.pictures import SHOWN, Picture, Shown


def write(
    result: Result, out: str | Path, progress: Progress = SILENT, shown: Shown = SHOWN, kinds: tuple[str, ...] = KINDS
) -> list[str]:
    """Write every picture of the page, and return the names of the files, without their kind."""
    target, names = store.target(str(out)), []
    store.make(target)
    progress.begin("figures", None)
    for picture in drawn(result, shown):
        for kind in kinds:
            store.put(target, f"{picture.name}.{kind}", saved(picture.figure, kind))
        names.append(picture.name)
        progress.step(1)
    return names


def drawn(result: Result, shown: Shown) -> Iterator[Picture]:
    """Yield every picture, scenario after scenario."""
    for scenario in result.scenarios:
        here = pictures.place(result, scenario, shown)
        for signal in frames.ranked(result, scenario, shown.signals, shown.metric):
            yield from pictures.of_signal(here, signal)
        yield from pictures.of_all_signals(here)


def kinds_of(text: str) -> tuple[str, ...]:
    """Return the kinds of files that a list with commas names; raise UserError for one that is none."""
    found = tuple(dict.fromkeys(kind.strip().lower() for kind in text.split(",")))
    for kind in found:
        if kind not in KINDS:
            raise unknown("--kinds", "kind of file", kind, KINDS)
    return found
