"""Traced programs on disk. jax caches machine code but no traces, and tracing takes most of the start of a repeated study.

A program is stored as StableHLO (`jax.export`), under a digest of everything it is traced from: pcbench's source, releases of
Python and jax, the layout, the types of its arrays. jax then finds the machine code in its own cache. Programs with
user-defined functions are traced each time, as their inputs are unknown. Only the command line stores programs (`allow`), as
other processes may have replaced functions of pcbench.
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

ROOM = 256  # programs kept, the most recently used
SIZE = hashlib.sha256().digest_size
OF_LIBRARIES = ("jax", "jaxlib", "numpy")  # packages whose releases are in the digest
_LOCK = Lock()
_registered: set[type] = set()
_allowed = False


def allow() -> None:
    """Allow this process to store programs and to load stored ones."""
    global _allowed
    _allowed = True


def compile_program(
    function: Callable[..., PyTree],
    about: object,
    args: tuple[PyTree, ...],
    options: dict[str, str | bool] | None,
    result_types: tuple[type, ...] = (),
) -> Any:
    """Return a function compiled for arrays like `args`; its trace is loaded from the store if possible.

    Args:
        function: the function to trace. It may read its arguments and `about`, and nothing else that varies.
        about: everything else that decides the program: numbers, strings, named tuples and functions, in any tree.
        args: arrays, or their shape, dtype and sharding.
        options: compiler options.
        result_types: types of named tuples in the result.
    """
    leaves, tree = jax.tree.flatten(args)
    for named_tuple in result_types:
        _register(named_tuple)
    key = _digest(function, about, args) if _allowed else None
    if key is None:
        return jax.jit(function).lower(*args).compile(options)

    def flat(*leaves: Any) -> PyTree:
        return function(*jax.tree.unflatten(tree, leaves))

    call = jax.jit(_load_or_trace(key, flat, leaves).call).lower(*leaves).compile(options)
    return _CallWithTrees(call)


class _CallWithTrees:
    """A compiled function of leaves, called with trees."""

    def __init__(self, call: Any) -> None:
        self._call = call
        self.memory_analysis = call.memory_analysis

    def __call__(self, *args: PyTree) -> PyTree:
        return self._call(*jax.tree.leaves(args))


def _load_or_trace(key: str, flat: Callable[..., PyTree], leaves: list[Any]) -> export.Exported:
    """Return the program of a key: loaded, or traced and stored."""
    place = cache.folder("traces")
    path = place / key
    content = b""
    with suppress(OSError):
        content = path.read_bytes()
        os.utime(path)
    digest, program = content[:SIZE], content[SIZE:]
    if hashlib.sha256(program).digest() != digest:
        program = bytes(export.export(jax.jit(flat))(*leaves).serialize())
        cache.keep(path, hashlib.sha256(program).digest() + program)
        _drop_old(place)
    return export.deserialize(bytearray(program))  # also the first time: jax's cache is keyed by the program text


def _register(named_tuple: type) -> None:
    """Register a named tuple type for serialization by name."""
    with _LOCK:
        if named_tuple not in _registered:
            name = f"{named_tuple.__module__}.{named_tuple.__qualname__}"
            export.register_namedtuple_serialization(named_tuple, serialized_name=name)
            _registered.add(named_tuple)


def _drop_old(place: Path) -> None:
    """Remove all but the `ROOM` most recently used programs."""
    with suppress(OSError):
        paths = sorted(place.iterdir(), key=lambda path: path.stat().st_mtime)
        for path in paths[:-ROOM]:
            path.unlink()


class UnknownError(Exception):
    """An object that cannot be included in a digest."""


def _digest(function: Callable[..., PyTree], *inputs: object) -> str | None:
    """Return the digest of everything that a program is traced from; None if some of it is unknown."""
    digest = hashlib.sha256(_surroundings())
    try:
        digest.update(_name(function))
        for part in _parts(inputs, set()):
            digest.update(b"%d " % len(part) + part)
    except UnknownError:
        return None
    return digest.hexdigest()


@functools.cache
def _surroundings() -> bytes:
    """Return the digest of pcbench's source, of releases, and of the user's jax settings."""
    digest, root = hashlib.sha256(), Path(__file__).parents[1]
    for path in sorted(root.rglob("*.py")):
        digest.update(f"{path.relative_to(root)} {path.stat().st_size} ".encode() + path.read_bytes())
    settings = sorted(item for item in os.environ.items() if item[0].startswith(("JAX_", "XLA_")))
    releases = [(name, metadata.version(name)) for name in OF_LIBRARIES]
    digest.update(repr((platform.python_version(), releases, settings, jax.default_backend())).encode())
    return digest.digest()


def _parts(x: object, inside: set[int]) -> Iterator[bytes]:
    """Yield bytes that identify an object; raise UnknownError if that is not possible."""
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
    elif id(x) in inside:  # a recursive function
        yield b"above"
    else:
        children = _children(x)
        yield b"%d of " % len(children) + _name(type(x))
        for child in children:
            yield from _parts(child, inside | {id(x)})


def _children(x: object) -> list[object]:
    """Return the parts of an object."""
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
        except ValueError:  # an empty cell of a closure
            raise UnknownError from None
        return [_name(x), x.__code__, x.__defaults__, x.__kwdefaults__, *cells]
    if callable(x) and isinstance(inner := getattr(x, "__wrapped__", None), FunctionType):  # a wrapper such as jax.jit
        return [inner]
    raise UnknownError


def _name(x: Any) -> bytes:
    """Return the name of a type or function of pcbench, of Python, or of a library whose release is in the digest."""
    module = str(getattr(x, "__module__", "")).partition(".")[0]
    packages = ("pcbench", *OF_LIBRARIES, *(("builtins", "functools", "types") if isinstance(x, type) else ()))
    if module not in packages:
        raise UnknownError
    return f"{x.__module__}.{x.__qualname__}".encode()
