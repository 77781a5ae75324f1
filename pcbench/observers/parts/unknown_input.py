"""Shared parts of the sliding-mode and the PI observer, which estimate an unknown input by injecting a signal v.

    x' = A x + B u + E f;   e_y = y - C xhat,   s = Tp e_y                                   (5), (12)
    xhat' = A xhat + B u + Gx e_y + Lx v,   v of s (and of its integral)                     fhat = E222^-1 v[p-r:], Remark 2
    input = fhat - known(xhat), where a part of f is a known function of the state

These equations are in original coordinates (`synthesis.unknown_input`), and errors are x - xhat. With continuous measurement,
the observer is `field`. With samples of one constant age d, it estimates the state d ago, xd, with B u(t - d), and predicts
it to the present as KFBO does:

    xhat(t) = e^{A min(t, d)} xd(t) + response to the input since (+ int_0^d e^{A s} ds E fhat, option `reconstruct`)

xd stays at xhat(0) before t = d. Between samples y is the last one (`hold`), or predicted (`predict`): wy' = C (A xd + B u(t
- d)), wy := y at arrivals. A tick is one Runge-Kutta step of the field.

Source: Peng, Appl. Sci. 2017, 7(1), 67; sampling and delay are this project's. E is the paper's D.
Time index: xhat is the estimate of the present, after the jump. fhat estimates f of d ago, and is used as the present f.
Perfect start is exact if the plant also moves by the Runge-Kutta step; `hold` does not use the schedule, so it has no perfect
start.
Not claimed: an error of zero with an unknown input, or that the certificates, which are for continuous measurement, hold for
samples.
"""

from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int, PyTree
from pydantic import Field

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import rk4
from pcbench.dynamics.linear import Matrix
from pcbench.errors import UserError
from pcbench.observers.parts.common import known_input, no_snapshot
from pcbench.observers.parts.options import StrictOptions, method_option
from pcbench.protocols import Arrival, Leaf, Now, Observer
from pcbench.synthesis.certificate import DesignContext
from pcbench.synthesis.unknown_input import Split

STABLE = 2.5  # gain times tick; a Runge-Kutta step follows e^{-a t} up to a h = 2.78
Injection = Callable[[PyTree, Array, Array], tuple[Array, Array]]  # (its numbers, s[p], w[p]) -> v[p], w'[p]


class Gains(NamedTuple):
    """n states, m inputs, p outputs, r unknown inputs."""

    law: PyTree  # the numbers of v
    Lx: Float[Leaf, "n p"]
    C: Float[Leaf, "p n"]
    D: Float[Leaf, "p m"]
    F: Float[Leaf, "n+p n+p"]  # of [xd; y]: [A - Gx C, Gx; C A, 0], its last rows 0 if y is held
    H: Float[Leaf, "n+p m"]  # of u(t - d): [B; C B], its last rows 0 if y is held
    S: Float[Leaf, "p n+p"]  # s = S [xd; y] = Tp (y - C xd)
    reconstruction: Float[Leaf, "r p"]  # fhat = reconstruction v
    nonlinearity: Callable[[Array], Array] | None  # x[n] -> [r] the known part of f, or None
    lag: Int[Leaf, ""]  # [ticks] d
    Phi: Float[Leaf, "n n"]  # one tick
    Gamma: Float[Leaf, "n m"]
    Gamma_f: Float[Leaf, "n r"]  # of fhat over a tick with `reconstruct`; else 0


class Memory(NamedTuple):
    """Memory between ticks; `transition` and `input_integral` are the same in all runs."""

    xd: Float[Array, " n"]  # estimate of the state d ago
    w: Float[Array, " p"]  # integral of the law
    y: Float[Array, " p"]  # output d ago, measured, held or predicted
    f: Float[Array, " r"]  # estimate of the unknown input d ago, stored for `estimate`
    response: Float[Array, " n"]  # response to the input of the last d
    transition: Float[Array, "n n"]  # e^{A min(t, d)}
    input_integral: Float[Array, "n r"]  # int_0^min(t, d) e^{A s} ds E


class Options(StrictOptions):
    """Options of both observers."""

    gains: Literal["design", "paper"] = method_option("design", description="by LMI, or as published (for the arm)")
    measurement: Literal["predict", "hold"] = Field("predict", description="output between samples: predicted, or held")
    reconstruct: bool = Field(False, description="use the estimated unknown input in the prediction to the present")


