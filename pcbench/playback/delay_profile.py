"""Profile likelihood of a recording over the delays of its channels: for each delay, the noise that maximises the likelihood.

    l_p(j) = max over z of l(j, z)

with j the additional age of each channel's samples in ticks, and z the logarithms of the noise intensities. l is that of
`likelihood`, with every sample used at the tick at which it was taken. The joint density of all samples does not depend on
their order of arrival. So for `kf` this is the likelihood of the replay; a linearising observer has slightly different
operating points. No sample is then in flight or used twice, which is much faster.

Gains are affine in the intensities v = exp z, so one design per intensity is enough. Score and information of all samples
follow by forward differentiation. All intensities are first multiplied by the NIS. Then z moves by damped BFGS steps that start
as Fisher scoring, with s the variance and nu the innovation of a number:

    z <- z + (B + D)^-1 dl/dz,   B = sum dlog s dlog s' / 2 + dnu dnu' / s at first

One program computes LANES delays side by side. All delays use the same samples: those that some delay moves out of the
recording are left out. Source: Harvey, Forecasting, structural time series models and the Kalman filter, 1989, (3.4.69), for
the information.
"""

from collections.abc import Callable, Iterator
from functools import cache
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.gains.parameters import Vector
from pcbench.playback import likelihood, step_block, stream
from pcbench.playback.likelihood import AffineGains
from pcbench.playback.setup import Playback, PlaybackSetup, prepare_observers
from pcbench.recordings.log import Batch, Floats, Ints, Log
from pcbench.recordings.windows import Room, Window, blocks, window
from pcbench.runtime import program_cache
from pcbench.runtime.progress import Progress
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.synthesis.certificate import power_of_2

LANES = 16  # delays per call
MAX_LANE_TICKS = 1 << 22  # largest product of ticks and lanes
MAX_ITERATIONS = 30  # steps of z for one delay
MAX_STEP = 2.0  # largest step of z
CONVERGED = 0.01  # a search ends if the next step adds less to the log-likelihood
CONVERGED_REL = 0.003  # or less than this share of the distance to the best delay
HOPE, FAR = 10.0, 30.0  # a delay is abandoned if HOPE times the expected gain leaves it FAR below the best
MIN_DAMPING = 1e-3  # smallest damping of a step
Delays = tuple[int, ...]  # ticks by channel


class Best(NamedTuple):
    """A delay with its most likely noise."""

    value: float  # l_p
    z: Vector


