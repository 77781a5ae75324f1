"""lmi-sampled: observer that holds its innovations between aperiodic, asynchronous samples, with a gain by LMI.

    xhat' = f(xhat, u) + L g,    g_j(t) = y_j(t_j) - C_j xhat(t_j),    t_j the time of the newest sample of output j

The innovation of a sample acts from its arrival on (`parts/held_innovation`).

- `synthesis/held_lmi` computes the gain and its certificate. The error decays at the rate `decay` for all constant or varying
  intervals up to `max_interval`. Outputs with their own clocks may be sampled in any order.
- With `parameter_range`, the certificate holds for all models in the range, including time-varying ones. So it covers a
  nonlinear plant whose Jacobians are all in the range.

Source: functional of Fridman, Automatica 2010. Etienne, Hetel, Efimov, Petreczky 2017 treat such observers for Lipschitz
plants; their inequalities were not obtained. Several clocks and the hull of models are this project's.
Not claimed: noise filtering, that the range contains the plant's Jacobians, or a certificate with delay.
"""

import itertools

import numpy as np
from pydantic import Field

from pcbench.dynamics.linear import Matrix, spectral_radius
from pcbench.dynamics.observability import require_detectable
from pcbench.errors import UserError
from pcbench.observers.parts import held_innovation
from pcbench.observers.parts.options import StrictOptions, matrix, tunable
from pcbench.synthesis import constant_periods, held_lmi, riccati
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate
from pcbench.synthesis.held_lmi import HeldTask
from pcbench.synthesis.parameter_ranges import Range

MAX_CORNERS = 64  # corners of the LMI
AFFINE_TOL = 1e-9  # relative tolerance for a model that is affine in its parameters


class Options(StrictOptions):
    """The gain, and the models and intervals that its certificate covers."""

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


OBSERVER = held_innovation.OBSERVER


def design(context: DesignContext, options: Options) -> Design:
    """Return L with its certificate; raise DesignError if no L is certified."""
    model, where = context.model, f"lmi-sampled in {context.scenario}"
    held_innovation.require_continuous(context, where)
    require_detectable(model, where)
    option_L = None if options.L is None else matrix(options.L, model.C.T.shape, f"{where}: L", "states x outputs")
    task = task_of(context, options, where)
    scale = riccati.nearest_scale(riccati.prior_size(context))
    L, certificate = held_lmi.design(task, option_L, scale, where)
    mean = max(context.period) * context.dt
    radius = max(spectral_radius(constant_periods.held_map(A, L, model.C, mean)) for A in task.A)
    numbers = dict(certificate.numbers) | {"radius_at_mean_period": radius}
    certificate = certificate._replace(numbers=numbers)
    if any(context.delay):
        certificate = no_certificate("the measurements are delayed")._replace(numbers=numbers)
    elif context.field is not None and not options.parameter_range:
        certificate = no_certificate("the plant is nonlinear; give a parameter_range that contains its slopes")
        certificate = certificate._replace(numbers=numbers)
    q = len(model.C)
    return Design(held_innovation.gains_of(context, L, np.zeros((q, q))), certificate)


def task_of(context: DesignContext, options: Options, where: str) -> HeldTask:
    """Return the problem of the LMI: the corner models, the clocks, and their longest intervals.

    The held innovation of a delayed sample stays in use for the delay longer, so the delay is added to the interval.
    """
    q = len(context.model.C)
    clocks = (0,) * q if context.sensors == 1 else tuple(range(q))
    periods = (max(context.intervals or context.period),) if context.sensors == 1 else context.period
    delays = (max(context.delay),) if context.sensors == 1 else context.delay
    longest = tuple(
        (options.max_interval or period * context.dt) + delay * context.dt
        for period, delay in zip(periods, delays, strict=True)
    )
    corners = corner_models(context, options.parameter_range or {}, where)
    if len(corners) * 2 ** len(longest) > MAX_CORNERS:
        raise UserError(
            f"{where}: got {len(corners)} corners of parameters and {len(longest)} clocks, which are more than {MAX_CORNERS} "
            "corners of the LMI; leave a parameter or a sensor out."
        )
    return HeldTask(corners, context.model.C, clocks, longest, options.decay)


def corner_models(context: DesignContext, parameters: dict[str, list[float]], where: str) -> Matrix:
    """Return A [k, n, n] at all corners of the parameter ranges; raise UserError unless A is affine in the parameters."""
    if not parameters:
        return context.model.A[None]

    def model(values: tuple[float, ...]) -> Matrix:
        return np.asarray(context.variant(dict(zip(parameters, values, strict=True))).A)

    corners = np.stack([model(values) for values in itertools.product(*parameters.values())])
    middle = model(tuple((low + high) / 2 for low, high in parameters.values()))
    if np.abs(corners.mean(0) - middle).max() > AFFINE_TOL * np.abs(corners).max():
        raise UserError(
            f"{where}: got a parameter_range of {', '.join(parameters)}, in which A is not affine, expected parameters "
            "in which it is; give a range of other parameters."
        )
    return corners