def observer(inject: Injection) -> Observer:
    """Return the observer with an injection law."""

    def init(gains: Gains, xhat0: Float[Array, " n"]) -> Memory:
        """Return the memory at xhat(0), as if its output had been measured."""
        n, zeros = xhat0.shape[0], jnp.zeros(gains.C.shape[0])
        f = jnp.zeros(gains.Gamma_f.shape[1])
        return Memory(
            xd=xhat0,
            w=zeros,
            y=gains.C @ xhat0,
            f=f,
            response=jnp.zeros(n),
            transition=jnp.eye(n),
            input_integral=jnp.zeros_like(gains.Gamma_f),
        )

    def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
        """Replace the output of d ago by the arriving sample."""
        y = jnp.where(arrival.mask, arrival.value - known_input(gains.D, now, arrival.age), memory.y)
        return memory._replace(y=y, f=reconstruct(gains, memory.xd, memory.w, y))

    def reconstruct(
        gains: Gains, xd: Float[Array, " n"], w: Float[Array, " p"], y: Float[Array, " p"]
    ) -> Float[Array, " r"]:
        v, _ = inject(gains.law, gains.S @ jnp.append(xd, y), w)
        return gains.reconstruction @ v

    def field(gains: Gains, memory: Memory, now: Now, y: Float[Array, " p"]) -> Memory:
        """Return d memory/dt with the measurement y minus D u; entries that `flow` updates exactly have derivative 0."""
        z, n = jnp.append(memory.xd, y), memory.xd.shape[0]
        v, w_rate = inject(gains.law, gains.S @ z, memory.w)
        rate = gains.F @ z + gains.H @ now.past_u(gains.lag)
        zeros = (jnp.zeros_like(a) for a in memory[3:])
        return Memory(rate[:n] + gains.Lx @ v, w_rate, rate[n:], *zeros)

    def flow(gains: Gains, memory: Memory, now: Now) -> Memory:
        """Advance by one tick, with the held or predicted y."""
        is_past_lag = now.tick >= gains.lag
        state = rk4(lambda t, m: field(gains, m, now._replace(t=t), m.y), now.t, memory, now.dt)
        xd, w, y = (jnp.where(is_past_lag, new, old) for new, old in zip(state[:3], memory[:3], strict=True))
        old_response = jnp.where(is_past_lag, memory.transition @ (gains.Gamma @ now.past_u(gains.lag)), 0.0)
        response = gains.Phi @ memory.response + gains.Gamma @ now.u - old_response
        transition = jnp.where(is_past_lag, memory.transition, gains.Phi @ memory.transition)
        input_integral = jnp.where(
            is_past_lag, memory.input_integral, gains.Phi @ memory.input_integral + gains.Gamma_f
        )
        f = reconstruct(gains, xd, w, y)
        return Memory(xd=xd, w=w, y=y, f=f, response=response, transition=transition, input_integral=input_integral)

    def estimate(gains: Gains, memory: Memory) -> Float[Array, " n+r"]:
        """Return the present xhat, and the unknown inputs."""
        xhat = memory.transition @ memory.xd + memory.response + memory.input_integral @ memory.f
        return jnp.append(xhat, memory.f - gains.nonlinearity(xhat) if gains.nonlinearity else memory.f)

    return Observer(init, no_snapshot, jump, flow, estimate, field)


def gains_of(
    context: DesignContext, parts: Split, injection: tuple[Matrix, Matrix], law: PyTree, options: Options
) -> Gains:
    """Return the gains of an observer from Gx, Lx and the law."""
    model, r, p = context.model, len(parts.E222), len(context.model.C)
    (A, B, C, *_), (Gx, Lx) = model, injection
    predicts = float(options.measurement == "predict")
    F = np.block([[A - Gx @ C, Gx], [predicts * C @ A, np.zeros((p, p))]])
    H = np.vstack([B, predicts * C @ B])
    S = np.hstack([-parts.Tp @ C, parts.Tp])
    reconstruction = np.hstack([np.zeros((r, p - r)), np.linalg.inv(parts.E222)])
    Phi, Gamma = linear.one_tick(model, context.dt)
    Gamma_f = linear.one_tick(model._replace(B=np.asarray(model.E)), context.dt)[1] * options.reconstruct
    lag = np.asarray(context.delay[0])
    matrices = {"Lx": Lx, "C": C, "D": model.feedthrough, "F": F, "H": H, "S": S, "reconstruction": reconstruction}
    return Gains(law=law, **matrices, nonlinearity=model.nonlinearity, lag=lag, Phi=Phi, Gamma=Gamma, Gamma_f=Gamma_f)


def carries(context: DesignContext, options: Options) -> bool | None:
    """Return whether the prediction to the present includes the estimated input; None without a delay."""
    return options.reconstruct if context.delay[0] else None


def require_one_delay(context: DesignContext, where: str) -> None:
    """Raise UserError if channels have different delays."""
    if len(set(context.delay)) > 1:
        raise UserError(
            f"{where}: got channels with delays {context.delay} (ticks), expected one for all, because it estimates the "
            "state of one delay ago; give equal delays, or use kf."
        )


def require_short_tick(context: DesignContext, gain: float, gain_name: str, where: str) -> None:
    """Raise UserError if a Runge-Kutta step of one tick is unstable for a gain [1/s]."""
    if gain * context.dt > STABLE:
        raise UserError(
            f"{where}: got a gain {gain_name} of {gain:.3g} 1/s with a tick of {context.dt:g} s, expected their product below "
            f"{STABLE:g}, as a Runge-Kutta step needs; use a tick of at most {STABLE / gain:.2g} s, or other options."
        )


def require_plant(arm: Mapping[str, tuple[tuple[int | float, ...], ...]], context: DesignContext, where: str) -> None:
    """Raise UserError if gains printed for the arm, given by its matrices A, C, E, are used for another plant."""
    for name, rows in arm.items():
        M = getattr(context.model, name)
        if M is None or M.shape != np.shape(rows) or not np.allclose(M, rows, rtol=1e-12, atol=0):
            raise UserError(
                f"{where}: got gains = 'paper', which are printed for the arm, on another plant; expected 'design': leave the "
                "option out."
            )
