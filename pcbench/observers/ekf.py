"""ekf: the extended Kalman filter by re-propagation from the measurement's own time.

State z = (x, p): the plant's state and what is unknown beside it (parameters, unknown inputs), which walk at random. At the
arrival of a sample taken at t_m: tick by tick from the posterior of the sample before it,

    P <- F P F' + Q,  F = I + h J(z, u),  J the Jacobian (jax),    z <- one Runge-Kutta step under the tick's input

then the update at t_m in Joseph form, one channel after the other (where y is not linear in z, by its Jacobian at the
prediction), then the mean alone rolls forward to now under the stored inputs, and flows on. p is clipped to the plant's range
after every update and tick. Where the model is linear the tick is its exact map, F its matrix, and the filter is `dkf` done
tick by tick; where a plant is given by its step, that is the tick, F its Jacobian.

R is the variance of one sample, P0 = diag(prior_std^2, unknown_std^2), Q what the scenario has designers assume for the states,
and walk unknown_std^2 h for p. Time index: the estimate is of now, after the jump. A sample from before t = 0 has measured the
start. One that comes after a newer one is put in its place (`parts/reordering`). With `gate` or `huber` a sample that is far
from what is expected is left out, or weighed less (`parts/guard`).
Not claimed: optimality, nor that a parameter can be found where the motion does not show it.
Source: Jazwinski, Stochastic Processes and Filtering Theory, 1970, chapter 8.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array, lax
from jaxtyping import Float, Int

from pcbench.dynamics import linear
from pcbench.observers.parts import assumed_noise, guard, kalman, one_tick, reordering
from pcbench.observers.parts.guard import Known
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.options import tunable
from pcbench.observers.parts.reordering import Buffer, Measurement
from pcbench.protocols import Arrival, Leaf, Now, Observer, Room, Surprise
from pcbench.synthesis.certificate import Certificate, Design, Setting


class Gains(NamedTuple):
    """n states, s unknowns, N = n + s, q outputs."""

    motion: Any  # (now, z[N]) -> z[N] one tick later
    sensor: Any  # (now, x[n], p[s]) -> y[q]; None: C x, D u
    slope: Any  # (now, z[N]) -> F[N, N]
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, " q"]  # variance of one sample
    mix: Any  # [q, q] of the outputs, so that their noise is independent; None: it is
    Q: Float[Leaf, "N N"]  # a tick
    P0: Float[Leaf, "N N"]
    start: Float[Leaf, " s"]  # p at t = 0
    low: Float[Leaf, " s"]
    high: Float[Leaf, " s"]
    room: Room  # for samples that may be overtaken
    guard: Any = ()  # guard.Guard, of a filter that does not take every sample for what it says


class Memory(NamedTuple):
    """The samples that may be overtaken with the posterior before them, and the mean of now."""

    buffer: Buffer
    z: Float[Array, " N"]


class Options(assumed_noise.Options):
    """What the filter assumes."""

    gate: float | None = guard.GATE
    gate_opens: int = guard.OPENS
    huber: float | None = guard.HUBER
    walk: float = tunable(1.0, ge=0, description="how far unknowns walk: variance over the square of their size [1/s]")


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Start from the prior: xhat(0), p at its start, P0."""
    z, q = jnp.concatenate([xhat0, gains.start]), gains.C.shape[0]
    first = guard.begun(Posterior(z, gains.P0, jnp.asarray(0)), gains.guard, q)
    return Memory(reordering.start(first, gains.room, q, 0), z)


def note(gains: Gains, memory: Memory, now: Now) -> Float[Array, "0"]:
    """Note nothing: the inputs are stored."""
    return jnp.zeros(0)


def within(gains: Gains, z: Float[Array, " N"]) -> Float[Array, " N"]:
    """Return z with p clipped to its range."""
    s = gains.start.shape[0]
    return jnp.concatenate([z[: z.shape[0] - s], jnp.clip(z[z.shape[0] - s :], gains.low, gains.high)]) if s else z


def at(now: Now, tick: Int[Array, ""]) -> Now:
    """Return the present as it was at an earlier tick, with the input held from there."""
    return now._replace(t=tick * now.dt, tick=tick, u=now.past_u(now.tick - tick))


def carried(gains: Gains, now: Now, before: Known, until: Int[Array, ""]) -> tuple[Array, Array]:
    """Return mean and covariance carried on to a tick, one by one."""

    def tick(k: Array, carry: tuple[Array, Array]) -> tuple[Array, Array]:
        (z, P), there = carry, at(now, k)
        F = gains.slope(there, z)
        return within(gains, gains.motion(there, z)), F @ P @ F.T + gains.Q

    return lax.fori_loop(before.taken, until, tick, (before.mean, before.P))


def update(gains: Gains, now: Now, before: Known, sample: Measurement) -> Known:
    """Carry mean and covariance to the sample's own time and update there, channel by channel."""
    z, P = carried(gains, now, before, sample.taken)
    value = sample.value if gains.mix is None else gains.mix @ sample.value
    if gains.sensor is not None:
        z, P, left_out = by_slope(gains, at(now, sample.taken), before._replace(mean=z, P=P), sample.fresh, value)
        return guard.after(before, within(gains, z), P, sample.taken, left_out)
    left_out = []
    n, none = gains.C.shape[1], jnp.zeros(gains.start.shape[0])
    for channel in range(gains.C.shape[0]):
        c, r, fresh = gains.C[channel], gains.R[channel], sample.fresh[channel]
        Pc = P[:, :n] @ c
        nu = value[channel] - c @ z[:n]
        found = guard.looked(gains.guard, before, channel, nu, c @ Pc[:n] + r, r, fresh)
        K = kalman.gain(Pc, c @ Pc[:n] + found.r, found.used)
        z = z + K * nu
        P = kalman.covariance(P, K, jnp.concatenate([c, none]), found.r)
        left_out.append(found.left_out)
    return guard.after(before, within(gains, z), P, sample.taken, left_out)


