"""Channels, inputs and states as formulas of fields, such as "yaw(pose.orientation)" or "north(lat, 48.1)".

`expression` parses formulas; nothing is executed as code. They are computed in parts: `unwrap` and `diff` keep the last number
of the previous part. Angles are in radians, except lat and lon in degrees.

- `north(lat, lat0)`, `east(lon, lat0, lon0)`: metres from an origin, on the tangent plane of the WGS84 ellipsoid. The error is
  about 0.1 m at 1 km from the origin, and about 10 m at 10 km.
- `yaw(w, x, y, z)` of a quaternion: atan2(2 (w z + x y), 1 - 2 (y^2 + z^2)); `yaw(q)` is `yaw(q.w, q.x, q.y, q.z)`
- `unwrap(x)`, `unwrap(x, period)`: an angle without jumps; the default period is 2 pi
- `diff(x)`: the change since the previous row; the first row has none
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from pcbench import expression
from pcbench.errors import UserError, short
from pcbench.expression import Tree
from pcbench.recordings.log import Columns, Floats

A, E2 = 6378137.0, 0.00669437999014  # of WGS84: equatorial radius [m], eccentricity squared
Function = Callable[..., Floats]


def north(lat: Floats, lat0: Floats) -> Floats:
    """Return metres north of the latitude lat0 [degrees]."""
    radius = A * (1 - E2) / (1 - E2 * np.sin(np.radians(lat0)) ** 2) ** 1.5
    return radius * np.radians(lat - lat0)


def east(lon: Floats, lat0: Floats, lon0: Floats) -> Floats:
    """Return metres east of (lat0, lon0) [degrees]."""
    radius = A / np.sqrt(1 - E2 * np.sin(np.radians(lat0)) ** 2) * np.cos(np.radians(lat0))
    return radius * np.radians((lon - lon0 + 180.0) % 360.0 - 180.0)


def yaw(w: Floats, x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the angle about z of a unit quaternion."""
    return np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


PLAIN: dict[str, tuple[Function, set[int]]] = {  # with the allowed numbers of arguments
    **{name: (getattr(np, name), {1}) for name in ("sin", "cos", "tan", "sqrt", "exp", "log", "abs")},
    **{"atan2": (np.arctan2, {2}), "north": (north, {2}), "east": (east, {3}), "yaw": (yaw, {4})},
}
ARGUMENTS = {name: many for name, (_, many) in PLAIN.items()} | {"unwrap": {1, 2}, "diff": {1}}


class Quantity(NamedTuple):
    """A quantity computed from fields of a recording."""

    fields: list[str]
    evaluator: Callable[[], Callable[[Columns], Floats]]  # returns a function that computes one part after another


def quantity(field: str | None, formula: str | None, scale: float, offset: float, where: str) -> Quantity:
    """Return `scale` times a field or a formula, plus `offset`; raise UserError for none, both or an invalid formula."""
    if (field is None) == (formula is None):
        got = "neither field nor formula" if field is None else "field and formula"
        raise UserError(f'{where}: got {got}, expected one of them; write field = "NAME" or formula = "...".')
    if formula is None:
        return Quantity([str(field)], lambda: lambda part: scale * part[str(field)] + offset)
    try:
        tree = _expand(expression.parse_formula(formula, ARGUMENTS))
        if not (fields := sorted(expression.names(tree) - {"pi"})):
            raise ValueError("a formula of one field at least")
    except ValueError as error:
        raise UserError(f"{where}: formula: got '{short(formula)}', expected {error}; correct it.") from None
    return Quantity(fields, lambda: _evaluator(("+", ("*", scale, tree), offset)))


def _expand(tree: Tree) -> Tree:
    """Return a formula with `yaw(q)` expanded; raise ValueError for a wrong number of arguments."""
    if not isinstance(tree, tuple):
        return tree
    name, arguments = tree[0], tree[1:]
    if name == "yaw" and len(arguments) == 1 and isinstance(q := arguments[0], str):
        arguments = tuple(f"{q}.{axis}" for axis in "wxyz")
    if name in ARGUMENTS and len(arguments) not in ARGUMENTS[name]:
        counts = " or ".join(map(str, sorted(ARGUMENTS[name])))
        raise ValueError(f"{counts} arguments of {name}, not {len(arguments)}")
    return (name, *map(_expand, arguments))


def _evaluator(tree: Tree) -> Callable[[Columns], Floats]:
    """Return a function that computes a formula for one part of a recording after another."""
    last: dict[int, Floats] = {}  # last number of each `unwrap` and `diff`, by the identity of its node

    def evaluate_node(node: Tree, part: Columns) -> Any:
        if not isinstance(node, tuple):
            return (np.pi if node == "pi" else part[node]) if isinstance(node, str) else node
        arguments = [evaluate_node(argument, part) for argument in node[1:]]
        if node[0] in PLAIN:
            return PLAIN[node[0]][0](*arguments)
        if node[0] in expression.OPERATORS:
            return expression.OPERATORS[node[0]](*arguments)
        before, exists = last.get(id(node), np.zeros(0)), np.isfinite(arguments[0])
        row, out = np.concatenate([before, arguments[0][exists]]), np.full(arguments[0].shape, np.nan)
        if node[0] == "unwrap":
            row = np.unwrap(row, period=arguments[1] if len(arguments) > 1 else 2 * np.pi)
            out[exists] = row[len(before) :]
        else:
            out[exists] = np.diff(row, prepend=[np.nan] * (1 - len(before)))
        last[id(node)] = row[-1:]
        return out

    def evaluate(part: Columns) -> Floats:
        shape = next(iter(part.values())).shape
        with np.errstate(all="ignore"):  # users of the result check that it is finite
            return np.broadcast_to(np.asarray(evaluate_node(tree, part), float), shape)

    return evaluate
