"""Compiled programs of exact moments and calls of them: `FEW` or `MANY` cells side by side."""

from threading import Lock
from typing import Any

import jax
import numpy as np

from pcbench.moments import program
from pcbench.moments.given import Given, own_of, together
from pcbench.moments.program import Found, Shape
from pcbench.moments.realised import Realised
from pcbench.moments.vector import form_of
from pcbench.simulation import batch
from pcbench.simulation.problem import Layout
from pcbench.simulation.schedule import shared

FEW, MANY = 8, 64  # cells a call; measured on the cart: with 64 a cell costs three quarters of what it does with 128


def compute(ones: list[Realised], recorded: str) -> Found:
    """Return what a batch leaves, [..., FEW or MANY]."""
    width = FEW if len(ones) <= FEW else MANY
    each = _alike([ones[min(i, len(ones) - 1)] for i in range(width)])
    layout, own = each[0].layout, own_of(each[0].problem)
    given = together([one.problem for one in each], [one.network for one in each], [one.chance for one in each])
    made = _program(layout, each[0], own, width, recorded, given)
    return jax.tree.map(np.asarray, made(given))


def _alike(each: list[Realised]) -> list[Realised]:
    """Give the schedules of some cells one shape."""
    slots = max(one.problem.schedule.arrive.shape[1] for one in each)
    early = max(len(one.problem.schedule.early) for one in each)
    notes = max(one.problem.schedule.also.shape[1] for one in each)
    wide = [shared.pad_early(shared.pad_slots(one.problem.schedule, slots), early) for one in each]
    wide = [shared.pad_notes(one, notes) for one in wide]
    return [one._replace(problem=one.problem._replace(schedule=s)) for one, s in zip(each, wide, strict=True)]


_COMPILING = Lock()


def _program(layout: Layout, one: Realised, own: tuple[bool, ...], width: int, recorded: str, given: Given) -> Any:
    leaves, tree = jax.tree.flatten(given)
    with _COMPILING:  # the second thread to ask waits for the first one's program
        key = layout, own, width, recorded, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)
        if key not in _MADE:
            shape = Shape(width, form_of(layout, one.problem), own, recorded)
            lowered = jax.jit(program.run, static_argnums=(0, 1)).lower(layout, shape, given)
            _MADE[key] = lowered.compile(batch.OPTIONS if jax.devices()[0].platform == "cpu" else None)
        return _MADE[key]


_MADE: dict[Any, Any] = {}
