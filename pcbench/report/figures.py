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
    result: Result, out: str | Path, progress: Progress = SILENT, shown: Shown = SHOWN, formats: tuple[str, ...] = KINDS
) -> list[str]:
    """Write every picture of the page, and return the names of the files, without their kind."""
    target, names = store.target(str(out)), []
    store.make(target)
    places = pictures.places(result, result.scenarios, shown, progress)
    progress.begin("figures", None)
    for picture in drawn(places):
        for kind in formats:
            store.put(target, f"{picture.name}.{kind}", saved(picture.figure, kind))
        names.append(picture.name)
        progress.step(1)
    return names


def drawn(places: dict[str, pictures.Place]) -> Iterator[Picture]:
    """Yield every picture, scenario after scenario."""
    for scenario, here in places.items():
        for signal in frames.ranked(here.result, scenario, here.shown.signals, here.shown.metric):
            yield from pictures.of_signal(here, signal)
        yield from pictures.of_all_signals(here)


def kinds_of(text: str) -> tuple[str, ...]:
    """Return the kinds of files that a list with commas names; raise UserError for one that is none."""
    found = tuple(dict.fromkeys(kind.strip().lower() for kind in text.split(",")))
    for kind in found:
        if kind not in KINDS:
            raise unknown("--formats", "kind of file", kind, KINDS)
    return found
