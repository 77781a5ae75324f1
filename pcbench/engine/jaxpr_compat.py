"""Access to jax internals: names of primitives, and the equation parameters that the interpreter needs.

jax does not guarantee these, so no other module of pcbench reads an equation's parameters. The module supports jax 0.10.0 to
0.12.0 (`NEWEST`). With a newer jax a study is computed by the definition, which needs none of this. Up to 0.10 a scan counts
its constants and carries (`num_consts`, `num_carry`). From 0.11 on it has one tree of operands in three parts (`ft_in`:
constants, carries, rows). A release that changes the parameters raises an error here instead of giving wrong numbers.
"""

from contextlib import suppress
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np
from jax.extend import random as generators
from jax.extend.core import ClosedJaxpr, Jaxpr, Literal, jaxpr_as_fun
from jax.lax import GatherScatterMode

from pcbench.errors import UserError

__all__ = ["ClosedJaxpr", "Jaxpr", "Literal", "generators", "jaxpr_as_fun"]  # of jax, for other modules

Eqn: TypeAlias = Any  # a JaxprEqn; jax's types lack the shapes of its variables
Atom: TypeAlias = Any  # a Var or Literal, likewise
EqnParams = dict[str, Any]
NEWEST = (0, 12)  # newest supported release of jax


def is_supported() -> bool:
    """Return whether the installed jax is not newer than `NEWEST`."""
    return tuple(jax.__version_info__[:2]) <= NEWEST


ELEMENTWISE = frozenset(
    """abs acos acosh add add_any and asin asinh atan atan2 atanh cbrt ceil clamp convert_element_type copy cos cosh div
    eq erf exp exp2 expm1 floor ge gt integer_pow is_finite le log log1p logistic lt max min mul ne neg nextafter not
    or pow rem round rsqrt select_n sign sin sinh sqrt square stop_gradient sub tan tanh xor""".split()  # noqa: SIM905
)
STRUCTURAL = frozenset(
    "broadcast_in_dim concatenate expand_dims pad reshape rev slice split squeeze stack tile transpose unstack".split()  # noqa: SIM905
)
FOLDS = ("reduce_sum", "reduce_max", "reduce_min", "reduce_prod", "reduce_and", "reduce_or")
CALLS = frozenset(["jit", "pjit", "closed_call", "core_call", "remat", "checkpoint", "custom_jvp_call"])


class Scan(NamedTuple):
    """A scan's equation: its operands are `consts` constants, `carry` carries, and rows."""

    body: ClosedJaxpr
    consts: int
    carry: int
    length: int
    options: EqnParams  # further arguments of jax.lax.scan


class While(NamedTuple):
    """A while loop's equation: operands are constants of the condition, of the body, and the state."""

    cond: ClosedJaxpr
    body: ClosedJaxpr
    cond_consts: int
    body_consts: int


def value(literal: Any) -> np.ndarray:
    """Return a literal's number as an array; jax may keep one of Python."""
    return np.asarray(literal.val, literal.aval.dtype)


def is_traced(x: Any) -> bool:
    """Return whether the value of an array is not known while a program is traced."""
    return isinstance(x, jax.core.Tracer)


def callee(params: EqnParams) -> ClosedJaxpr:
    """Return the closed program that one of CALLS applies."""
    program = params.get("jaxpr") or params["call_jaxpr"]
    return program if hasattr(program, "consts") else ClosedJaxpr(program, ())


def callee_name(params: EqnParams) -> str:
    """Return the name of the function that one of CALLS applies; empty if it has none."""
    return str(params.get("name", ""))


def scan(params: EqnParams) -> Scan:
    """Return a scan's parameters, from either form; raise UserError for an unknown form."""
    if "num_consts" in params:
        consts, carry = params["num_consts"], params["num_carry"]
    elif "ft_in" in params:
        consts, carry = (len(list(part)) for part in params["ft_in"].unpack()[:2])
    else:
        raise UserError(
            f"jax: got a scan with the parameters {', '.join(sorted(params))}, which pcbench does not support, expected a "
            "release such as 0.12; install that."
        )
    options = {name: params[name] for name in ("length", "reverse", "unroll")}
    return Scan(params["jaxpr"], consts, carry, params["length"], options)


def while_(params: EqnParams) -> While:
    """Return a while loop's parameters."""
    return While(params["cond_jaxpr"], params["body_jaxpr"], params["cond_nconsts"], params["body_nconsts"])


