"""Programs that a command will probably ask for, loaded while it is still importing: those it asked for the last time.

A command is told by its words. Loading goes on beside Python, as it is not Python's, and takes as long as all imports; a guess
that is wrong costs another core a moment, and changes nothing: whoever asks for a program names its text (`kept_programs`).
"""

import hashlib
import json
from collections.abc import Iterator, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax

from pcbench.machine import cache, pools
from pcbench.simulation import kept_programs
from pcbench.simulation.loaded import Loaded

Begun = Future[tuple[Any, Loaded | None]]  # a device, and what was loaded on it
MOST = 4  # programs to load unasked: a study of many has other work to do meanwhile


@contextmanager
def foreseen(words: Sequence[object]) -> Iterator[None]:
    """Load what these words asked for the last time, beside what follows, and remember what they ask for now."""
    where = kept_programs.folder()
    if where is None:
        yield
        return
    note = where / f"{hashlib.sha256(repr(words).encode()).hexdigest()[:40]}.foreseen"
    before, now = _noted(note), list[str]()
    with pools.pool(max(len(before), 1)) as beside:
        begun = {text: beside.submit(_read, where, text) for text in before}

        def ahead(text: str, device: Any) -> Loaded | None:
            now.append(text)
            return _ready(begun.pop(text, None), device)

        with kept_programs.ahead(ahead):
            yield
    asked = list(dict.fromkeys(now))[:MOST]
    if asked and asked != before:
        cache.keep(note, json.dumps(asked))


def _noted(note: Path) -> list[str]:
    try:
        found = json.loads(note.read_text())
    except (OSError, ValueError):
        return []
    return found[:MOST] if isinstance(found, list) and all(isinstance(text, str) for text in found) else []


def _read(where: Path, text: str) -> tuple[Any, Loaded | None]:
    device = jax.devices()[0]
    return device, kept_programs.read(where, text, device)


def _ready(begun: Begun | None, device: Any) -> Loaded | None:
    """What has been loaded, once it has; None where nothing was, or for another device."""
    if begun is None:
        return None
    on, loaded = begun.result()
    return loaded if on == device else None
