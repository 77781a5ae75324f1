"""How likely an observer finds the samples of a log, one by one, and how that changes with its free parameters.

    l_i = -1/2 (d_i log 2 pi + log det S_i + nu_i' S_i^-1 nu_i),   the score of sample i is its derivative by the parameters

An observer whose model is true has independent innovations, so the sum of l_i is the log-likelihood of the log (by its
prediction errors). Derivatives go forwards through the replay: there are few parameters, so each sample has its own score, and
no tick is kept. From the parameters to the gains lead the observer's own designs (`gains.optimizers.directions`).
Source: Schweppe, Evaluation of likelihood functions for Gaussian signals, IEEE Trans. Information Theory 11 (1965).
"""

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.gains import optimizers
from pcbench.gains.parameters import Vector
from pcbench.playback import step_block, stream
from pcbench.playback.replay import Asked
from pcbench.playback.setup import Prepared, prepared
from pcbench.runtime import program_cache
from pcbench.synthesis.certificate import power_of_2

MOST = 1 << 22  # ticks of a log that is held in memory


class Recorded(NamedTuple):
    """A log in memory with its one observer; K ticks, S slots."""

    prepared: Prepared
    part: stream.Part
    slots: int


class Found(NamedTuple):
    """Of each sample in the order in which they came: N samples, P parameters."""

    numbers: NDArray[np.float64]  # [N, 4] square, degrees, log_det, signed
    tick: NDArray[np.int64]  # [N] at which it arrived
    score: NDArray[np.float64]  # [N, P]

    @property
    def each(self) -> NDArray[np.float64]:
        """Return l [N]."""
        return -0.5 * (self.numbers[:, 1] * np.log(2 * np.pi) + self.numbers[:, 2] + self.numbers[:, 0])


def recorded(a: Asked) -> Recorded:
    """Return a log in memory, its observer designed; raise UserError where it is too long for that, or does not fit."""
    if a.last >= MOST:
        raise UserError(
            f"{a.log.name}: got {a.last + 1} ticks, expected {MOST} at most to tune on; cut the log, or take a longer tick."
        )
    length = max(power_of_2(a.last + 1), 2)
    room = stream.room(a.log, a.found, a.clock, length, a.last)
    p = prepared(a.cell, room, a.last, a.log.name)
    if a.log.inputs is not None and len(a.log.inputs.names) != p.m:
        raise UserError(
            f"{a.log.name}: inputs: got the columns {', '.join(a.log.inputs.names)}, expected one for each of the plant's "
            f"{p.m} inputs, in their order; mend the table."
        )
    (part,) = stream.parts(a.log, a.found, a.clock, length, a.last, room.slots, p.back, p.m, 0)
    return Recorded(p, part, room.slots)


def evaluator(log: Recorded, design: Callable[[Vector], Any]) -> Callable[[Vector], Found]:
    """Return what finds how likely each sample is at a point of the free parameters; errors as of `design`."""
    p = log.prepared
    ((label, _),) = p.layout.observers
    inputs = p.problem.inputs._replace(rows=log.part.inputs, first=np.asarray(log.part.first - p.back))
    bare = p.problem._replace(inputs=inputs, gains={})

    def at(point: Vector) -> Found:
        gains = design(point)
        ways = optimizers.directions(design, point)
        along = [np.stack(each) for each in zip(*ways, strict=True)]
        leaves, tree = jax.tree.flatten(gains)
        real = tuple(bool(np.issubdtype(np.result_type(a), np.floating)) for a in leaves)
        found = compiled()(p.layout, tree, real, label, log.slots, leaves, along, bare, log.part.window)
        numbers, slopes = (np.asarray(a) for a in found)
        here = numbers[..., 1] > 0
        return Found(numbers[here], log.part.first + np.nonzero(here)[0], slopes[here])

    return at


def _run(
    layout: Any, tree: Any, real: tuple[bool, ...], label: str, slots: int, leaves: Any, along: Any, p: Any, w: Any
) -> tuple[Array, Array]:
    """What is known of each slot [K, S, 4], and its score [K, S, P]; `along` is [P, ...] of each real leaf."""
    ticks, ends = jnp.arange(w.event.shape[0]), jnp.zeros(2, int)
    truth = jnp.zeros((len(ticks), 0))

    def numbers(by: Array) -> tuple[Array, Array]:
        left = iter(along)
        moved = [
            a + jnp.tensordot(by, next(left), 1) if is_real else a for a, is_real in zip(leaves, real, strict=True)
        ]
        problem = p._replace(gains={label: jax.tree.unflatten(tree, moved)})
        state, score = step_block.begun(layout, problem, slots, False, jnp.asarray(0))
        found = step_block.run(layout, problem, state, score, ticks, w, truth, ends)[2].surprise[label]
        return -0.5 * (found[..., 2] + found[..., 0]), found

    many = along[0].shape[0]
    slopes, found = jax.jacfwd(numbers, has_aux=True)(jnp.zeros(many))
    return found, slopes


@cache
def compiled() -> Any:
    """Return `_run` compiled, once for each shape in a process."""
    return program_cache.bounded(_run, (0, 1, 2, 3, 4))