class Profile:
    """The profile likelihood of one recording, with a cache."""

    def __init__(
        self,
        playback: Playback,
        low: Ints,
        high: Ints,
        gains_of: Callable[[PlaybackSetup], tuple[AffineGains, Vector]],
        progress: Progress,
    ) -> None:
        """Prepare a recording for delays of `low` to `high` [q] ticks; `gains_of` returns an observer's gains and z."""
        length = max(power_of_2(playback.last_tick + 1), 2)
        if playback.last_tick >= likelihood.MAX_TICKS:
            likelihood.load_recording(playback)  # raises UserError for an unsuitable recording
        self.playback, self.low, self.high, self.progress = playback._replace(length=length), low, high, progress
        self.batches = list(playback.log.measurements())
        self.lanes = max(min(LANES, MAX_LANE_TICKS // length), 1)
        no_delays = (0,) * len(low)
        log = self._log(no_delays)
        longest = max(c.intervals.most if c.intervals.many else 0.0 for c in playback.survey.channels.values())
        gap = int(max(longest / playback.clock.dt, high.max() - low.min())) + 2
        setup = prepare_observers(self.playback._replace(log=log), Room(longest_gap=gap))
        (part,) = stream.parts(self.playback._replace(log=log), setup, [])
        self.gains, self.start = gains_of(setup)
        inputs = setup.problem.inputs._replace(rows=part.inputs, first=np.asarray(part.first - setup.back))
        self.setup, self.problem = setup, setup.problem._replace(inputs=inputs, gains={})
        self.samples = int(part.window.mask.sum())
        self.cache: dict[Delays, Best] = {}

    def _log(self, delays: Delays) -> Log:
        """Return the samples that no delay moves out of the recording, each arriving when it was taken."""
        dt, clock = self.playback.clock.dt, self.playback.clock
        first, last = max(self.high.max(), 0), self.playback.last_tick + min(self.low.min(), 0)
        shift = np.array(delays) * dt

        def measurements() -> Iterator[Batch]:
            for b in self.batches:
                ticks, stamps = clock.ticks(b.sampled), b.sampled - shift[b.channel]
                exists = np.isfinite(b.arrived) & (ticks >= first) & (ticks <= last)
                if exists.any():
                    yield b._replace(sampled=stamps, arrived=stamps).select(exists)

        return self.playback.log._replace(measurements=measurements)

    def _window(self, delays: Delays) -> Window:
        recording = self.playback
        (block,) = blocks(self._log(delays), recording.survey, recording.clock, recording.length, recording.last_tick)
        return window(block, len(self.low), 1, 0, self.setup.variances)[0]

    @property
    def best(self) -> Delays:
        """Return the most likely delays so far."""
        return max(self.cache, key=lambda delays: self.cache[delays].value)

    def ask(self, points: list[Delays]) -> list[float]:
        """Return l_p at some delays."""
        new = [delays for delays in dict.fromkeys(points) if delays not in self.cache]
        for i in range(0, len(new), self.lanes):
            group = new[i : i + self.lanes]
            self.progress.begin("delays", len(group))
            z = self.cache[self.best].z if self.cache else self.start
            for delays, fit in zip(group, self._maximise(group, z), strict=False):
                self.cache[delays] = fit
            self.progress.step(len(group))
        return [self.cache[delays].value for delays in points]

    def _maximise(self, points: list[Delays], start: Vector) -> list[Best]:
        """Return the most likely z of each of some delays, by steps that are damped until the likelihood rises."""
        windows = [self._window(delays) for delays in points]
        windows += windows[:1] * (self.lanes - len(windows))
        stack = jax.tree.map(lambda *a: np.stack(a), *windows)

        def evaluate(z: Vector) -> tuple[Vector, Vector, Vector, Vector]:
            g, p = self.gains, self.setup
            out = jit_lanes()(p.layout, g.tree, g.real, g.start, g.slope, self.problem, z, stack)
            value, score, information, nis = map(np.array, out)
            return np.where(np.isfinite(value), value, -np.inf), score, information, nis

        nis = evaluate(np.tile(start, (self.lanes, 1)))[3]
        # intensities multiplied by the NIS
        z = np.clip(start + np.log(np.where(nis > 0, nis, 1.0))[:, None], *likelihood.Z_RANGE)
        value, score, B, _ = evaluate(z)  # B: curvature of -l
        damping = np.ones(self.lanes)  # of the step
        for _ in range(MAX_ITERATIONS):
            eigenvalues, eigenvectors = np.linalg.eigh(B)
            along = np.einsum("lij,li->lj", eigenvectors, score)
            along /= np.maximum(eigenvalues, 1e-9 * eigenvalues[:, -1:] + 1e-300)
            # an ascent direction, also after clipping
            step = np.einsum("lij,lj->li", eigenvectors, np.clip(along, -MAX_STEP, MAX_STEP))
            step = np.clip(z + step, *likelihood.Z_RANGE) - z
            gain = (0.5 * score * step).sum(1)
            below = max([fit.value for fit in self.cache.values()] + [value.max()]) - value
            is_converged = gain < CONVERGED + CONVERGED_REL * below
            if np.all(is_converged | (HOPE * gain < below - FAR) | (damping < MIN_DAMPING)):
                break
            step *= damping[:, None]
            trial = evaluate(z + step)
            is_ascent = (trial[0] > value)[:, None]
            B = _bfgs(B, step, score - trial[1], np.where(is_ascent[..., None], trial[2], B))
            damping = np.where(is_ascent[:, 0], np.minimum(4 * damping, 1.0), damping / 4)
            z, score = np.where(is_ascent, z + step, z), np.where(is_ascent, trial[1], score)
            value = np.maximum(value, trial[0])
            self.progress.step(0)
        return [Best(float(v), point) for v, point in zip(value, z, strict=True)]


def _bfgs(B: Floats, s: Floats, y: Floats, otherwise: Floats) -> Floats:
    """Return curvatures [L, P, P] updated by steps s [L, P] that changed slopes by y; `otherwise` if not convex."""
    sy, Bs = (s * y).sum(1), np.einsum("lij,lj->li", B, s)
    sBs = (s * Bs).sum(1)
    convex = (sy > 1e-3 * sBs) & (sBs > 0)
    sy, sBs = np.where(convex, sy, 1.0), np.where(convex, sBs, 1.0)
    new = B + np.einsum("li,lj->lij", y, y) / sy[:, None, None] - np.einsum("li,lj->lij", Bs, Bs) / sBs[:, None, None]
    return np.where(convex[:, None, None], new, otherwise)


def _lanes(
    layout: Layout,
    tree: jax.tree_util.PyTreeDef,
    real: tuple[bool, ...],
    start: list[Array],
    slope: list[Array],
    p: GridPointParams,
    z: Array,
    windows: Window,
) -> tuple[Array, Array, Array, Array]:
    """Return log-likelihood [L], score [L, P], information [L, P, P] and NIS [L] at z [L, P]."""

    def lane(z: Array, w: Window) -> tuple[Array, Array, Array, Array]:
        def packet_stats(z: Array) -> tuple[Array, Array]:
            gains = jax.tree.unflatten(tree, likelihood.shift_leaves(real, start, slope, jnp.exp(z)))
            stats = likelihood.innovation_stats(layout, p, gains, w)
            stats = jnp.where((stats[..., 1:2] > 0) & ~jnp.isnan(stats), stats, 0.0).reshape(-1, stats.shape[-1])
            return stats, stats

        J, stats = jax.jacfwd(packet_stats, has_aux=True)(z)
        nu = slice(step_block.N_STATS, step_block.N_STATS + len(p.params))
        nis_sum, dof, log_det, z_by_channel = stats[:, 0], stats[:, 1], stats[:, 2], stats[:, nu]
        dlog_s = J[:, 2] / jnp.maximum(dof, 1.0)[:, None]  # by z
        dnu = (J[:, nu] + 0.5 * z_by_channel[..., None] * dlog_s[:, None]).reshape(-1, len(z))  # divided by sqrt(s)
        return (
            -0.5 * (np.log(2 * np.pi) * dof.sum() + log_det.sum() + nis_sum.sum()),
            -0.5 * (J[:, 2] + J[:, 0]).sum(0),
            0.5 * dlog_s.T @ J[:, 2] + dnu.T @ dnu,
            nis_sum.sum() / dof.sum(),
        )

    return jax.vmap(lane)(z, windows)  # type: ignore[no-any-return]


@cache
def jit_lanes() -> Callable[..., tuple[Array, Array, Array, Array]]:
    """Return `_lanes` compiled, once for each shape in a process."""
    return program_cache.jit_with_limit(_lanes, (0, 1, 2))
