"""Log-likelihood of each sample of a recording for an observer, and its derivative by the free parameters.

    l_i = -1/2 (d_i log 2 pi + log det S_i + nu_i' S_i^-1 nu_i),   score of sample i: its derivative by the parameters

If the observer's model is correct, innovations are independent, and the sum of l_i is the log-likelihood of the recording
(prediction error decomposition). Derivatives are computed forwards through the replay: there are few parameters, so each sample
has its own score, and no tick is stored. Gains follow from the parameters by the observer's designs. A few designs are enough
if gains are affine in the intensities exp z, as for all Kalman filters. Otherwise several designs are needed around every point
(`gains.optimizers.directions`). Source: Schweppe, Evaluation of likelihood functions for Gaussian signals, IEEE Trans.
Information Theory 11 (1965).
"""

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.errors import UserError
from pcbench.gains import optimizers
from pcbench.gains.parameters import LEAST, Vector
from pcbench.playback import step_block, stream
from pcbench.playback.setup import Playback, PlaybackSetup, prepare_observers, room_of
from pcbench.protocols import Leaf
from pcbench.recordings.log import Floats, Ints
from pcbench.recordings.windows import Window
from pcbench.runtime import program_cache
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.synthesis.certificate import power_of_2

MOST = 1 << 22  # largest number of ticks of a recording in memory
BETWEEN = (np.log(LEAST), -np.log(LEAST))  # limits of log intensities, as in `gains.parameters`
AFFINE = 1e-6  # relative deviation of gains that count as affine in the intensities


class SampleLikelihood(NamedTuple):
    """Likelihood of each sample in the order of arrival: N samples, P parameters."""

    numbers: Floats  # [N, 4] square, degrees, log_det, signed
    tick: Ints  # [N] tick of arrival
    score: Floats  # [N, P]

    @property
    def each(self) -> Floats:
        """Return l [N]."""
        return -0.5 * (self.numbers[:, 1] * np.log(2 * np.pi) + self.numbers[:, 2] + self.numbers[:, 0])


def load_recording(a: Playback) -> tuple[PlaybackSetup, stream.Part]:
    """Return the observer of a recording and the recording in memory; raise UserError if it is too long or does not fit."""
    if a.last_tick >= MOST:
        raise UserError(
            f"{a.log.name}: got {a.last_tick + 1} ticks, expected at most {MOST}; cut the log, or take a longer tick."
        )
    a = a._replace(length=max(power_of_2(a.last_tick + 1), 2))
    p = prepare_observers(a, room_of(a))
    (part,) = stream.parts(a, p, [])
    return p, part


class AffineGains(NamedTuple):
    """Gains as a function of P noise intensities."""

    tree: jax.tree_util.PyTreeDef
    real: tuple[bool, ...]  # which leaves are real numbers
    start: list[Leaf]  # each leaf without noise
    slope: list[Floats]  # [P, ...] for each real leaf


def shift_leaves(real: tuple[bool, ...], start: Sequence[Leaf], slope: Sequence[Leaf], by: Leaf) -> list[Leaf]:
    """Return leaves, with by_j slope_j added to the real ones."""
    slopes = iter(slope)
    return [a + jnp.tensordot(by, next(slopes), 1) if is_real else a for a, is_real in zip(start, real, strict=True)]


def affine_gains(design: Callable[[Vector], PyTree], z: Vector) -> AffineGains | None:
    """Return gains as a function of intensities exp z, from designs around a point; None if they are not affine."""
    leaves, tree = jax.tree.flatten(design(z))
    real = tuple(bool(np.issubdtype(np.result_type(a), np.floating)) for a in leaves)

    def at(point: Vector) -> list[Floats]:
        return [np.asarray(a) for a in optimizers.numbers(design(point))]

    v, here = np.exp(z), at(z)
    gains_at_double = [at(z + np.log(2.0) * row) for row in np.eye(len(z))]
    slope = [np.stack([b[i] - a for b in gains_at_double]) / v.reshape(-1, *[1] * a.ndim) for i, a in enumerate(here)]
    start = [a - np.tensordot(v, s, 1) for a, s in zip(here, slope, strict=True)]
    probe = z + np.linspace(-1.0, 1.5, len(z))
    for a, b, s in zip(at(probe), start, slope, strict=True):
        if np.abs(b + np.tensordot(np.exp(probe), s, 1) - a).max(initial=0.0) > AFFINE * np.abs(a).max(initial=0.0):
            return None
    each = iter(start)
    return AffineGains(tree, real, [next(each) if r else a for a, r in zip(leaves, real, strict=True)], slope)


Evaluator = Callable[[Vector], SampleLikelihood]


def evaluator(p: PlaybackSetup, part: stream.Part, design: Callable[[Vector], PyTree]) -> Evaluator:
    """Return a function that computes the likelihood of each sample at given parameters; errors as of `design`."""
    inputs = p.problem.inputs._replace(rows=part.inputs, first=np.asarray(part.first - p.back))
    bare = p.problem._replace(inputs=inputs, gains={})
    affine: list[AffineGains | None] = []

    def at(point: Vector) -> SampleLikelihood:
        if not affine:
            affine.append(affine_gains(design, point))
        if affine[0] is None:
            leaves, tree = jax.tree.flatten(design(point))
            real = tuple(bool(np.issubdtype(np.result_type(a), np.floating)) for a in leaves)
            along = [np.stack(each) for each in zip(*optimizers.directions(design, point), strict=True)]
        else:
            tree, real, start, slope = affine[0]
            v = np.exp(np.clip(point, *BETWEEN))
            leaves = shift_leaves(real, start, slope, v)
            v = np.where(v == np.exp(point), v, 0.0)  # clipped intensities have derivative 0
            along = [v.reshape(-1, *[1] * (s.ndim - 1)) * s for s in slope]
        numbers, slopes = map(np.asarray, jit_likelihood()(p.layout, tree, real, leaves, along, bare, part.window))
        tested = numbers[..., 1] > 0
        return SampleLikelihood(numbers[tested], part.first + np.nonzero(tested)[0], slopes[tested])

    return at


def _run(
    layout: Layout,
    tree: jax.tree_util.PyTreeDef,
    real: tuple[bool, ...],
    leaves: list[Array],
    along: list[Array],
    p: GridPointParams,
    w: Window,
) -> tuple[Array, Array]:
    """Return the innovation numbers of each slot [K, S, 4] and its score [K, S, P]; `along` is [P, ...] for each real leaf."""
    ((label, _),) = layout.observers
    ticks, ends = jnp.arange(w.event.shape[0]), jnp.zeros(2, int)
    truth = jnp.zeros((len(ticks), 0))

    def numbers(by: Array) -> tuple[Array, Array]:
        problem = p._replace(gains={label: jax.tree.unflatten(tree, shift_leaves(real, leaves, along, by))})
        state, score = step_block.init_run(layout, problem, False, jnp.asarray(0))
        state = state if w.variance_ratio is None else step_block.with_variances(state)
        stats = step_block.run(layout, problem, state, score, ticks, w, truth, ends)[2].innovation_stats
        return -0.5 * (stats[..., 2] + stats[..., 0]), stats

    slopes, stats = jax.jacfwd(numbers, has_aux=True)(jnp.zeros(along[0].shape[0]))
    return stats, slopes


@cache
def jit_likelihood() -> Callable[..., tuple[Array, Array]]:
    """Return `_run` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(_run, (0, 1, 2))
