"""ESO: extended state observer of active disturbance rejection control (ADRC), with a predictor.

The disturbance d of a chain of n integrators is an additional state, constant between samples, z = [x; d]:

    x' = A x + B u + G d,   d' = 0,   y = C x                                G = B (or E of an unknown input)
    zbar_m = Phi z_(m-1) + I(t_(m-1), t_m),   z_m = zbar_m + L (y_m - C zbar_m)

The correction is at each sampling time. The estimate is predicted to the present with constant d (`parts/prediction`). All
poles of (I - L C) Phi are beta = exp(-omega T), so the bandwidth omega is the only tuning parameter. For n = 2 and A = [0 1;
0 0], G = [0; 1]:

    L = (1 - beta^3,  3 (1 - beta)^2 (1 + beta) / (2 T),  (1 - beta)^3 / T^2)

- beta = 0 is the deadbeat unknown-input observer: with a constant d, the error is 0 after n + 1 samples.
- `model = "chain"` is Gao's observer. It uses only the order n and b = C A^(n-1) G, and d contains C A^n x / b.
- `model = "full"`: d is the difference from the model. Modes that decay faster than beta per sample keep their poles.

Source: Gao, ACC 2003 (chain, bandwidth); Miklosovic, Radke, Gao, ACC 2006 (discrete, correction at the sampling time). The
use of delayed samples, the prediction over the delay and `model = "full"` are this project's.
Schedule: samples of any age and order. L and the certificate are for the mean period T and the observer's model. A lost
sample lengthens one interval.
Time index: xhat is the estimate of the present, after the jump.
Not claimed: an error of zero while d changes, nor, with "chain", after a perfect start.
Refused: several outputs, feedthrough, a discrete plant, and a relative degree below n.
"""

from math import exp
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float
from pydantic import Field
from scipy.linalg import block_diag

from pcbench.dynamics import linear
from pcbench.observers.parts import prediction
from pcbench.observers.parts.options import StrictOptions, tunable
from pcbench.observers.parts.prediction import Memory, Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Leaf, Observer, Room
from pcbench.synthesis import bandwidth, current_gains
from pcbench.synthesis.certificate import Design, DesignContext, one_clock


class Gains(NamedTuple):
    """k states of the plant, m inputs, one output; z has n = k + 1 states, the last is the disturbance."""

    motion: Motion
    C: Float[Leaf, "1 n"]
    D: Float[Leaf, "1 m"]
    L: Float[Leaf, "n 1"]
    start: Float[Leaf, "n k"]  # (x, d) at t = 0 from xhat(0)
    d0: Float[Leaf, " n"]
    signals: Room  # for the estimated signals: the plant's states, and its unknown input if it has one
    room: Room  # for samples that may arrive after newer ones


class Options(StrictOptions):
    """Bandwidth and model."""

    pole: float = tunable(0.5, (0.0, 0.999), ge=0, le=0.999, description="pole of the error per sample; 0: deadbeat")
    omega: float | None = Field(None, gt=0, description="bandwidth [1/s], instead of `pole`: pole = exp(-omega T)")
    model: Literal["full", "chain"] = Field(
        "full", description="model between samples: that of the plant, or a chain of integrators"
    )


def init(gains: Gains, xhat0: Float[Array, " k"]) -> Memory:
    """Return the memory at xhat(0) and the corresponding disturbance."""
    z = gains.start @ xhat0 + gains.d0
    return prediction.start(z, prediction.origin(z), gains.room, 1)


def correct(gains: Gains, before: Point, sample: Measurement) -> Point:
    """Correct at the sampling time."""
    free = prediction.predict_to(gains.motion, before, sample.tick)
    innovation = jnp.where(sample.mask, sample.value - gains.C @ (sample.snapshot + free), 0.0)
    return Point(free + gains.L @ innovation, sample.tick)


def estimate(gains: Gains, memory: Memory) -> Float[Array, " signals"]:
    """Return the present xhat, and the unknown input if the plant has one."""
    return memory.xhat[: gains.signals.shape[0]]


jump = prediction.make_jump(correct, lambda point: point)
OBSERVER = Observer(init, prediction.snapshot, jump, prediction.flow, estimate)


def design(context: DesignContext, options: Options) -> Design:
    """Place the poles at the mean period, and certify them; raise UserError if the plant is not a chain of integrators."""
    period, where, model = one_clock(context, "eso"), f"eso in {context.scenario}", context.model
    chain = bandwidth.chain_of(model, where)
    n, seconds = len(model.A), period * context.dt
    row = chain.row / chain.b * (options.model == "chain")
    E = chain.G  # A - E row is a chain of integrators: C (A - E row)^n = 0
    joint_model = linear.with_unknown_input(model._replace(A=model.A - E @ row, E=E))
    Phi, Gamma_sample = linear.discretize_zoh(model.A - E @ row, E, seconds)
    pole = options.pole if options.omega is None else exp(-options.omega * seconds)
    joint_map = np.block([[Phi, Gamma_sample], [np.zeros((1, n)), np.eye(1)]])
    L = bandwidth.current_gain(joint_map, joint_model.C, pole, pole, where)
    prior = np.where(np.diag(context.P0) > 0, np.diag(context.P0), 1.0)
    # variance of d that changes x by the prior's standard deviation in a period
    variance = float(np.min(prior / np.maximum(Gamma_sample[:, 0] ** 2, 1e-300)))
    joint_context = context._replace(model=joint_model, P0=block_diag(context.P0, [[variance]]), process_std=())
    L, certificate = current_gains.find(joint_context, "given", L, 0.0, None, None, where)
    certificate = certificate._replace(inequality="[P, M'; M, P] > 0, M = P (I - L C) Phi, of state and disturbance")
    unknown0 = context.unknown0 if model.E is not None else ()
    gains = Gains(
        motion=prediction.motion_of(joint_model, context),
        C=joint_model.C,
        D=model.feedthrough,
        L=L,
        start=np.vstack([np.eye(n), row]),
        d0=np.append(np.zeros(n), unknown0 or 0.0),
        signals=np.zeros(n + len(unknown0)),
        room=context.room,
    )
    return Design(gains, certificate, True if unknown0 else None)
