"""A cache of results by the values of the arguments; arrays are compared bit by bit. No jax."""

from collections.abc import Callable, Hashable
from functools import lru_cache, partial, wraps
from types import FunctionType
from typing import NamedTuple, ParamSpec, TypeVar

import numpy as np

P = ParamSpec("P")
T = TypeVar("T")


class _Call(NamedTuple):
    key: Hashable
    arguments: tuple[object, ...]
    named: dict[str, object]

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self.key == other.key


def cached_by_value(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function with a cache of its last 256 results, by arguments that are equal to the bit.

    Arrays among the arguments are passed to the function as contiguous floats. Callers must not write to an array of a result.
    """

    @lru_cache(maxsize=256)
    def once(call: _Call) -> T:
        return function(*call.arguments, **call.named)  # type: ignore[arg-type]

    @wraps(function)
    def ask(*arguments: P.args, **named: P.kwargs) -> T:
        each = tuple(map(_contiguous, arguments)), {name: _contiguous(a) for name, a in named.items()}
        return once(_Call(key_of(each), *each))

    for name in ("cache_clear", "cache_info"):  # as in functools.lru_cache
        setattr(ask, name, getattr(once, name))
    return ask


def _contiguous(argument: object) -> object:
    return np.ascontiguousarray(argument, float) if isinstance(argument, np.ndarray) else argument


def key_of(what: object) -> Hashable:
    """Return a key that is equal for equal values, to the bit; raise TypeError if there is none."""
    if isinstance(what, np.ndarray):
        return what.dtype.str, what.shape, what.tobytes()
    if what is None or isinstance(what, (bool, int, float, str)):
        return type(what), repr(what)
    if isinstance(what, (tuple, list)):
        return type(what), *map(key_of, what)
    if isinstance(what, dict):
        return dict, *((key_of(name), key_of(value)) for name, value in what.items())
    if isinstance(what, partial):
        return type(what), key_of(what.func), key_of(what.args), key_of(what.keywords)
    if isinstance(what, FunctionType):
        return what
    if hasattr(what, "__array__"):  # JAX arrays
        numbers = np.asarray(what)
        return numbers.dtype.str, numbers.shape, numbers.tobytes()
    raise TypeError(f"{type(what).__name__} has no key")