def sensed(gains: Gains, there: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return what a sensor that is not linear gives at z, [q], and its Jacobian, [q, N]."""
    n = gains.C.shape[1]

    def output(z: Array) -> Array:
        y = gains.sensor(there, z[:n], z[n:])
        return y if gains.mix is None else gains.mix @ y

    return output(z), jax.jacfwd(output)(z)


def seen(gains: Gains, there: Now, z: Float[Array, " N"]) -> tuple[Array, Array]:
    """Return what is expected of a sample at z, [q], and its slope, [q, N]."""
    if gains.sensor is not None:
        return sensed(gains, there, z)
    C = jnp.concatenate([gains.C, jnp.zeros((gains.C.shape[0], gains.start.shape[0]))], axis=1)
    return C @ z, C


def by_slope(gains: Gains, there: Now, before: Any, fresh: Array, value: Array) -> tuple[Array, Array, list[Array]]:
    """Update by a sensor that is not linear: its output and its Jacobian are those of the predicted z."""
    z = predicted = before.mean
    P, left_out = before.P, []
    y, C = sensed(gains, there, z)
    for channel in range(gains.C.shape[0]):
        c, r = C[channel], gains.R[channel]
        Pc = P @ c
        nu = value[channel] - y[channel] - c @ (z - predicted)
        found = guard.looked(gains.guard, before, channel, nu, c @ Pc + r, r, fresh[channel])
        K = kalman.gain(Pc, c @ Pc + found.r, found.used)
        z = z + K * nu
        P = kalman.covariance(P, K, c, found.r)
        left_out.append(found.left_out)
    return z, P, left_out


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Put what arrived in its place, and roll the mean forward to now."""
    sample = reordering.sample_of(now, arrival, gains.D)
    buffer, newest = reordering.replay(lambda state, sample: update(gains, now, state, sample), memory.buffer, sample)
    z = lax.fori_loop(newest.taken, now.tick, lambda k, z: within(gains, gains.motion(at(now, k), z)), newest.mean)
    return Memory(buffer, z)


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Move the mean by one tick."""
    return memory._replace(z=within(gains, gains.motion(now, memory.z)))


def estimate(gains: Gains, memory: Memory) -> Float[Array, " N"]:
    """Return xhat of now, and the unknowns."""
    return memory.z


def newest(gains: Gains, memory: Memory, now: Now) -> Known:
    """Return mean and covariance at the newest sample used."""
    return reordering.newest(lambda state, sample: update(gains, now, state, sample), memory.buffer)


def covariance(gains: Gains, memory: Memory, now: Now) -> Float[Array, "N N"]:
    """Return what the filter believes of its error now: P at the newest sample used, by the slopes of every tick since."""
    return carried(gains, now, newest(gains, memory, now), now.tick)[1]


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Surprise:
    """Return how far what arrives is from what was expected of it; what is older than the newest is not judged."""
    before, sample = newest(gains, memory, now), reordering.sample_of(now, arrival, gains.D)
    z, P = carried(gains, now, before, sample.taken)
    value = sample.value if gains.mix is None else gains.mix @ sample.value
    (y, C), predicted = seen(gains, at(now, sample.taken), z), z
    total, fresh = kalman.unjudged(), sample.fresh & (sample.taken >= before.taken)
    for channel in range(C.shape[0]):
        c, r = C[channel], gains.R[channel]
        nu, s = value[channel] - y[channel] - c @ (z - predicted), c @ P @ c + r
        total = kalman.judged(total, nu, s, fresh[channel])
        K = kalman.gain(P @ c, s, fresh[channel])
        z, P = z + K * nu, kalman.covariance(P, K, c, r)
    return total


OBSERVER = Observer(init, note, jump, flow, estimate, covariance=covariance, innovation=innovation)


def design(setting: Setting, options: Options) -> Design:
    """Gather what the filter assumes; there is no certificate for a nonlinear model."""
    n, s, where = len(setting.model.A), len(setting.unknown_std), f"ekf in {setting.scenario}"
    motion, tangent = one_tick.motion_of(setting)
    size = np.square(setting.unknown_std)
    P0, Q = np.zeros((n + s, n + s)), np.zeros((n + s, n + s))
    P0[:n, :n], P0[n:, n:] = setting.P0, np.diag(size)
    q = assumed_noise.through(options.q, setting.model.B.shape[1], setting.input_intensity, where)
    own = assumed_noise.process(setting, options.Q, where)
    Q[:n, :n] = own + linear.input_noise(setting.model, q, setting.dt)
    Q[n:, n:] = np.diag(options.walk * size * setting.dt)
    mix, C, R = assumed_noise.independent(setting, options.R, setting.model.C, where)
    low, high = np.array(setting.unknown_range).T.reshape(2, s)
    gains = Gains(
        motion=motion,
        slope=tangent,
        sensor=setting.sensor,
        C=C,
        D=setting.model.feedthrough * (setting.sensor is None),  # a sensor's output has the input's part in it
        R=R,
        mix=mix,
        Q=Q,
        P0=P0,
        start=np.array(setting.unknown0, float),
        low=low,
        high=high,
        room=setting.room,
        guard=guard.of(options.gate, options.gate_opens, options.huber),
    )
    numbers = {"R": R, **assumed_noise.option("Q", own)}
    proof = Certificate("none: the slope at the estimate is no proof", float("inf"), "none", "not needed", numbers)
    return Design(gains, proof, True if setting.model.E is not None else None)
