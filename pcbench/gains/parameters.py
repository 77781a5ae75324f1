"""Free parameters of an observer: its tunable options, as unbounded numbers.

An option is declared with `tunable`. A positive number is represented by its logarithm, and one in an interval by its logit.
A matrix is represented by its entries relative to their size. A covariance is represented by its Cholesky factor, with the
logarithms of the diagonal. So every vector of numbers is a valid option for a study, and steps are comparable. The gains
follow by the observer's own design, which certifies or refuses them.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple, get_args

import annotated_types
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo

from pcbench.errors import UserError
from pcbench.observers import ObserverSpec
from pcbench.observers.parts.options import TUNABLE, option_metadata
from pcbench.protocols import Leaf
from pcbench.toml_text import TomlTable

Vector = NDArray[np.float64]
ZERO_TOL = 1e-15  # relative to a matrix's size; smaller entries are 0
PERTURBATION, SAME = 0.1, 1e-9  # step of a parameter; relative change below which gains do not depend on it
MIN_POSITIVE = 1e-12  # smallest positive value, also the start of one whose default is 0
LOG_RANGE = (np.log(MIN_POSITIVE) / 2, -np.log(MIN_POSITIVE) / 2)  # range of the logarithm of a standard deviation


class NothingFree(UserError):
    """The observer has no free parameter."""


class Free(NamedTuple):
    """One option; its numbers have the indices `first` .. `first + size - 1` in the vector."""

    name: str
    kind: str  # positive, between, real or covariance
    shape: tuple[int, ...]
    low: float  # lower end of an interval
    scale: float  # length of an interval; unit of a real number
    first: int

    @property
    def size(self) -> int:
        """Return its number of entries in the vector."""
        count = int(np.prod(self.shape))
        return (count + self.shape[0]) // 2 if self.kind == "covariance" else count


def tunable(entry: ObserverSpec) -> list[str]:
    """Return the names of an observer's tunable options."""
    return [name for name, field in entry.options.model_fields.items() if TUNABLE in option_metadata(field)]


def start(
    label: str,
    entry: ObserverSpec,
    options: BaseModel,
    numbers: Mapping[str, object],
    names: list[str] | None,
    where: str,
) -> tuple[list[Free], Vector]:
    """Return the free parameters and their start.

    The start is the value of each option. If that is None or a word, it is the number of the same name in `numbers`. `names`
    None: every tunable option with such a start. Raises UserError for a name of an option that is not tunable or has no
    start, and NothingFree without any parameter.
    """
    tunable_names, free, values = tunable(entry), list[Free](), list[Vector]()

    def accepts(parameter: Free, at: Vector) -> bool:
        """Return whether the option accepts such a value, for example a list with one entry per output."""
        try:
            with_values(options, [parameter._replace(first=0)], at)
        except ValidationError:
            return False
        return True

    for name in tunable_names if names is None else names:
        if name not in tunable_names:
            raise UserError(
                f"{where}: got '{name}' to tune, expected {' or '.join(tunable_names) or 'nothing: it has no free parameters'}."
            )
        value = getattr(options, name)
        value = numbers.get(name) if value is None or isinstance(value, str) else value
        if value is not None:
            parameter, at = _free(entry, name, value, sum(f.size for f in free))
            if not parameter.shape and not accepts(parameter, at):  # the option needs a list, here of one entry
                parameter = parameter._replace(shape=(1,))
            if accepts(parameter, at):
                free.append(parameter)
                values.append(at)
                continue
        if names is not None:
            raise UserError(
                f"{where}: {name} has no value to start from, expected one; write [options.{label}] {name} = ..."
            )
    if not free:
        raise NothingFree(f"{where}: got an observer without free parameters, expected one with some; tune another.")
    return free, np.concatenate(values)


