"""How calls are checked in tests: beartype for the arguments, and every shaped field of the NamedTuples among them.

All names of one call are one: `n` of the gains is `n` of the memory and of xhat(0).
"""

from functools import wraps

from beartype import BeartypeConf, beartype
from jaxtyping import AbstractArray

CONF = BeartypeConf(is_pep484_tower=True)  # an int is a float


def _check(value, path):
    if not (isinstance(value, tuple) and hasattr(value, "_fields")):
        return
    for name, hint in type(value).__annotations__.items():
        field = getattr(value, name)
        if isinstance(hint, type) and issubclass(hint, AbstractArray) and not isinstance(field, hint):
            raise TypeError(f"{path}.{name}: got {field}, expected {hint}")
        if hasattr(hint, "_fields"):  # a field that may be anything may have names of its own
            _check(field, f"{path}.{name}")


def check_types(function):
    """Return a function that checks its arguments and their fields, as the import hook's `typechecker`."""
    typed = beartype(conf=CONF)(function)

    @wraps(function)
    def call(*args, **kwargs):
        for value in (*args, *kwargs.values()):
            _check(value, type(value).__name__)
        return typed(*args, **kwargs)

    return call
