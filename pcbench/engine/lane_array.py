"""Arrays that differ between runs: each entry is stored separately, as an array [L] over the lanes.

Compiled loops are fastest on arrays [L] with lanes last: no transposes and no copies. A value common to all lanes stays an
ordinary array and is computed once. A long table that is accessed by row (a ring) is stored with its rows together: one array
[rows, L] per entry of a row. `interpreter` evaluates functions of one lane on these forms.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import PyTree

SAME, ENTRIES, TABLE = range(3)  # forms of a value: common to all lanes; a LaneArray by entries; a LaneArray as a table


@jax.tree_util.register_pytree_node_class
class LaneArray:
    """A one-lane array of any shape: `parts` is an object array of that shape, of entries [L].

    A *table*, [rows, *shape], has `rows` and parts of that shape, of entries [rows, L].
    """

    def __init__(self, parts: np.ndarray, rows: int | None = None) -> None:
        self.parts, self.rows = parts, rows

    def tree_flatten(self) -> tuple[tuple[PyTree, ...], tuple[tuple[int, ...], int | None]]:
        """Return the entries in row-major order, and the shape."""
        return tuple(self.parts.flat), (self.parts.shape, self.rows)

    @classmethod
    def tree_unflatten(cls, form: tuple[tuple[int, ...], int | None], leaves: PyTree) -> "LaneArray":
        """Return a LaneArray of this shape from its entries in row-major order."""
        return lanes_of(form[0], leaves, form[1])

    @property
    def shape(self) -> tuple[int, ...]:
        """The one-lane shape."""
        return self.parts.shape if self.rows is None else (self.rows, *self.parts.shape)

    @property
    def dtype(self) -> PyTree:
        """The type of every entry."""
        return self.parts.flat[0].dtype


def lanes_of(shape: tuple[int, ...], entries: PyTree, rows: int | None = None) -> LaneArray:
    """Return a LaneArray of a shape from its entries in row-major order."""
    parts = np.empty(shape, object)
    for i, entry in zip(np.ndindex(shape), entries, strict=True):
        parts[i] = entry
    return LaneArray(parts, rows)


def is_lanes(x: PyTree) -> bool:
    """Return whether x differs between lanes (a leaf test for tree functions)."""
    return isinstance(x, LaneArray)


def split(x: jax.Array) -> LaneArray:
    """Return a LaneArray from an array [*shape, L]."""
    flat = x.reshape(-1, x.shape[-1])
    return lanes_of(x.shape[:-1], [lax.index_in_dim(flat, i, keepdims=False) for i in range(len(flat))])


def join(x: LaneArray) -> jax.Array:
    """Return the array [*shape, L] of a LaneArray."""
    parts, at = list(x.parts.flat), 0 if x.rows is None else 1
    return jnp.stack(parts, at).reshape(*x.shape, parts[0].shape[-1])


def table(x: PyTree) -> PyTree:
    """Return a LaneArray [rows, *shape] as a table; an ordinary array is unchanged."""
    if not is_lanes(x) or x.rows is not None:
        return x
    shape = x.parts.shape[1:]
    return lanes_of(shape, [jnp.stack(list(x.parts[:, *i])) for i in np.ndindex(shape)], len(x.parts))


def entries(x: PyTree) -> PyTree:
    """Return a LaneArray by entries; an ordinary array is unchanged."""
    if not is_lanes(x) or x.rows is None:
        return x
    return lanes_of(x.shape, [part[k] for k in range(x.rows) for part in x.parts.flat])


def to_array(x: PyTree, width: int) -> jax.Array:
    """Return one array with lanes last; an ordinary array is repeated per lane. The results of a scan have its axis first."""
    if not is_lanes(x):
        return jnp.broadcast_to(x[..., None], (*x.shape, width))
    parts = list(x.parts.flat)
    return jnp.stack(parts, -2) if x.parts.ndim else parts[0]


def broadcast(x: jax.Array, width: int) -> LaneArray:
    """Return a LaneArray with the same array in all lanes."""
    x = jnp.asarray(x)
    return lanes_of(x.shape, [jnp.broadcast_to(x[i], (width,)) for i in np.ndindex(x.shape)])


def broadcast_table(x: jax.Array, width: int) -> LaneArray:
    """Return a table with the same array in all lanes."""
    shape, rows = x.shape[1:], x.shape[0]
    return lanes_of(shape, [jnp.broadcast_to(x[:, *i, None], (rows, width)) for i in np.ndindex(shape)], rows)


def form_of(x: PyTree) -> int:
    """Return the form of a value."""
    return SAME if not is_lanes(x) else ENTRIES if x.rows is None else TABLE


def to_form(x: PyTree, form: int, width: int) -> PyTree:
    """Return a value in a form at least as general as its own."""
    if form == TABLE:
        return table(x) if is_lanes(x) else broadcast_table(x, width)
    return entries(x) if is_lanes(x) else broadcast(x, width) if form else x


def match_form(tree: PyTree, template: PyTree, width: int) -> PyTree:
    """Return the tree with the forms of the template: an ordinary array becomes a LaneArray or a table as in the template."""
    return jax.tree.map(
        lambda t, x: to_form(x, form_of(t), width) if is_lanes(t) else x, template, tree, is_leaf=is_lanes
    )


def pick(tree: PyTree, lane: jax.Array) -> PyTree:
    """Return the lanes with the numbers `lane`; values common to all lanes are unchanged."""

    def one(x: PyTree) -> PyTree:
        return jax.tree.map(lambda a: a.at[..., lane].get(mode="clip"), x) if is_lanes(x) else x

    return jax.tree.map(one, tree, is_leaf=is_lanes)


def put_back(tree: PyTree, some: PyTree, lane: jax.Array) -> PyTree:
    """Write extracted lanes back to their places; a number beyond the last lane is ignored."""

    def one(x: PyTree, new: PyTree) -> PyTree:
        return jax.tree.map(lambda a, b: a.at[..., lane].set(b, mode="drop"), x, new) if is_lanes(x) else x

    return jax.tree.map(one, tree, some, is_leaf=is_lanes)
