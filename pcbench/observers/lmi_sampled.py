"""lmi-sampled: an observer that holds its innovations between aperiodic, asynchronous samples, with a gain found by an LMI.

    xhat' = f(xhat, u) + L g,    g_j(t) = y_j(t_j) - C_j xhat(t_j),    t_j the time of the newest sample of output j

A linear model moves by its exact map under held u and g; a field by one Runge-Kutta step a tick. The innovation of a sample is
taken when it is sampled and acts from its arrival on. A sample older than the one in use is left out.
The gain and its certificate are in `synthesis/held_lmi`: the error decays at the rate `decay` for all intervals up to
`max_interval`, constant or not. Outputs with clocks of their own may be sampled in any order. With `parameter_range` the
certificate holds for models anywhere in the range, also if they vary with time. So it covers the slopes of a nonlinear plant if
the range contains them all.
Source: functional of Fridman, Automatica 46(2), 2010. Etienne, Hetel, Efimov, Petreczky 2017 treat such observers for
Lipschitz plants; their inequalities were not obtained. Several clocks and the hull of models are ours.
Not claimed: that the gain filters noise well, that the range contains the slopes of the plant, nor a certificate with delay.
"""

import itertools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix
from pcbench.dynamics.observability import require_detectable
from pcbench.errors import UserError
from pcbench.observers.parts.common import known_input, xhat
from pcbench.observers.parts.options import StrictOptions, matrix, tunable
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis import constant_periods, held_lmi, riccati
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate
from pcbench.synthesis.held_lmi import HeldTask
from pcbench.synthesis.parameter_ranges import Range

MOST = 64  # corners of the LMI
SAME = 1e-9  # relative, of a model that is affine in its parameters


class Gains(NamedTuple):
    """n states, m inputs, q outputs, s unknowns; maps over one tick."""

    Phi: Float[Leaf, "n n"]
    Gamma: Float[Leaf, "n m"]
    H: Float[Leaf, "n q"]  # of the held innovation
    C: Float[Leaf, "q n"]
    D: Float[Leaf, "q m"]
    L: Float[Leaf, "n q"]
    unknowns: Float[Leaf, " s"]  # assumed constant
    field: Any  # (now, x[n], p[s]) -> dx/dt[n]; None: the model is linear


class Memory(NamedTuple):
    """The memory between ticks."""

    xhat: Float[Array, " n"]
    g: Float[Array, " q"]  # innovation in use
    newest: Int[Array, " q"]  # index of its sample; -1: none


class Options(StrictOptions):
    """The gain, and what its certificate must cover."""

    L: list[list[float]] | None = tunable(None, description="[n, q] gain [1/s], instead of a computed one")
    max_interval: float | None = Field(
        None,
        gt=0,
        description="longest interval between samples that the certificate covers [s]; default: of the schedule",
    )
    decay: float = Field(0.0, ge=0, description="decay rate of the error that the certificate must contain [1/s]")
    parameter_range: dict[str, Range] | None = Field(
        None, description="smallest and largest value of model parameters, by name, of the certificate"
    )


def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
    """Start from xhat(0), without an innovation."""
    q = gains.C.shape[0]
    return Memory(xhat0, jnp.zeros(q), jnp.full(q, -1, int))