def branches(params: EqnParams) -> tuple[ClosedJaxpr, ...]:
    """Return the closed programs that a cond chooses from by index."""
    return tuple(params["branches"])


def slice_sizes(params: EqnParams) -> tuple[int, ...]:
    """Return the shape of the result of a dynamic_slice."""
    return tuple(params["slice_sizes"])


def fold_axes(params: EqnParams) -> tuple[int, ...]:
    """Return the axes that one of FOLDS reduces."""
    return tuple(params["axes"])


def dot_axes(params: EqnParams) -> tuple[Any, Any]:
    """Return a dot_general's axes: ((contracted of a, of b), (batch of a, of b))."""
    contract, batch = params["dimension_numbers"]
    return contract, batch


def product_count(eqn: Eqn) -> int:
    """Return the number of products of a dot_general."""
    (contract, _), _ = dot_axes(eqn.params)
    return int(np.prod(eqn.outvars[0].aval.shape) * np.prod([eqn.invars[0].aval.shape[i] for i in contract]))


def takes_rows(params: EqnParams, operand: tuple[int, ...], rank: int) -> bool:
    """Return whether a gather takes whole rows of an `operand` of that shape, clipped, by indices of that `rank`."""
    if params["mode"] != GatherScatterMode.CLIP:
        return False
    d, sizes = params["dimension_numbers"], params["slice_sizes"]
    first_axis = d.start_index_map == d.collapsed_slice_dims == (0,) and not d.operand_batching_dims
    is_row = d.offset_dims == tuple(range(rank - 1, rank - 2 + len(sizes)))
    return first_axis and is_row and sizes == (1, *operand[1:])


def param(eqn: Eqn, name: str) -> Any:
    """Return a parameter of an equation; raise UserError with the primitive's name if this release of jax lacks it."""
    if name not in eqn.params:
        raise UserError(
            f"jax: got {eqn.primitive.name} with the parameters {', '.join(sorted(eqn.params))}, expected {name} among "
            "them, as up to jax 0.12; install that or an earlier one."
        )
    return eqn.params[name]


def expansion(eqn: Eqn) -> Any:
    """Return the only closed program among an equation's parameters if its arguments and results match the equation's."""
    programs = [p if hasattr(p, "consts") else ClosedJaxpr(p, ()) for p in inner_programs(eqn.params)]
    if len(programs) != 1:
        return None
    (only,) = programs
    return only if _types(only.jaxpr) == _types(eqn) else None


def _types(x: Any) -> list[list[Any]]:
    """Return the shapes and types of the arguments and results of an equation or a program."""
    return [[(v.aval.shape, v.aval.dtype) for v in vs] for vs in (x.invars, x.outvars)]


def parameter_items(eqn: Eqn) -> tuple[tuple[str, Any], ...]:
    """Return an equation's parameters as (name, value) pairs."""
    return tuple(eqn.params.items())


def rearrange(primitive: str, params: EqnParams, arrays: list[np.ndarray]) -> list[np.ndarray] | None:
    """Return the results of one of STRUCTURAL, computed by NumPy; None: only jax can compute them.

    jax would compile a program for each shape, in some 20 ms.
    """
    x = arrays[0]
    with suppress(KeyError):  # a release of jax with other parameters
        match primitive:
            case "broadcast_in_dim":
                sizes = [1] * len(params["shape"])
                for axis, size in zip(params["broadcast_dimensions"], x.shape, strict=True):
                    sizes[axis] = size
                return [np.broadcast_to(x.reshape(sizes), params["shape"])]
            case "concatenate":
                return [np.concatenate(arrays, params["dimension"])]
            case "reshape" if params["dimensions"] is None:
                return [x.reshape(params["new_sizes"])]
            case "slice":
                steps = params["strides"] or [1] * x.ndim
                return [x[tuple(map(slice, params["start_indices"], params["limit_indices"], steps))]]
            case "split":
                return np.split(x, np.cumsum(params["sizes"])[:-1], params["axis"])
            case "squeeze":
                return [x.squeeze(tuple(params["dimensions"]))]
            case "stack":
                return [np.stack(arrays, params["axis"])]
            case "transpose":
                return [x.transpose(params["permutation"])]
    return None


def inner_programs(params: EqnParams) -> list[Any]:
    """Return every program among an equation's parameters, closed or not."""
    values = (v for value in params.values() for v in (value if isinstance(value, tuple | list) else (value,)))
    return [v for v in values if isinstance(v, ClosedJaxpr | Jaxpr)]
