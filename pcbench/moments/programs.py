"""Compiled programs of exact moments and their calls, of `FEW`, `SOME` or `MANY` grid points side by side."""

from collections.abc import Callable, Hashable

import jax
import numpy as np
from jaxtyping import PyTree

from pcbench.engine import runner
from pcbench.moments.delay_modes import mix_of
from pcbench.moments.error_sums import Sums
from pcbench.moments.events import Shape
from pcbench.moments.inputs import own_of, stack_inputs
from pcbench.moments.noise_state import WRITTEN_OUT, form_of
from pcbench.moments.propagate import Last, MomentRecord, Outcome, run
from pcbench.moments.realisations import Realisation
from pcbench.runtime import program_cache, program_store
from pcbench.simulation.schedule import common_times

RETURNED = (Outcome, Sums, MomentRecord, Last)  # types of a program's results
FEW, SOME, MANY = 8, 64, 128  # grid points per call; with the cart, one costs four fifths with 128 of its cost with 64


def compute(ones: list[Realisation], recorded: str, every: int = 1, width: int | None = None) -> Outcome:
    """Return the results of a batch, [..., FEW, SOME or MANY], recorded every `every` ticks.

    `width` is the number of grid points of the call; None: the smallest that is large enough.
    """
    own, width = own_of(ones[0].problem), width or width_of(ones, set())
    each = _pad_schedules([ones[min(i, len(ones) - 1)] for i in range(width)])
    given = stack_inputs([one.problem for one in each], [one.network for one in each], [one.chance for one in each])
    if modes := [one.mode for one in each if one.mode]:
        given = given._replace(mix=mix_of(modes))
    layout, form = each[0].layout, form_of(each[0].layout, each[0].problem)
    written = width > FEW and not form.flight and form.many <= WRITTEN_OUT
    shape = Shape(width, form, own, recorded, every, written)
    leaves, tree = jax.tree.flatten(given)
    key = layout, shape, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)
    program = _PROGRAMS.ask(
        key, lambda: compile_program(lambda given: run(layout, shape, given), (layout, shape), given, returned=RETURNED)
    )
    outcome: Outcome = jax.tree.map(np.asarray, program(given))
    return outcome


def compile_program(
    f: Callable[..., PyTree], about: object, *given: PyTree, returned: tuple[type, ...] = ()
) -> Callable[..., PyTree]:
    """Return f compiled for arrays shaped like `given`, with the engine's options on a CPU (see `program_store`)."""
    options = runner.OPTIONS if jax.devices()[0].platform == "cpu" else None
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype), given)
    program: Callable[..., PyTree] = program_store.compile_program(f, about, shapes, options, returned)
    return program


def width_of(ones: list[Realisation], wide: set[Hashable]) -> int:
    """Return how many grid points a call has; the last ones of a kind that is `wide` reuse the wide program."""
    kind = ones[0].layout, own_of(ones[0].problem)
    if len(ones) <= FEW:
        return FEW
    if len(ones) <= SOME and kind not in wide:
        return SOME
    wide.add(kind)
    return MANY


def _pad_schedules(each: list[Realisation]) -> list[Realisation]:
    """Return realisations whose schedules are padded to one shape."""
    slots = max(one.problem.schedule.arrive.shape[1] for one in each)
    early = max(len(one.problem.schedule.early) for one in each)
    notes = max(one.problem.schedule.extra_snapshots.shape[1] for one in each)
    wide = [common_times.pad_early(common_times.pad_slots(one.problem.schedule, slots), early) for one in each]
    wide = [common_times.pad_notes(one, notes) for one in wide]
    return [one._replace(problem=one.problem._replace(schedule=s)) for one, s in zip(each, wide, strict=True)]


_PROGRAMS: program_cache.Programs[Callable[..., PyTree]] = program_cache.Programs()