def snapshot(gains: Gains, memory: Memory, now: Now) -> Float[Array, " q"]:
    """Store C xhat."""
    return gains.C @ memory.xhat


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Hold the innovation of each output that arrived, unless a newer one is in use."""
    newer = arrival.mask & (arrival.index > memory.newest)
    g = arrival.value - known_input(gains.D, now, arrival.age) - arrival.snapshot
    return memory._replace(g=jnp.where(newer, g, memory.g), newest=jnp.where(newer, arrival.index, memory.newest))


def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
    """Move by one tick, u and g held."""
    if gains.field is None:
        return memory._replace(xhat=gains.Phi @ memory.xhat + gains.Gamma @ now.u + gains.H @ memory.g)
    push = gains.L @ memory.g
    rate = lambda t, x: gains.field(now._replace(t=t), x, gains.unknowns) + push  # noqa: E731
    return memory._replace(xhat=rk4(rate, now.t, memory.xhat, now.dt))


OBSERVER = Observer(init, snapshot, jump, flow, xhat)


def design(setting: DesignContext, options: Options) -> Design:
    """Find L and certify it; raise DesignError if there is none that is certified."""
    model, where = setting.model, f"lmi-sampled in {setting.scenario}"
    if model.discrete or setting.successor or setting.sensor or setting.residual:
        raise UserError(
            f"{where}: got a plant in discrete time or with a nonlinear output, expected a continuous plant with outputs "
            "that are linear in the state; use kf or ekf."
        )
    require_detectable(model, where)
    given = None if options.L is None else matrix(options.L, model.C.T.shape, f"{where}: L", "states x outputs")
    task = task_of(setting, options, where)
    scale = riccati.near(riccati.prior_size(setting))
    L, certificate = held_lmi.design(task, given, scale, where)
    mean = max(setting.period) * setting.dt
    radius = max(constant_periods.spectral_radius(constant_periods.held_map(A, L, model.C, mean)) for A in task.A)
    numbers = dict(certificate.numbers) | {"radius_at_mean_period": radius}
    certificate = certificate._replace(numbers=numbers)
    if any(setting.delay):
        certificate = no_certificate("the measurements are delayed")._replace(numbers=numbers)
    elif setting.field is not None and not options.parameter_range:
        certificate = no_certificate("the plant is nonlinear; give a parameter_range that contains its slopes")
        certificate = certificate._replace(numbers=numbers)
    Phi, Gammas = linear.discretize_zoh(model.A, np.hstack([model.B, L]), setting.dt)
    m = model.B.shape[1]
    gains = Gains(
        Phi=Phi,
        Gamma=Gammas[:, :m],
        H=Gammas[:, m:],
        C=model.C,
        D=model.feedthrough,
        L=L,
        unknowns=np.array(setting.unknown0, float),
        field=setting.field,
    )
    return Design(gains, certificate)


def task_of(setting: DesignContext, options: Options, where: str) -> HeldTask:
    """Return what the LMI must cover: the corners of the models, the clocks, and their longest intervals.

    A held innovation of a delayed sample is in use until it is older by the delay, so that is added to an interval.
    """
    q = len(setting.model.C)
    clocks = (0,) * q if setting.sensors == 1 else tuple(range(q))
    periods = (max(setting.intervals or setting.period),) if setting.sensors == 1 else setting.period
    delays = (max(setting.delay),) if setting.sensors == 1 else setting.delay
    longest = tuple(
        (options.max_interval or period * setting.dt) + delay * setting.dt
        for period, delay in zip(periods, delays, strict=True)
    )
    corners = corner_models(setting, options.parameter_range or {}, where)
    if len(corners) * 2 ** len(longest) > MOST:
        raise UserError(
            f"{where}: got {len(corners)} corners of parameters and {len(longest)} clocks, which are more than {MOST} "
            "corners of the LMI; leave a parameter or a sensor out."
        )
    return HeldTask(corners, setting.model.C, clocks, longest, options.decay)


def corner_models(setting: DesignContext, parameters: dict[str, list[float]], where: str) -> Matrix:
    """Return A [k, n, n] at all lowest and highest values of the parameters; raise UserError unless A is affine in them."""
    if not parameters:
        return setting.model.A[None]

    def model(values: tuple[float, ...]) -> Matrix:
        return np.asarray(setting.variant(dict(zip(parameters, values, strict=True))).A)

    corners = np.stack([model(values) for values in itertools.product(*parameters.values())])
    middle = model(tuple((low + high) / 2 for low, high in parameters.values()))
    if np.abs(corners.mean(0) - middle).max() > SAME * np.abs(corners).max():
        raise UserError(
            f"{where}: got a parameter_range of {', '.join(parameters)}, in which A is not affine, expected parameters "
            "in which it is; give a range of other parameters."
        )
    return corners
