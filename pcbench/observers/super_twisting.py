"""Super-twisting observer: a second-order sliding mode in position and rate, discretised implicitly.

    xi_1' = xi_2 + k1 |e|^(1/2) sign e,   xi_2' = model + k2 sign e,   e = y - xi_1,   k1 = 1.5 sqrt(f),   k2 = 1.1 f

with xi = (y, y') of a plant with two states. f bounds the error of the modelled acceleration, and after a finite time the error
of continuous measurements is 0. Here the model is predicted to the sample, taken h seconds after the one before, and b is the
innovation. The implicit step chooses the error e+ after the correction, with sign e+ in [-1, 1] where e+ = 0:

    |b| <= h^2 k2:   e+ = 0,   xi_1 <- y,   xi_2 <- xi_2 + b / h
    otherwise        |e+| + h k1 |e+|^(1/2) + h^2 k2 = |b|,   xi_1 <- y - e+,   xi_2 <- xi_2 + h k2 sign b

so that it does not chatter: without noise the position has no error at the samples, and the rate errs by about h f / 2.
`discretization = "explicit"` is the Euler step, xi_1 <- xi_1 + h k1 |b|^(1/2) sign b, xi_2 <- xi_2 + h k2 sign b.

Source: Davila, Fridman, Levant, IEEE TAC, 2005, for continuous measurement. The implicit step is a common one; its use
at the time of a delayed sample and the prediction over the delay (`parts/repropagation`) are this project's.
Schedule: samples of any age and order. h is the interval between sampling times. For a sample at tick 0 it is the mean period.
Plants: two states, one output without feedthrough, relative degree 2; a nonlinear plant must have the states (y, y').
Time index: xhat is the estimate of the present, after the jump.
Not claimed: noise filtering, or a bound of the error if the model error exceeds f. There is no certificate.
"""

from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import nonlinear_model, repropagation
from pcbench.observers.parts.nonlinear_model import Gains
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import InnovationStats, Leaf, Now
from pcbench.synthesis import bandwidth
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate

REASON = "the observer is nonlinear, and its theorem is for continuous measurement"


class Law(NamedTuple):
    """Parameters of the correction."""

    O_inv: Float[Leaf, "2 2"]  # x of (y, y')
    k1: Float[Leaf, ""]
    k2: Float[Leaf, ""]
    period: Float[Leaf, ""]  # [s] the mean one
    explicit: Float[Leaf, ""]  # 1: Euler; 0: implicit


class State(NamedTuple):
    """The estimate at a tick, and the tick of the sample before."""

    x: Float[Array, "2"]
    tick: Int[Array, ""]
    last_sample: Int[Array, ""]


class Options(StrictOptions):
    """The bound of the model error, and the form of the step."""

    f: float = tunable(
        1.0, gt=0, description="bound of the error of the modelled acceleration [unit of the output per s^2]"
    )
    discretization: Literal["implicit", "explicit"] = Field(
        "implicit", description="correction at a sample: implicit step, or Euler's"
    )


def correction(law: Law, b: Float[Array, ""], h: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the corrections of position and rate for an innovation b after h seconds."""
    size, sign, reach = jnp.abs(b), jnp.sign(b), h**2 * law.k2
    root = (jnp.sqrt((h * law.k1) ** 2 + 4 * jnp.maximum(size - reach, 0.0)) - h * law.k1) / 2
    is_inside = size <= reach
    rate = jnp.where(is_inside & (law.explicit == 0), b / h, h * law.k2 * sign)
    implicit = size - jnp.where(is_inside, 0.0, root**2)
    return jnp.where(law.explicit == 1, h * law.k1 * jnp.sqrt(size), implicit) * sign, rate


def first(gains: Gains, xhat0: Float[Array, "2"]) -> State:
    """Return the state at xhat(0)."""
    return State(xhat0, jnp.asarray(0), jnp.asarray(0))


def tick(gains: Gains, now: Now, state: State) -> State:
    """Propagate the model by one tick."""
    return state._replace(x=gains.motion(now, state.x))


def update(gains: Gains, sample_now: Now, state: State, sample: Measurement) -> State:
    """Correct at the sampling time."""
    law: Law = gains.extra
    empty = jnp.zeros(0)
    y = gains.C @ state.x if gains.sensor is None else gains.sensor(sample_now, state.x, empty)
    b = jnp.where(sample.mask, nonlinear_model.value_near(gains, sample.value, y) - y, 0.0)[0]
    ticks = sample.tick - state.last_sample
    position, rate = correction(law, b, jnp.where(ticks > 0, ticks * sample_now.dt, law.period))
    x = state.x + law.O_inv @ jnp.stack([position, rate])
    return State(x, sample.tick, jnp.where(sample.mask[0], sample.tick, state.last_sample))


def no_innovation(gains: Gains, sample_now: Now, state: State, sample: Measurement) -> InnovationStats:
    """Return empty statistics, because the observer has no covariance."""
    return InnovationStats(jnp.zeros(()), jnp.zeros(()))


FUNCTIONS = repropagation.FilterFunctions(tick, update, no_innovation, first, mean=lambda gains, state: state.x)
OBSERVER = repropagation.observer(FUNCTIONS)._replace(covariance=None, innovation=None)


def coordinates(context: DesignContext, where: str) -> np.ndarray:
    """Return the map [2, 2] from (y, y') to x; raise UserError for a plant without such coordinates."""
    problem = "a plant that is given by its step" if context.successor is not None else ""
    problem = problem or (f"{len(context.unknown_std)} unknown inputs or parameters" if context.unknown_std else "")
    if not problem and context.field is None:
        return np.linalg.inv(bandwidth.chain_of(context.model, where, 2).O)
    if not problem and not _is_position_and_rate(context):
        problem = "a nonlinear plant whose states are not the output and its derivative"
    if problem:
        raise UserError(
            f"{where}: got {problem}, expected two states, the measured position and its rate, without unknown inputs; use "
            "ekf or another observer."
        )
    return np.eye(2)


def _is_position_and_rate(context: DesignContext) -> bool:
    """Return whether x = (y, y'), tested at a few states and inputs."""
    n, m = context.model.B.shape
    if n != 2 or len(context.model.C) != 1:
        return False
    for z in np.random.default_rng(0).normal(size=(4, 2 + m)):
        x, u, empty = jnp.asarray(z[:2]), jnp.asarray(z[2:]), jnp.zeros(0)
        now = Now(jnp.zeros(()), jnp.asarray(0), jnp.asarray(context.dt), u, lambda age: u)  # noqa: B023
        y = context.model.C @ x if context.sensor is None else context.sensor(now, x, empty)
        rate = context.field(now, x, empty)  # type: ignore[misc]
        if not np.allclose([y[0], rate[0]], x, rtol=1e-12, atol=1e-12):
            return False
    return True


def design(context: DesignContext, options: Options) -> Design:
    """Return the gains of the source for the bound f; there is no certificate."""
    O_inv = coordinates(context, f"super-twisting in {context.scenario}")
    law = Law(
        O_inv=O_inv,
        k1=np.asarray(1.5 * options.f**0.5),
        k2=np.asarray(1.1 * options.f),
        period=np.asarray(context.period[0] * context.dt),
        explicit=np.asarray(float(options.discretization == "explicit")),
    )
    gains = nonlinear_model.design(context, nonlinear_model.Options(), "super-twisting", extra=lambda gains: law).gains
    return Design(gains, no_certificate(REASON))
