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
from pcbench.gains.parameters import MIN_POSITIVE, Vector
from pcbench.playback import step_block, stream
from pcbench.playback.setup import Playback, PlaybackSetup, prepare_observers, room_of
from pcbench.protocols import Leaf
from pcbench.recordings.log import Floats, Ints
from pcbench.recordings.windows import Window
from pcbench.runtime import program_cache
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.synthesis.certificate import power_of_2

MAX_TICKS = 1 << 22  # largest number of ticks of a recording in memory
Z_RANGE = (np.log(MIN_POSITIVE), -np.log(MIN_POSITIVE))  # limits of log intensities, as in `gains.parameters`
AFFINE_TOL = 1e-6  # relative deviation of gains that count as affine in the intensities


class SampleLikelihood(NamedTuple):
    """Likelihood of each sample in the order of arrival: N samples, P parameters."""

    stats: Floats  # [N, 4] nis_sum, dof, log_det, normalized_sum
    tick: Ints  # [N] tick of arrival
    score: Floats  # [N, P]

    @property
    def log_likelihood(self) -> Floats:
        """Return l [N]."""
        return -0.5 * (self.stats[:, 1] * np.log(2 * np.pi) + self.stats[:, 2] + self.stats[:, 0])


def load_recording(playback: Playback) -> tuple[PlaybackSetup, stream.Part]:
    """Return the observer of a recording and the recording in memory; raise UserError if it is too long or does not fit."""
    if playback.last_tick >= MAX_TICKS:
        raise UserError(
            f"{playback.log.name}: got {playback.last_tick + 1} ticks, expected at most {MAX_TICKS}; "
            "cut the log, or use a longer tick."
        )
    playback = playback._replace(length=max(power_of_2(playback.last_tick + 1), 2))
    setup = prepare_observers(playback, room_of(playback))
    (part,) = stream.parts(playback, setup, [])
    return setup, part


class AffineGains(NamedTuple):
    """Gains as a function of P noise intensities."""

    tree: jax.tree_util.PyTreeDef
    real: tuple[bool, ...]  # which leaves are real numbers
    start: list[Leaf]  # each leaf without noise
    slope: list[Floats]  # [P, ...] for each real leaf


def shift_leaves(real: tuple[bool, ...], start: Sequence[Leaf], slope: Sequence[Leaf], v: Leaf) -> list[Leaf]:
    """Return leaves, with amounts_j slope_j added to the real ones."""
    slopes = iter(slope)
    return [a + jnp.tensordot(v, next(slopes), 1) if is_real else a for a, is_real in zip(start, real, strict=True)]


def affine_gains(design: Callable[[Vector], PyTree], z: Vector) -> AffineGains | None:
    """Return gains as a function of intensities exp z, from designs around a point; None if they are not affine."""
    leaves, tree = jax.tree.flatten(design(z))
    real = tuple(bool(np.issubdtype(np.result_type(a), np.floating)) for a in leaves)

    def at(point: Vector) -> list[Floats]:
        return [np.asarray(a) for a in optimizers.numbers(design(point))]

    v, gains = np.exp(z), at(z)
    gains_at_double = [at(z + np.log(2.0) * row) for row in np.eye(len(z))]
    slope = [np.stack([b[i] - a for b in gains_at_double]) / v.reshape(-1, *[1] * a.ndim) for i, a in enumerate(gains)]
    start = [a - np.tensordot(v, s, 1) for a, s in zip(gains, slope, strict=True)]
    probe = z + np.linspace(-1.0, 1.5, len(z))
    for a, b, s in zip(at(probe), start, slope, strict=True):
        if np.abs(b + np.tensordot(np.exp(probe), s, 1) - a).max(initial=0.0) > AFFINE_TOL * np.abs(a).max(initial=0.0):
            return None
    real_starts = iter(start)
    return AffineGains(tree, real, [next(real_starts) if r else a for a, r in zip(leaves, real, strict=True)], slope)


Evaluator = Callable[[Vector], SampleLikelihood]


def evaluator(setup: PlaybackSetup, part: stream.Part, design: Callable[[Vector], PyTree]) -> Evaluator:
    """Return a function that computes the likelihood of each sample at given parameters; errors as of `design`."""
    inputs = setup.problem.inputs._replace(rows=part.inputs, first=np.asarray(part.first - setup.back))
    problem = setup.problem._replace(inputs=inputs, gains={})
    affine: list[AffineGains | None] = []

    def at(point: Vector) -> SampleLikelihood:
        if not affine:
            affine.append(affine_gains(design, point))
        if affine[0] is None:
            leaves, tree = jax.tree.flatten(design(point))
            real = tuple(bool(np.issubdtype(np.result_type(a), np.floating)) for a in leaves)
            directions = [np.stack(rows) for rows in zip(*optimizers.directions(design, point), strict=True)]
        else:
            tree, real, start, slope = affine[0]
            v = np.exp(np.clip(point, *Z_RANGE))
            leaves = shift_leaves(real, start, slope, v)
            v = np.where(v == np.exp(point), v, 0.0)  # clipped intensities have derivative 0
            directions = [v.reshape(-1, *[1] * (s.ndim - 1)) * s for s in slope]
        out = jit_likelihood()(setup.layout, tree, real, leaves, directions, problem, part.window)
        stats, scores = map(np.asarray, out)
        tested = stats[..., 1] > 0
        return SampleLikelihood(stats[tested], part.first + np.nonzero(tested)[0], scores[tested])

    return at


def _stats_and_scores(
    layout: Layout,
    tree: jax.tree_util.PyTreeDef,
    real: tuple[bool, ...],
    leaves: list[Array],
    directions: list[Array],
    p: GridPointParams,
    window: Window,
) -> tuple[Array, Array]:
    """Return the statistics of each packet [K, S, 4 + 2 q] and its score [K, S, P]; `directions` [P, ...] by real leaf."""

    def log_likelihoods(v: Array) -> tuple[Array, Array]:
        gains = jax.tree.unflatten(tree, shift_leaves(real, leaves, directions, v))
        stats = innovation_stats(layout, p, gains, window)
        return -0.5 * (stats[..., 2] + stats[..., 0]), stats

    scores, stats = jax.jacfwd(log_likelihoods, has_aux=True)(jnp.zeros(directions[0].shape[0]))
    return stats, scores


def innovation_stats(layout: Layout, p: GridPointParams, gains: PyTree, window: Window) -> Array:
    """Return the innovation statistics of each packet in a window, from tick 0 on, as in `step_block.TickOutputs`."""
    ((label, _),) = layout.observers
    problem, ticks = p._replace(gains={label: gains}), jnp.arange(window.event.shape[0])
    run, _ = step_block.init_run(layout, problem, False, jnp.asarray(0))
    run = run if window.variance_ratio is None else step_block.with_variances(run)
    truth, ends = jnp.zeros((len(ticks), 0)), jnp.zeros(2, int)
    return step_block.run_block(layout, problem, run, None, ticks, window, truth, ends)[2].innovation_stats


@cache
def jit_likelihood() -> Callable[..., tuple[Array, Array]]:
    """Return `_stats_and_scores` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(_stats_and_scores, (0, 1, 2))