def _free(entry: ObserverSpec, name: str, value: object, first: int) -> tuple[Free, Vector]:
    """Return one parameter with the bounds of its option's declaration, and its unbounded numbers at a value."""
    number, field = np.asarray(value, float), entry.options.model_fields[name]
    bounds, edges = [*field.metadata, *_declarations_of(field.annotation)], option_metadata(field)[TUNABLE]
    positive = any(isinstance(m, annotated_types.Gt | annotated_types.Ge) for m in bounds)
    kind = "between" if edges else "positive" if positive else "real"
    kind = "covariance" if kind == "positive" and number.ndim == 2 and number.size > 1 else kind
    number = number.reshape(()) if number.size == 1 and kind != "real" else number
    low, high = edges if edges else (0.0, float(np.abs(number).max()) if kind == "real" else 1.0)
    scale = high - low if high - low > MIN_POSITIVE else 1.0  # a gain of 0 has no size
    parameter = Free(name, kind, number.shape, low, scale, first)
    return parameter, _to_unbounded(number, parameter).ravel()


def sensitive_names(free: list[Free], at: Vector, gains: Callable[[Vector], list[Leaf]]) -> list[str]:
    """Return the names of the parameters that affect the `gains` at a point, which depends on the design method."""
    nominal, out = gains(at), []
    for f in free:
        try:
            variation = gains(at + PERTURBATION * np.isin(np.arange(len(at)), range(f.first, f.first + f.size)))
        except (UserError, ValidationError):  # refused, so the gains depend on it
            out.append(f.name)
            continue
        if any(not np.allclose(a, b, rtol=SAME, atol=0) for a, b in zip(nominal, variation, strict=True)):
            out.append(f.name)
    return out


def entries(free: list[Free]) -> list[str]:
    """Return a name for each number; for a matrix name[0], name[1], row by row."""
    return [f.name if f.size == 1 else f"{f.name}[{i}]" for f in free for i in range(f.size)]


def with_values(options: BaseModel, free: list[Free], at: Vector) -> BaseModel:
    """Return the options with the free parameters at a point, validated like those of a study."""
    return type(options).model_validate(options.model_dump() | to_options(free, at))


def to_options(free: list[Free], at: Vector) -> TomlTable:
    """Return the free parameters as a study's TOML has them."""
    out = {}
    for f in free:
        part = at[f.first : f.first + f.size]
        out[f.name] = _to_bounded(part if f.kind == "covariance" else part.reshape(f.shape), f).tolist()
    return out


def _to_bounded(z: Vector, f: Free) -> Vector:
    if f.kind == "positive":
        return np.asarray(np.exp(np.clip(z, np.log(MIN_POSITIVE), -np.log(MIN_POSITIVE))))
    if f.kind == "between":
        return np.asarray(f.low + f.scale / (1 + np.exp(-z)))
    if f.kind == "covariance":  # L L': logarithms of L's diagonal; below it, entries relative to their row's diagonal
        i, j = np.tril_indices(f.shape[0])
        L = np.zeros(f.shape)
        L[i, j] = np.where(i == j, 1.0, z)
        L *= np.exp(np.clip(z[i == j], *LOG_RANGE))[:, None]
        return L @ L.T
    return np.where(np.abs(z) < ZERO_TOL, 0.0, z * f.scale)


def _to_unbounded(value: Vector, f: Free) -> Vector:
    if f.kind == "positive":
        return np.asarray(np.log(np.maximum(value, MIN_POSITIVE)))
    if f.kind == "covariance":
        L = np.linalg.cholesky(value + MIN_POSITIVE * np.abs(value).max() * np.eye(len(value)))
        i, j = np.tril_indices(len(L))
        return np.where(i == j, np.log(np.diag(L))[i], (L / np.diag(L)[:, None])[i, j])
    if f.kind == "between":
        share = np.clip((value - f.low) / f.scale, MIN_POSITIVE, 1 - MIN_POSITIVE)
        return np.asarray(np.log(share / (1 - share)))
    return np.asarray(value / f.scale)


def _declarations_of(annotation: object) -> list[object]:
    """Return the declarations of all types that an option's value, or an entry of it, may have."""
    option_metadata = getattr(annotation, "__metadata__", ())
    declarations = [
        m for entry in option_metadata for m in (entry.metadata if isinstance(entry, FieldInfo) else [entry])
    ]
    return declarations + [m for kind in get_args(annotation) for m in _declarations_of(kind)]
