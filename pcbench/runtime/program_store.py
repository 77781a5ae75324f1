"""Traced programs on disk. Tracing is most of what a second run of a study would take: jax keeps machine code, and no trace.

A program is stored as StableHLO (`jax.export`), under a digest of all that it is traced from: the source of pcbench, releases
of Python and jax, the layout, the types of its arrays. jax then finds the machine code in its own cache. A program with
functions of a user's is traced each time, as nobody knows what these read. Only the command line stores programs (`allow`):
elsewhere pcbench's own functions may have been replaced.
"""

import functools
import hashlib
import os
import platform
from collections.abc import Callable, Iterator
from contextlib import suppress
from importlib import metadata
from pathlib import Path
from threading import Lock
from types import CodeType, FunctionType, MethodType
from typing import Any

import jax
import numpy as np
from jax import export
from jax.tree_util import Partial
from jaxtyping import PyTree
from pydantic import BaseModel

from pcbench.runtime import cache

ROOM = 256  # programs that are kept, those used last
SIZE = hashlib.sha256().digest_size
OF_LIBRARIES = ("jax", "jaxlib", "numpy")  # whose releases are in the digest
_LOCK = Lock()
_registered: set[type] = set()
_allowed = False


def allow() -> None:
    """Have programs of this process stored, and taken from the store."""
    global _allowed
    _allowed = True


def compile_program(
    function: Callable[..., PyTree],
    about: object,
    given: tuple[PyTree, ...],
    options: dict[str, str | bool] | None,
    returned: tuple[type, ...] = (),
) -> Any:
    """Return a function compiled for arrays like those `given`; its trace is taken from the store if it is there.

    Args:
        function: what is traced. It may read its arguments and `about`, and nothing else that varies.
        about: what decides the program besides its arguments: numbers, strings, named tuples and functions, in any tree.
        given: arrays, or what says their shape, dtype and sharding.
        options: of the compiler.
        returned: the types of named tuples in what it returns.
    """
    leaves, tree = jax.tree.flatten(given)
    for each in returned:
        _register(each)
    key = _digest(function, about, given) if _allowed else None
    if key is None:
        return jax.jit(function).lower(*given).compile(options)

    def flat(*leaves: Any) -> PyTree:
        return function(*jax.tree.unflatten(tree, leaves))

    call = jax.jit(_stored(key, flat, leaves).call).lower(*leaves).compile(options)
    return _OfTrees(call)


class _OfTrees:
    """A compiled function of leaves, called with trees."""

    def __init__(self, call: Any) -> None:
        self._call = call
        self.memory_analysis = call.memory_analysis

    def __call__(self, *given: PyTree) -> PyTree:
        return self._call(*jax.tree.leaves(given))


def _stored(key: str, flat: Callable[..., PyTree], leaves: list[Any]) -> export.Exported:
    """The program of a key: the one that is stored, or traced and stored now."""
    place = cache.folder("traces")
    path = place / key
    content = b""
    with suppress(OSError):
        content = path.read_bytes()
        os.utime(path)
    digest, stored = content[:SIZE], content[SIZE:]
    if hashlib.sha256(stored).digest() != digest:
        stored = bytes(export.export(jax.jit(flat))(*leaves).serialize())
        cache.keep(path, hashlib.sha256(stored).digest() + stored)
        _drop_old(place)
    return export.deserialize(bytearray(stored))  # the first time too: jax finds machine code by the text of a program


def _register(named_tuple: type) -> None:
    """Have a type of named tuples written by its name."""
    with _LOCK:
        if named_tuple not in _registered:
            name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
            export.register_namedtuple_serialization(named_tuple, serialized_name=name)
            _registered.add(named_tuple)


def _drop_old(place: Path) -> None:
    """Remove the programs that were used longest ago, but for `ROOM` of them."""
    with suppress(OSError):
        paths = sorted(place.iterdir(), key=lambda path: path.stat().st_mtime)
        for path in paths[:-ROOM]:
            path.unlink()


class UnknownError(Exception):
    """An object of which a digest cannot say what a program would read of it."""


def _digest(function: Callable[..., PyTree], *read: object) -> str | None:
    """Return the digest of what a program is traced from; None where some of it is not known."""
    found = hashlib.sha256(_surroundings())
    try:
        found.update(_name(function))
        for part in _parts(read, set()):
            found.update(b"%d " % len(part) + part)
    except UnknownError:
        return None
    return found.hexdigest()


@functools.cache
def _surroundings() -> bytes:
    """The digest of pcbench's source, of releases, and of what the user has set for jax."""
    found, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        found.update(f"{path.relative_to(root)} {path.stat().st_size} ".encode() + path.read_bytes())
    settings = sorted(item for item in os.environ.items() if item[0].startswith(("JAX_", "XLA_")))
    releases = [(name, metadata.version(name)) for name in OF_LIBRARIES]
    found.update(repr((platform.python_version(), releases, settings, jax.default_backend())).encode())
    return found.digest()


def _parts(x: object, inside: set[int]) -> Iterator[bytes]:
    """Yield bytes that tell an object from every other; raise UnknownError where none are known to."""
    if x is None or isinstance(x, bool | int | float | complex | str | bytes):
        yield f"{type(x).__name__} {x!r}".encode()
    elif isinstance(x, np.ndarray | np.generic | jax.Array):
        a = np.asarray(x)
        yield f"array {a.dtype} {a.shape}".encode() + a.tobytes()
    elif isinstance(x, jax.ShapeDtypeStruct | np.dtype):
        yield f"{type(x).__name__} {getattr(x, 'dtype', x)} {getattr(x, 'shape', ())}".encode()
    elif isinstance(x, type):
        yield _name(x)
    elif isinstance(x, CodeType):
        yield x.co_code + repr(x.co_names).encode()
        yield from _parts(x.co_consts, inside)
    elif id(x) in inside:  # a function that reads itself
        yield b"above"
    else:
        children = _children(x)
        yield b"%d of " % len(children) + _name(type(x))
        for child in children:
            yield from _parts(child, inside | {id(x)})


def _children(x: object) -> list[object]:
    """What an object is made of."""
    if isinstance(x, tuple | list):
        return [*getattr(x, "_fields", ()), *x]
    if isinstance(x, set | frozenset):
        return sorted(x, key=repr)
    if isinstance(x, dict):
        return [*x, *x.values()]
    if isinstance(x, functools.partial | Partial):
        return [x.func, x.args, x.keywords]
    if isinstance(x, MethodType):
        return [x.__func__, x.__self__]
    if isinstance(x, BaseModel):
        return [x.model_dump()]
    if isinstance(x, FunctionType):
        try:
            cells = [cell.cell_contents for cell in x.__closure__ or ()]
        except ValueError:  # one that is still empty
            raise UnknownError from None
        return [_name(x), x.__code__, x.__defaults__, x.__kwdefaults__, *cells]
    if callable(x) and isinstance(inner := getattr(x, "__wrapped__", None), FunctionType):  # such as of jax.jit
        return [inner]
    raise UnknownError


def _name(x: Any) -> bytes:
    """The name of a type or function of pcbench, or of a library whose release is known; of Python's types too."""
    module = str(getattr(x, "__module__", "")).partition(".")[0]
    known = ("pcbench", *OF_LIBRARIES, *(("builtins", "functools", "types") if isinstance(x, type) else ()))
    if module not in known:
        raise UnknownError
    return f"{x.__module__}.{x.__qualname__}".encode()
