"""Importing what will be needed while something else computes."""

from collections.abc import Sequence
from importlib import import_module
from threading import Thread
from typing import Any

from pcbench.runtime.progress import Progress

CLOSING = (
    "scipy.special",
    "pandas",
)  # what statistics need, and pyarrow, which looks for pandas before it takes a list
SHOWING = ("pcbench.cli.render.results",)  # what a table in the terminal needs


def importing(progress: Progress, modules: Sequence[str]) -> Progress:
    """Return a Progress that hears the same, and has modules imported beside the work once that has begun."""

    def begin(*said: Any) -> None:
        progress.begin(*said)
        Thread(target=lambda: [import_module(name) for name in modules], name="importing").start()

    return progress._replace(begin=begin)
