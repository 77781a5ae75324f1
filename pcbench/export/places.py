"""Entries of an array at computed indices: slices, rows and their replacement.

C reads them from one array. If the entries are in several places, they are copied into one first. Indices beyond the
array are treated as in jax: a slice is moved inside, and a row is clipped, or is NaN (for integers the smallest value).
"""

from collections.abc import Iterable, Sequence

import numpy as np
from jax.lax import GatherScatterMode
from numpy.typing import NDArray

from pcbench.engine import jaxpr_compat
from pcbench.engine.jaxpr_compat import Eqn
from pcbench.export.terms import Entries, Entry, Term, Writer, array_entries, as_c, kind_of, number_entries, place_of

FILL = (GatherScatterMode.FILL_OR_DROP,)


def dynamic_slice(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write a slice with computed start indices."""
    operand, sizes = args[0], tuple(jaxpr_compat.param(eqn, "slice_sizes"))
    starts = [_clip_index(w, a[()], n - m) for a, n, m in zip(args[1:], operand.shape, sizes, strict=True)]
    window = np.stack(np.meshgrid(*map(np.arange, sizes), indexing="ij"), -1) if sizes else np.zeros((0,), int)
    return _read(w, eqn, operand, starts, window)


def dynamic_update_slice(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write a copy of an array, with a slice at computed start indices replaced."""
    operand, update = args[:2]
    starts = [_clip_index(w, a[()], n - m) for a, n, m in zip(args[2:], operand.shape, update.shape, strict=True)]
    if not any(isinstance(s, Term) for s in starts):
        out = operand.copy()
        out[tuple(slice(int(s), int(s) + n) for s, n in zip(starts, update.shape, strict=True))] = update
        return out
    name, first = _copy_operand(w, eqn, operand), _offset(w, operand.shape, starts)
    for i in np.ndindex(update.shape):
        w.say(f"{array_entries(name, (1,), first, _flat_index(operand.shape, i))[0].text} = {as_c(update[i])};")
    return array_entries(name, operand.shape)


def _starts(
    axes: int, indices: Entries, row: tuple[int, ...], places: Iterable[int], batch_axes: Iterable[tuple[int, int]]
) -> list[Entry]:
    """Return the start of a slice: from a row of indices on the axes `places`, and the row's position on batch axes."""
    starts: list[Entry] = [np.int64(0)] * axes
    for column, axis in enumerate(places):
        starts[axis] = indices[(*row, column)]
    for operand_axis, index_axis in batch_axes:
        starts[operand_axis] = np.int64(row[index_axis])
    return starts


def gather(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write slices of an array, each with start indices from a row."""
    operand, indices = args
    d, sizes = jaxpr_compat.param(eqn, "dimension_numbers"), jaxpr_compat.param(eqn, "slice_sizes")
    aval, mode = eqn.outvars[0].aval, jaxpr_compat.param(eqn, "mode")
    out = np.empty(aval.shape, object)
    batch = [i for i in range(len(aval.shape)) if i not in d.offset_dims]
    window_axes = [i for i in range(operand.ndim) if i not in (*d.collapsed_slice_dims, *d.operand_batching_dims)]
    for b in np.ndindex(indices.shape[:-1]):
        batch_axes = zip(d.operand_batching_dims, d.start_indices_batching_dims, strict=True)
        starts = _starts(operand.ndim, indices, b, d.start_index_map, batch_axes)
        limits = [n - s for n, s in zip(operand.shape, sizes, strict=True)]
        condition = _is_inside(w, starts, limits) if mode in FILL else ""
        starts = [_clip_index(w, s, limit) for s, limit in zip(starts, limits, strict=True)]
        shape = tuple(sizes[i] for i in window_axes)
        window = np.zeros((*shape, operand.ndim), int)
        for i in np.ndindex(shape):
            window[i][window_axes] = i
        values = _read(w, eqn, operand, starts, window)
        index: list[slice | int] = [slice(None)] * len(aval.shape)
        for axis, i in zip(batch, b, strict=True):
            index[axis] = i
        values = _or_else(w, eqn, values, condition) if condition else values
        out[tuple(index)] = values if values.ndim else values[()]
    return out


def scatter(w: Writer, eqn: Eqn, args: list[Entries]) -> Entries:
    """Write a copy of an array with slices replaced or added at start indices from rows; those outside are dropped."""
    operand, indices, updates = args
    d, adds = jaxpr_compat.param(eqn, "dimension_numbers"), eqn.primitive.name != "scatter"
    window_axes = [i for i in range(operand.ndim) if i not in (*d.inserted_window_dims, *d.operand_batching_dims)]
    batch = [i for i in range(updates.ndim) if i not in d.update_window_dims]
    sizes = [1] * operand.ndim
    for axis, update_axis in zip(window_axes, d.update_window_dims, strict=True):
        sizes[axis] = updates.shape[update_axis]
    name = _copy_operand(w, eqn, operand)
    for b in np.ndindex(indices.shape[:-1]):
        batch_axes = zip(d.operand_batching_dims, d.scatter_indices_batching_dims, strict=True)
        starts = _starts(operand.ndim, indices, b, d.scatter_dims_to_operand_dims, batch_axes)
        limits = [n - s for n, s in zip(operand.shape, sizes, strict=True)]
        condition = _is_inside(w, starts, limits)
        first = _offset(w, operand.shape, [_clip_index(w, s, limit) for s, limit in zip(starts, limits, strict=True)])
        for i in np.ndindex(*(sizes[axis] for axis in window_axes)):
            index, window = [0] * updates.ndim, np.zeros(operand.ndim, int)
            for axis, k in zip(batch, b, strict=True):
                index[axis] = k
            for axis, k in zip(d.update_window_dims, i, strict=True):
                index[axis] = k
            window[window_axes] = i
            place = array_entries(name, (1,), first, _flat_index(operand.shape, tuple(window)))[0].text
            w.say(f"if ({condition}) {place} {'+=' if adds else '='} {as_c(updates[tuple(index)])};")
    return array_entries(name, operand.shape)


def as_c_array(w: Writer, kind: str, values: Entries) -> Term:
    """Return the first entry of a C array with these entries; writes one if there is none."""
    first: Term = place_of(values) or w.array(kind, values).flat[0]
    return first


def _read(w: Writer, eqn: Eqn, operand: Entries, starts: Sequence[Entry], window: NDArray[np.int64]) -> Entries:
    """Return the entries at `starts` plus the indices on the last axis of `window`."""
    out = np.empty(window.shape[:-1], object)
    if not any(isinstance(s, Term) for s in starts):
        for i in np.ndindex(out.shape):
            out[i] = operand[tuple(int(s) + int(k) for s, k in zip(starts, window[i], strict=True))]
        return out
    if not out.size:
        return out
    array = as_c_array(w, kind_of(eqn.invars[0].aval.dtype), operand)
    first = _offset(w, operand.shape, starts, array.base)
    for i in np.ndindex(out.shape):
        out[i] = array_entries(array.store, (1,), first, array.place + _flat_index(operand.shape, tuple(window[i])))[0]
    return out


def _copy_operand(w: Writer, eqn: Eqn, operand: Entries) -> str:
    """Return the name of a new array with a copy of the operand."""
    name, kind = w.name("a"), kind_of(eqn.invars[0].aval.dtype)
    w.say(f"{kind} {name}[{max(operand.size, 1)}] = {{{', '.join(map(as_c, operand.flat)) or '0'}}};")
    return name


def _clip_index(w: Writer, start: Entry, most: int) -> Entry:
    """Return an index clipped to 0 .. most."""
    if not most:
        return np.int64(0)
    if isinstance(start, Term):
        return w.let("int64_t", f"CLAMPED(0, (int64_t){start.text}, {most})")
    return np.clip(np.int64(start), 0, most)


def _is_inside(w: Writer, starts: Sequence[Entry], limits: list[int]) -> str:
    """Return a condition in C: the indices are in 0 .. limits."""
    conditions = [f"{as_c(s)} >= 0 && {as_c(s)} <= {limit}" for s, limit in zip(starts, limits, strict=True)]
    return w.let("bool", " && ".join(conditions)).text


def _or_else(w: Writer, eqn: Eqn, values: Entries, condition: str) -> Entries:
    """Return the values, or the fill value if the index is outside."""
    aval, fill = eqn.outvars[0].aval, jaxpr_compat.param(eqn, "fill_value")
    kind = kind_of(aval.dtype)
    default = np.nan if kind == "real" else kind == "bool" if kind[0] in "ub" else np.iinfo(aval.dtype).min
    fallback, out = as_c(number_entries(default if fill is None else fill)[()]), np.empty(values.shape, object)
    for i in np.ndindex(values.shape):
        out[i] = w.let(kind, f"{condition} ? {as_c(values[i])} : {fallback}")
    return out


def _flat_index(shape: tuple[int, ...], index: tuple[int, ...]) -> int:
    return int(np.ravel_multi_index(index, shape)) if shape else 0


def _offset(w: Writer, shape: tuple[int, ...], starts: Sequence[Entry], base: str = "") -> str:
    """Return the index in C of the entry at `starts`, relative to a base."""
    strides = [int(np.prod(shape[i + 1 :])) for i in range(len(shape))]
    terms = [f"{as_c(s)} * {stride}" for s, stride in zip(starts, strides, strict=True) if isinstance(s, Term) or s]
    text = " + ".join([*([base] if base else []), *terms])
    return w.let("int64_t", text).text if text else ""
