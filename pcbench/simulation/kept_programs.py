"""Compiled programs that outlive their process, found again without being traced anew.

A program is kept under the digest of its text (what jax lowers it to) with all that decides how that is compiled. A second,
smaller file says which text it is that this source, with this layout and these shapes, is lowered to: where that is known, the
program is loaded at once, in a tenth of the time that tracing takes. It is written for pcbench's own functions alone, which
their source describes; a program of a user's own is traced in every process, as its numbers may stand in its closures.

Programs are kept where `process.setup` has said so. What cannot be read or written costs time, and nothing else.

Not kept is what calls functions that are no part of it: LAPACK's (`jnp.linalg`), which jax looks up in SciPy while it traces.
In a process that has not traced, such a program jumps to nowhere, or waits for Python while Python waits for it.
"""

import hashlib
import platform
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache, partial
from pathlib import Path
from types import FunctionType
from typing import Any

import jax
import numpy as np
from jax import monitoring

from pcbench import __version__
from pcbench.machine import cache as kept
from pcbench.machine.provenance import versions
from pcbench.simulation.loaded import Loaded, as_bytes

HIT = "/jax/compilation_cache/cache_hits"
BASE = Path(__file__).parent.parent
CALL = "stablehlo.custom_call"  # of a function by its name
QUIET = ("cache", "log", "traceback", "explain")  # settings that change no program
FORM = "flat"  # of a program's file; another name where it changes
Early = Callable[[str, Any], Loaded | None]  # of a text, on a device
_AHEAD: list[Early] = []


def folder() -> Path | None:
    """Return where programs are kept; None where they are not."""
    where = kept.folder("programs", "whole")
    told = {name: getattr(jax.config, f"jax_{name}") for name in ("enable_compilation_cache", "compilation_cache_dir")}
    return where if told == {"enable_compilation_cache": True, "compilation_cache_dir": str(where.parent)} else None


def asked(layout: Any, problem: Any, device: Any, options: Any) -> str | None:
    """Return what tells a program from all others before it is traced; None where functions are not all pcbench's own.

    `problem` has the kind of each array as a text in its place.
    """
    try:
        said = [_said(layout), _said(problem), _device(device), repr(options), _settings(), _machine(), _source()]
    except LookupError:
        return None
    return _digest(said)


def kind(array: Any) -> str:
    """Return an array's type and shape as a text."""
    return f"{np.asarray(array).dtype}{np.shape(array)}"


def of_text(text: str, device: Any, options: Any) -> str:
    """Return what tells a lowered program from all others."""
    return _digest([FORM, text, _device(device), repr(options), _settings(), _machine()])


def whole(text: str) -> bool:
    """Return whether a lowered program has in it all that it calls, so that it runs in a process that has not traced it."""
    return CALL not in text


def known(where: Path, asked: str) -> str | None:
    """Return which text this asks for, where that is known."""
    try:
        return (where / f"{asked}.txt").read_text()
    except OSError:
        return None


def load(where: Path, text: str, device: Any) -> Loaded | None:
    """Return a compiled program on a device, which may have been read ahead; None where it is not kept, or of no use."""
    found = next((early for ahead in _AHEAD if (early := ahead(text, device))), None) or read(where, text, device)
    try:
        return found if found and found.trees else None
    except Exception:  # of types that are no more
        return None


@contextmanager
def ahead(early: Early) -> Iterator[None]:
    """Have whoever asks for a program ask `early` for it first."""
    _AHEAD.append(early)
    try:
        yield
    finally:
        _AHEAD.remove(early)


def read(where: Path, text: str, device: Any) -> Loaded | None:
    """Return a compiled program from its file, on a device; None where it is not kept, or cannot be loaded."""
    try:
        return Loaded((where / f"{text}.program").read_bytes(), device)
    except Exception:  # whatever a damaged file, or another release's, makes of it
        return None


def keep(where: Path, text: str, asked: str | None, compiled: Any = None) -> None:
    """Keep a program that has just been made, and which text it was that asked for it."""
    if compiled is not None:
        try:
            content = as_bytes(compiled)
        except Exception:  # not every platform can
            return
        kept.keep(where / f"{text}.program", content)
    if asked:
        kept.keep(where / f"{asked}.txt", text)


@contextmanager
def found_by_jax() -> Iterator[list[str]]:
    """Yield a list that gets an entry where jax finds a program in its own cache: such a one cannot be kept again.

    What is serialised from it lacks functions, and says so only when it is called.
    """
    _listening()
    out: list[str] = []
    _HITS.found = out
    try:
        yield out
    finally:
        _HITS.found = []


_HITS = threading.local()


@cache
def _listening() -> None:
    monitoring.register_event_listener(_hear)


def _hear(event: str, **about: str | int) -> None:
    """Note a hit for the thread that compiles."""
    if event == HIT:
        getattr(_HITS, "found", []).append(event)


def _said(what: Any) -> Any:
    """Return what a layout or a tree holds, functions by where they stand in pcbench's source and what they close over.

    Raises LookupError for what that does not describe.
    """
    if what is None or isinstance(what, bool | int | float | str):
        return repr(what)
    if isinstance(what, tuple | list):
        return [type(what).__qualname__, *map(_said, what)]
    if isinstance(what, dict):
        return [[_said(key), _said(value)] for key, value in what.items()]
    if isinstance(what, partial):
        return [type(what).__qualname__, _said(what.func), _said(what.args), _said(what.keywords)]
    code = what.__code__ if isinstance(what, FunctionType) else None
    if code is None or BASE not in Path(code.co_filename).parents:
        raise LookupError(what)
    held = [cell.cell_contents for cell in what.__closure__ or ()]
    place = [code.co_filename, code.co_qualname, str(code.co_firstlineno)]
    return [place, _said(held), _said(what.__defaults__), _said(what.__kwdefaults__)]


def _digest(said: Any) -> str:
    return hashlib.sha256(repr(said).encode()).hexdigest()[:40]


def _device(device: Any) -> str:
    """Return what decides how a text is compiled for a device."""
    return repr(device and [device, device.device_kind, device.client.platform_version])


def _settings() -> list[str]:
    """Return what this thread's jax is set to, but for where it keeps and says things."""
    names = [n for n in sorted(jax.config.values) if n.startswith("jax_") and not any(w in n for w in QUIET)]
    return [f"{name}={getattr(jax.config, name, None)}" for name in names]


@cache
def _machine() -> str:
    """Return what decides how a text is compiled, besides options and settings: releases, flags, the processor."""
    about = Path("/proc/cpuinfo")
    lines = about.read_text().splitlines() if about.exists() else []
    flags = {line for line in lines if line.startswith(("model name", "flags", "Features", "CPU part"))}
    return repr([versions(), platform.machine(), platform.processor(), sorted(flags)])


@cache
def _source() -> str:
    """The digest of pcbench's own text."""
    out = hashlib.sha256(__version__.encode())
    for path in sorted(BASE.rglob("*.py")):
        out.update(f"{path.relative_to(BASE)} {path.stat().st_size}".encode() + path.read_bytes())
    return out.hexdigest()
