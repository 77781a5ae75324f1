"""Elementwise operations and reductions of arrays as expressions of C.

Multiplications of floats are counted as in `planning.operation_counts`: one for each entry that is multiplied, divided,
or the argument of a function.
"""

from collections.abc import Callable, Mapping, Sequence
from functools import reduce

import jax
import numpy as np
from jax.lax import RoundingMethod

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import Eqn, EqnParams
from pcbench.export.terms import Entries, Entry, Term, Writer, as_c, kind_of, number_entries, place_of
from pcbench.planning.operation_counts import PER_ENTRY

INFIX = {"add": "+", "add_any": "+", "sub": "-", "mul": "*", "and": "&", "or": "|", "xor": "^"}
INFIX |= {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">=", "shift_left": "<<"}
INFIX |= {"shift_right_arithmetic": ">>"}
FUNCTIONS = "sqrt cbrt exp exp2 expm1 log log1p floor ceil erf erfc"
FUNCTIONS += " sin cos tan asin acos atan sinh cosh tanh asinh acosh atanh"
TEXTS = {name: f"{{0}} {sign} {{1}}" for name, sign in INFIX.items()}  # of operations, by their arguments
TEXTS |= {name: f"F({name})({{0}})" for name in FUNCTIONS.split()}
TEXTS |= {name: f"F({name})({{0}}, {{1}})" for name in ("atan2", "nextafter")}
TEXTS |= {
    "max": "LARGER({0}, {1})",
    "min": "SMALLER({0}, {1})",
    "sign": "SIGN({0})",
    "neg": "-{0}",
    "pow": "F(pow)({0}, (real){1})",
    "square": "{0} * {0}",
    "rsqrt": "R(1.0) / F(sqrt)({0})",
    "logistic": "R(1.0) / (R(1.0) + F(exp)(-{0}))",
    "is_finite": "isfinite({0}) != 0",
    "clamp": "CLAMPED({0}, {1}, {2})",
}
SAME = {"copy", "copy_p", "stop_gradient"}
FOLDS = dict(zip(jaxpr_compat.FOLDS, ("+", "LARGER", "SMALLER", "*", "&", "|"), strict=True))
UNSIGNED = {"int32_t": "uint32_t", "int64_t": "uint64_t"}
MAX_BRANCHES = 16  # more choices are written as a loop: a compiler takes minutes for thousands of single branches
MAX_POWER = 8  # larger whole powers are not written as a product


def _power(y: int, a: list[str]) -> str:
    if abs(y) > MAX_POWER:
        return f"F(pow)({a[0]}, R({y}.0))"
    text = " * ".join([a[0]] * abs(y)) or "R(1.0)"
    return f"R(1.0) / ({text})" if y < 0 else text


def _convert_number(kind: str, a: list[str], source: str) -> str:
    """Convert a number to another type: a float to the nearest possible integer, NaN to 0, as in jax."""
    if kind == "bool":
        return f"{a[0]} != 0"
    if source != "real" or kind == "real":
        return f"({kind}){a[0]}"
    name, is_signed = kind[:-2].upper(), kind[0] == "i"
    bits = int("".join(filter(str.isdigit, kind))) - is_signed
    least, low = (f"{name}_MIN", f"(-R({2.0**bits!r}))") if is_signed else ("0", "R(0.0)")
    clipped = f"{a[0]} <= {low} ? {least} : {a[0]} >= R({2.0**bits!r}) ? {name}_MAX : ({kind}){a[0]}"
    return f"{a[0]} != {a[0]} ? 0 : {clipped}"


def _select(a: list[str]) -> str:
    """Return the case that a selector names; 0 or false is the first."""
    selector, cases = a[0], a[1:]
    if len(cases) == 2:
        return f"{selector} ? {cases[1]} : {cases[0]}"
    return "".join(f"{selector} == {i} ? {case} : " for i, case in enumerate(cases[:-1])) + cases[-1]


def _divide(kind: str, a: list[str], sign: str) -> str:
    if kind == "real":
        return f"{a[0]} / {a[1]}" if sign == "/" else f"F(fmod)({a[0]}, {a[1]})"
    fallback = "(-1)" if sign == "/" else a[0]
    return f"{a[1]} != 0 ? {a[0]} {sign} {a[1]} : {fallback}"


