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
    keywords: dict[str, object]

    def __hash__(self) -> int:
        return hash(self.key)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Call) and self.key == other.key


def cached_by_value(function: Callable[P, T]) -> Callable[P, T]:
    """Return the function with a cache of its last 256 results, by arguments that are equal to the bit.

    Arrays among the arguments are passed to the function as contiguous floats. Callers must not write to an array of a result.
    """

    @lru_cache(maxsize=256)
    def call_cached(call: _Call) -> T:
        return function(*call.arguments, **call.keywords)  # type: ignore[arg-type]

    @wraps(function)
    def wrapper(*args: P.args, **kwargs: P.kwargs) -> T:
        values = tuple(map(_contiguous, args)), {name: _contiguous(a) for name, a in kwargs.items()}
        return call_cached(_Call(key_of(values), *values))

    for name in ("cache_clear", "cache_info"):  # as in functools.lru_cache
        setattr(wrapper, name, getattr(call_cached, name))
    return wrapper


def _contiguous(argument: object) -> object:
    return np.ascontiguousarray(argument, float) if isinstance(argument, np.ndarray) else argument


def key_of(argument: object) -> Hashable:
    """Return a key that is equal for equal values, to the bit; raise TypeError if there is none."""
    if isinstance(argument, np.ndarray):
        return argument.dtype.str, argument.shape, argument.tobytes()
    if argument is None or isinstance(argument, (bool, int, float, str)):
        return type(argument), repr(argument)
    if isinstance(argument, (tuple, list)):
        return type(argument), *map(key_of, argument)
    if isinstance(argument, dict):
        return dict, *((key_of(name), key_of(value)) for name, value in argument.items())
    if isinstance(argument, partial):
        return type(argument), key_of(argument.func), key_of(argument.args), key_of(argument.keywords)
    if isinstance(argument, FunctionType):
        return argument
    if hasattr(argument, "__array__"):  # JAX arrays
        numbers = np.asarray(argument)
        return numbers.dtype.str, numbers.shape, numbers.tobytes()
    raise TypeError(f"{type(argument).__name__} has no key")
