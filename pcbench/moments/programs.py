"""Compiled programs of exact moments and their calls, of `FEW`, `SOME` or `MANY` grid points side by side."""

from collections.abc import Callable, Hashable

import jax
import numpy as np
from jaxtyping import PyTree

from pcbench.engine import runner
from pcbench.moments.delay_modes import mix_of
from pcbench.moments.error_sums import Sums
from pcbench.moments.events import Shape
from pcbench.moments.inputs import MomentInputs, is_per_cell, stack_inputs
from pcbench.moments.noise_state import MOST_ENTRYWISE, form_of
from pcbench.moments.propagate import FinalCovariances, MomentRecord, Outcome, run
from pcbench.moments.realisations import Realisation
from pcbench.runtime import program_cache, program_store
from pcbench.simulation.schedule import common_times

RESULT_TYPES = (Outcome, Sums, MomentRecord, FinalCovariances)  # types of a program's results
FEW, SOME, MANY = 8, 64, 128  # grid points per call; with the cart, one costs four fifths with 128 of its cost with 64


def compute(realisations: list[Realisation], record: str, interval: int = 1, width: int | None = None) -> Outcome:
    """Return the results of a batch, [..., FEW, SOME or MANY], recorded every `every` ticks.

    `width` is the number of grid points of the call; None: the smallest that is large enough.
    """
    per_cell, width = is_per_cell(realisations[0].problem), width or width_of(realisations, set())
    padded = _pad_schedules([realisations[min(i, len(realisations) - 1)] for i in range(width)])
    inputs = stack_inputs(
        [realisation.problem for realisation in padded],
        [realisation.network for realisation in padded],
        [realisation.chance for realisation in padded],
    )
    if modes := [realisation.mode for realisation in padded if realisation.mode]:
        inputs = inputs._replace(mix=mix_of(modes))
    layout, form = padded[0].layout, form_of(padded[0].layout, padded[0].problem)
    entrywise = width > FEW and not form.flight and form.size <= MOST_ENTRYWISE
    shape = Shape(width, form, per_cell, record, interval, entrywise)
    leaves, tree = jax.tree.flatten(inputs)
    key = layout, shape, tree, tuple((np.shape(a), np.asarray(a).dtype) for a in leaves)

    def run_batch(inputs: MomentInputs) -> Outcome:
        return run(layout, shape, inputs)

    program = _PROGRAMS.ask(key, lambda: compile_program(run_batch, (layout, shape), inputs, result_types=RESULT_TYPES))
    outcome: Outcome = jax.tree.map(np.asarray, program(inputs))
    return outcome


def compile_program(
    f: Callable[..., PyTree], about: object, *args: PyTree, result_types: tuple[type, ...] = ()
) -> Callable[..., PyTree]:
    """Return f compiled for arrays shaped like `args`, with the engine's options on a CPU (see `program_store`)."""
    options = runner.OPTIONS if jax.devices()[0].platform == "cpu" else None
    shapes = jax.tree.map(lambda a: jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype), args)
    program: Callable[..., PyTree] = program_store.compile_program(f, about, shapes, options, result_types)
    return program


def width_of(realisations: list[Realisation], wide: set[Hashable]) -> int:
    """Return how many grid points a call has; the last ones of a kind that is `wide` reuse the wide program."""
    kind = realisations[0].layout, is_per_cell(realisations[0].problem)
    if len(realisations) <= FEW:
        return FEW
    if len(realisations) <= SOME and kind not in wide:
        return SOME
    wide.add(kind)
    return MANY


def _pad_schedules(realisations: list[Realisation]) -> list[Realisation]:
    """Return realisations whose schedules are padded to one shape."""
    slots = max(realisation.problem.schedule.arrive.shape[1] for realisation in realisations)
    n_early = max(len(realisation.problem.schedule.early) for realisation in realisations)
    snapshots = max(realisation.problem.schedule.extra_snapshots.shape[1] for realisation in realisations)
    schedules = [
        common_times.pad_early(common_times.pad_slots(realisation.problem.schedule, slots), n_early)
        for realisation in realisations
    ]
    schedules = [common_times.pad_snapshots(schedule, snapshots) for schedule in schedules]
    return [
        realisation._replace(problem=realisation.problem._replace(schedule=s))
        for realisation, s in zip(realisations, schedules, strict=True)
    ]


_PROGRAMS: program_cache.Programs[Callable[..., PyTree]] = program_cache.Programs()
