"""dkf: the delay-compensated discrete Kalman filter, the fair baseline.

At the arrival of sample m, taken at t_m: carry mean and covariance from the newest sample used to t_m, update there (Joseph
form, one channel after the other), then predict to now exactly as PCCEBO does:

    P-_m = E P_(m-1) E' + Q,   K = P- c (c'P- c + r)^-1,   P_m = (I - K c') P- (I - K c')' + K r K'
    xhat(t) = e^{A (t - t_m)} xhat_m + I(t_m, t)

R is the variance of one sample (outputs whose noise is correlated are made independent first), the prior is N(xhat(0), P0).
With what is true of R and Q, and x(0) drawn from the prior, P is the Bayesian bound of every causal estimator, and this filter
attains it. Where a scenario has no measurement noise, R = 1e-12.
With `bias_variance` a constant input bias b ~ N(0, that variance) is estimated beside the state: x' = A x + B (u + b).
Where a plant has an unknown input, x' = A x + B u + E f, f is estimated too, as a random walk from N(0, size^2) on: the
estimate of the present carries it, and the signal is f less its part that is a known function of the state.
Not claimed: that every unknown input can be found; its variance then grows.
Time index: the estimate is of now, after the jump. Channels may have clocks and delays of their own; a sample that comes after
a newer one is put in its place (`parts/reordering`), so the estimate uses all that has arrived, as if it had come in order.
Source: Kalman 1960; a late sample is filtered at its own time, and what has come since is filtered again.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import covariance_after
from pcbench.dynamics.linear import Matrix
from pcbench.dynamics.observability import require_detectable
from pcbench.observers.parts import assumed_noise, kalman, prediction
from pcbench.observers.parts.kalman import Posterior
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reordering import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import riccati
from pcbench.synthesis.certificate import Certificate, Design, Setting, certified


class Gains(NamedTuple):
    """n states (the plant's, and what is estimated beside them), m inputs, q outputs."""

    motion: Motion
    noise: Float[Leaf, "2 R n n"]  # process noise covariance over as many ticks as each of motion.powers
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    R: Float[Leaf, " q"]  # variance of one sample
    mix: Any  # [q, q] of the outputs, so that their noise is independent; None: it is
    P0: Float[Leaf, "n n"]
    room: Room  # for samples that may be overtaken
    states: Float[Room, " plant"]  # what the estimate has of the filter's
    inputs: Float[Room, " r"]  # unknown inputs, the last states of the filter
    known: Any  # x[n] -> [r] the known part of f, or None


class Options(assumed_noise.Options):
    """What the filter assumes, where it is not what the scenario has."""

    bias_variance: float | None = Field(
        None, gt=0, description="prior variance of a constant input bias, estimated beside the state; default: no bias"
    )
    input_walk: float = Field(
        1.0,
        ge=0,
        description="how far an unknown input walks: variance over the square of its size [1/s]; 0: not estimated",
    )


def init(gains: Gains, xhat0: Float[Array, " plant"]) -> Memory:
    """Start from the prior N(xhat(0), P0), what is beside the state from 0."""
    whole = jnp.concatenate([xhat0, jnp.zeros(gains.P0.shape[0] - xhat0.shape[0])])
    return prediction.start(whole, Posterior(whole, gains.P0, jnp.asarray(0)), gains.room, gains.C.shape[0])


def update(gains: Gains, before: Posterior, sample: Measurement) -> Posterior:
    """Update at the sample's own time, channel by channel; the mean is less the response to the input."""
    free = prediction.at(gains.motion, Point(before.mean, before.taken), sample.taken)
    P = covariance_after(gains.motion.powers, gains.noise, sample.taken - before.taken, before.P)
    value = sample.value if gains.mix is None else gains.mix @ sample.value
    for channel in range(gains.C.shape[0]):
        c, r, fresh = gains.C[channel], gains.R[channel], sample.fresh[channel]
        K = kalman.gain(P @ c, c @ P @ c + r, fresh)
        free = free + K * (value[channel] - c @ (sample.note + free))
        P = kalman.covariance(P, K, c, r)
    return Posterior(free, P, sample.taken)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " plant+r"]:
    """Return xhat of now, and the unknown inputs."""
    n, r = gains.states.shape[0], gains.inputs.shape[0]
    xhat = memory.xhat[:n]
    if not r:
        return xhat
    f = memory.xhat[-r:]
    return jnp.append(xhat, f - gains.known(xhat) if gains.known else f)


jump = prediction.jumping(update, lambda after: Point(after.mean, after.taken))
OBSERVER = Observer(init, prediction.note, jump, prediction.flow, estimate)


def design(setting: Setting, options: Options) -> Design:
    """Gather what the filter assumes, and check its covariance recursion over the horizon at the (mean) periods."""
    where = f"dkf in {setting.scenario}"
    require_detectable(setting.model, where)
    model, P0, n = setting.model, setting.P0, len(setting.model.A)
    if options.bias_variance is not None:
        model, m = linear.with_input_bias(model), model.B.shape[1]
        P0 = np.block([[P0, np.zeros((n, m))], [np.zeros((m, n)), options.bias_variance * np.eye(m)]])
    q = assumed_noise.through(options.q, model.B.shape[1], setting.input_intensity, where)
    inputs = np.zeros(0)
    if model.E is not None and options.input_walk:
        size = np.square(setting.unknown_std[: model.E.shape[1]])
        model, inputs = linear.with_unknown_input(model), size
        P0 = np.block([[P0, np.zeros((len(P0), len(size)))], [np.zeros((len(size), len(P0))), np.diag(size)]])
    mix, C, R = assumed_noise.independent(setting, options.R, model.C, where)
    moves = prediction.motion_of(model, setting)
    Q = linear.input_noise(model, q, setting.dt, options.input_walk * inputs)
    Q[:n, :n] += assumed_noise.process(setting, options.Q, where)
    noise = linear.noise_powers(model, Q, setting.dt, setting.ticks)
    gains = Gains(
        motion=moves,
        noise=noise,
        C=C,
        D=model.feedthrough,
        R=R,
        mix=mix,
        P0=P0,
        room=setting.room,
        states=np.zeros(n),
        inputs=np.zeros(
            len(inputs) if len(inputs) == len(setting.unknown_std) else 0
        ),  # all that is unknown, or nothing
        known=setting.model.known if len(inputs) else None,
    )
    carries = True if len(inputs) else None
    proof = _certify(gains, model, Q, setting)
    own = assumed_noise.option("Q", assumed_noise.process(setting, options.Q, where))
    proof = proof._replace(numbers={**proof.numbers, "q": q, **own})
    return Design(gains, certified(proof, where), carries)


def _certify(gains: Gains, model: linear.Model, Q: Matrix, setting: Setting) -> Certificate:
    """The margin is the least innovation variance over the horizon, relative to R, where the covariance stays >= 0."""
    bits = linear.bits_for(setting.ticks)
    doubled = linear.doublings(model, setting.dt, bits)
    noise = linear.noise_doublings(model, Q, setting.dt, bits)
    run = riccati.multirate(doubled, noise, gains.C, gains.R, gains.P0, setting.period, setting.ticks)
    numbers = {"P_end": run.P, "K_end": run.K, "R": gains.R, "innovation_over_R": run.innovation}
    margin = run.innovation if run.least > -1e-9 else float("nan")
    return Certificate("c P c' + r > 0 and P >= 0 at every sample", margin, "recursion", "run", numbers)
