"""Compiled programs of exact moments and calls of them: `FEW`, `SOME` or `MANY` cells side by side."""

from collections.abc import Hashable
from typing import Any

import jax
import numpy as np

from pcbench.engine import runner
from pcbench.moments import program
from pcbench.moments.inputs import Given, own_of, together
from pcbench.moments.merging import mix_of
from pcbench.moments.noise_state import WRITTEN_OUT, form_of
from pcbench.moments.realisations import Realised
from pcbench.moments.types import Found, Shape
from pcbench.runtime import program_cache
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import Layout

FEW, SOME, MANY = 8, 64, 128  # cells a call; of the cart's a cell costs four fifths with 128 of what it does with 64


def compute(ones: list[Realised], recorded: str, every: int = 1, width: int | None = None) -> Found:
    """Return what a batch leaves, [..., FEW, SOME or MANY], with what is recorded at every so many ticks.

    `width` is how many the call is for; None: as few as have room for the batch.
    """
    own, width = own_of(ones[0].problem), width or width_of(ones, set())
    each = _alike([ones[min(i, len(ones) - 1)] for i in range(width)])
    given = together([one.problem for one in each], [one.network for one in each], [one.chance for one in each])
    if ones[0].mode:
        given = given._replace(mix=mix_of([one.mode for one in each]))
    made = _program(each[0], own, width, recorded, every, given)
    return jax.tree.map(np.asarray, made(given))


def width_of(ones: list[Realised], wide: set[Hashable]) -> int:
    """Return how many cells a call for these is for: of a kind that is `wide` already, the last ones go by its program."""
    kind = ones[0].layout, own_of(ones[0].problem)
    if len(ones) <= FEW:
        return FEW
    if len(ones) <= SOME and kind not in wide:
        return SOME
    wide.add(kind)
    return MANY


def _alike(each: list[Realised]) -> list[Realised]:
    """Give the schedules of some cells one shape."""
    slots = max(one.problem.schedule.arrive.shape[1] for one in each)
    early = max(len(one.problem.schedule.early) for one in each)
    notes = max(one.problem.schedule.also.shape[1] for one in each)
    wide = [common_times.pad_early(common_times.pad_slots(one.problem.schedule, slots), early) for one in each]
    wide = [common_times.pad_notes(one, notes) for one in wide]
    return [one._replace(problem=one.problem._replace(schedule=s)) for one, s in zip(each, wide, strict=True)]


def _program(one: Realised, own: tuple[bool, ...], width: int, recorded: str, every: int, given: Given) -> Any:
    leaves, tree = jax.tree.flatten(given)
    key = one.layout, own, width, recorded, every, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)

    def new() -> Any:
        form = form_of(one.layout, one.problem)
        written = width > FEW and not form.flight and form.many <= WRITTEN_OUT
        return _compiled(one.layout, Shape(width, form, own, recorded, every, written), given)

    return _MADE.ask(key, new)


def _compiled(layout: Layout, shape: Shape, given: Given) -> Any:
    """A program for arrays of the shapes of `given`."""
    device = jax.devices()[0]
    options = runner.OPTIONS if device.platform == "cpu" else None
    placed = jax.sharding.SingleDeviceSharding(device)
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype, sharding=placed), given)

    def moments(given: Given) -> Found:
        return program.run(layout, shape, given)

    return jax.jit(moments).lower(shapes).compile(options)


_MADE = program_cache.Programs()
