"""The page's pictures as files for a paper: SVG and PDF whose text is text, PNG."""

from collections.abc import Iterator
from pathlib import Path

from pcbench.dataset import storage
from pcbench.dataset.result import Result
from pcbench.errors import unknown
from pcbench.plots import frames
from pcbench.plots.labels import KINDS, saved
from pcbench.report import figures
from pcbench.report.figures import SHOWN, Picture, Shown
from pcbench.runtime.progress import SILENT, Progress


def write(
    result: Result, out: str | Path, progress: Progress = SILENT, shown: Shown = SHOWN, formats: tuple[str, ...] = KINDS
) -> list[str]:
    """Write every picture of the page, and return the names of the files, without their kind."""
    target, names = storage.target(str(out)), []
    storage.make(target)
    places = figures.places(result, result.scenarios, shown, progress)
    progress.begin("figures", None)
    for picture in drawn(places):
        for kind in formats:
            storage.put(target, f"{picture.name}.{kind}", saved(picture.figure, kind))
        names.append(picture.name)
        progress.step(1)
    return names


def drawn(places: dict[str, figures.Place]) -> Iterator[Picture]:
    """Yield every picture, scenario after scenario."""
    for scenario, here in places.items():
        for signal in frames.ranked(here.result, scenario, here.shown.signals, here.shown.metric):
            yield from figures.of_signal(here, signal)
        yield from figures.of_all_signals(here)


def kinds_of(text: str) -> tuple[str, ...]:
    """Return the kinds of files that a list with commas names; raise UserError for one that is none."""
    found = tuple(dict.fromkeys(kind.strip().lower() for kind in text.split(",")))
    for kind in found:
        if kind not in KINDS:
            raise unknown("--formats", "kind of file", kind, KINDS)
    return found