def _round_number(params: Mapping[str, object], a: list[str]) -> str:
    nearest_even = params["rounding_method"] == RoundingMethod.TO_NEAREST_EVEN
    return f"F({'nearbyint' if nearest_even else 'round'})({a[0]})"


OTHERS: dict[str, Callable[[EqnParams, str, list[str]], str]] = {
    "not": lambda params, kind, a: f"!{a[0]}" if kind == "bool" else f"~{a[0]}",
    "abs": lambda params, kind, a: f"F(fabs)({a[0]})" if kind == "real" else f"{a[0]} < 0 ? -{a[0]} : {a[0]}",
    "div": lambda params, kind, a: _divide(kind, a, "/"),
    "rem": lambda params, kind, a: _divide(kind, a, "%"),
    "integer_pow": lambda params, kind, a: _power(int(params["y"]), a),
    "select_n": lambda params, kind, a: _select(a),
    "round": lambda params, kind, a: _round_number(params, a),
    "shift_right_logical": lambda params, kind, a: f"({kind})(({UNSIGNED.get(kind, kind)}){a[0]} >> {a[1]})",
}
ELEMENTWISE = TEXTS.keys() | OTHERS.keys() | SAME | {"convert_element_type"}


def elementwise(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write an operation on each entry."""
    name, aval = eqn.primitive.name, eqn.outvars[0].aval
    if name in SAME or (name == "convert_element_type" and eqn.invars[0].aval.dtype == aval.dtype):
        return args[0]
    kind, out = kind_of(aval.dtype), np.empty(aval.shape, object)
    products = int(name in PER_ENTRY and kind == "real")
    full = [np.broadcast_to(a, aval.shape) for a in args]
    if name == "select_n" and len(full) == 3 and sum(isinstance(x, Term) for x in full[0].flat) > MAX_BRANCHES:
        return _select_in_loop(w, kind, *full)
    for i in np.ndindex(aval.shape):
        operands = [a[i] for a in full]
        if name == "select_n" and not isinstance(operands[0], Term):
            out[i] = operands[1 + int(operands[0])]
        elif not any(isinstance(x, Term) for x in operands):
            arrays = [jax.numpy.asarray(x, v.aval.dtype) for x, v in zip(operands, eqn.invars, strict=True)]
            out[i] = np.asarray(eqn.primitive.bind(*arrays, **eqn.params))[()]
        else:
            texts = [as_c(x) for x in operands]
            if name == "convert_element_type":
                text = _convert_number(kind, texts, kind_of(eqn.invars[0].aval.dtype))
            else:
                text = TEXTS[name].format(*texts) if name in TEXTS else OTHERS[name](eqn.params, kind, texts)
            out[i] = w.let(kind, text, products)
    return out


def _select_in_loop(w: Writer, kind: str, selector: Entries, no: Entries, yes: Entries) -> Entries:
    """Write a selection between two arrays, entry by entry; a known selector is evaluated here."""
    is_term = np.array([isinstance(x, Term) for x in selector.flat]).reshape(selector.shape)
    out = np.empty(selector.shape, object)
    for i in zip(*np.nonzero(~is_term), strict=True):
        out[i] = (yes if selector[i] else no)[i]
    terms = selector[is_term]
    is_common = all(x.text == terms[0].text for x in terms)
    condition = terms[0].text if is_common else _index_entry(w, "bool", terms)
    texts = [_index_entry(w, kind, branch[is_term]) for branch in (yes, no)]
    target = w.room(kind, terms.shape)
    with w.block(f"for (int i = 0; i < {terms.size}; i++)"):
        w.say(f"{target[0].store}[i] = {condition} ? {texts[0]} : {texts[1]};")
    for i, x in zip(zip(*np.nonzero(is_term), strict=True), target, strict=True):
        out[i] = x
    return out


def _index_entry(w: Writer, kind: str, values: Entries) -> str:
    """Return entry i of an array, in its C array or in one that is written for it."""
    place = place_of(values) or place_of(w.array(kind, values))
    if place is None:
        raise AssertionError("an array that is written is part of an array of C")
    return f"{place.store}[{f'{place.base} + ' if place.base else ''}{f'{place.place} + ' if place.place else ''}i]"


def fold(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write the reduction of some axes, from the first entry to the last."""
    a, axes, kind = args[0], jaxpr_compat.fold_axes(eqn.params), kind_of(eqn.outvars[0].aval.dtype)
    free_axes = [i for i in range(a.ndim) if i not in axes]
    flat = a.transpose(*free_axes, *axes).reshape(*(a.shape[i] for i in free_axes), -1)
    out = np.empty(flat.shape[:-1], object)
    operator, fill = FOLDS[eqn.primitive.name], number_entries(0)
    if not a.size:  # what a fold of no entry is
        v = eqn.invars[0].aval
        folded = eqn.primitive.bind(jax.numpy.zeros(v.shape, v.dtype), **eqn.params)
        fill = number_entries(np.asarray(folded).ravel()[0])
    for i in np.ndindex(out.shape):
        texts = [as_c(x) for x in flat[i]]
        if not texts:
            out[i] = fill[()]
        elif operator in ("LARGER", "SMALLER"):
            out[i] = reduce(lambda x, y: w.let(kind, f"{operator}({as_c(x)}, {y})"), texts[1:], flat[i][0])
        else:
            out[i] = w.let(kind, f" {operator} ".join(texts)) if len(texts) > 1 else flat[i][0]
    return out


def running_sum(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write the cumulative sum along an axis."""
    axis, kind = jaxpr_compat.param(eqn, "axis"), kind_of(eqn.outvars[0].aval.dtype)
    a = np.moveaxis(args[0], axis, 0)
    a = a[::-1] if jaxpr_compat.param(eqn, "reverse") else a
    out = a.copy()
    for k in range(1, len(a)):
        for i in np.ndindex(a.shape[1:]):
            out[k, *i] = w.let(kind, f"{as_c(out[k - 1, *i])} + {as_c(a[k, *i])}")
    return np.moveaxis(out[::-1] if jaxpr_compat.param(eqn, "reverse") else out, 0, axis)


def extreme(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write the index of the largest (smallest) entry along an axis; of equal ones the first. NaN is not supported."""
    (axis,), sign = jaxpr_compat.param(eqn, "axes"), ">" if eqn.primitive.name == "argmax" else "<"
    kind, a = kind_of(eqn.outvars[0].aval.dtype), np.moveaxis(args[0], axis, -1)
    out = np.empty(a.shape[:-1], object)
    for i in np.ndindex(out.shape):
        best: Entry = a[i][0]
        index: Entry = np.int64(0)
        for k, x in enumerate(a[i][1:], 1):
            better = w.let("bool", f"{as_c(x)} {sign} {as_c(best)}").text
            best, index = (
                w.let(kind_of(eqn.invars[0].aval.dtype), f"{better} ? {as_c(x)} : {as_c(best)}"),
                w.let(kind, f"{better} ? {k} : {as_c(index)}"),
            )
        out[i] = index
    return out


def product(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write a product of matrices as sums of products, in the order of the entries."""
    (ca, cb), (ba, bb) = jaxpr_compat.dot_axes(eqn.params)
    aval = eqn.outvars[0].aval
    a, b = _arrange_axes(args[0], ba, ca), _arrange_axes(args[1], bb, cb)
    kind, out = kind_of(aval.dtype), np.empty(aval.size, object)
    for at, (k, i, j) in enumerate(np.ndindex(a.shape[0], a.shape[1], b.shape[1])):
        terms = [f"{as_c(x)} * {as_c(y)}" for x, y in zip(a[k, i], b[k, j], strict=True)]
        out[at] = w.let(kind, " + ".join(terms), len(terms) * (kind == "real")) if terms else number_entries(0.0)[()]
    return out.reshape(aval.shape)


def _arrange_axes(p: Entries, batch: Sequence[int], contract: Sequence[int]) -> Entries:
    """Reshape to one batch axis, one free axis and one contracted axis: [batch, free, contracted]."""
    free = [i for i in range(p.ndim) if i not in (*batch, *contract)]
    sizes = [int(np.prod([p.shape[i] for i in axes])) for axes in (batch, free, contract)]
    return p.transpose(*batch, *free, *contract).reshape(sizes)
