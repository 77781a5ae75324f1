"""kf-event: the Kalman filter for samples that are sent only if an output has changed (send on delta).

If a sensor sends no sample, its output differs from the last value sent, y_s, by less than d. The difference is assumed to be
uniform, so y_s replaces the missing sample, with a larger variance:

    sent:      y,    R
    not sent:  y_s,  R + d^2 / 3

d is the scenario's `send_threshold`. The filter stores the last value received of each output. Before the first value, and with
try_once_discard, an output may have changed by more than d, so silence is not used. If every sample is sent, it is `kf`.
Time index: xhat is the estimate of the present, after the jump.
A lost or delayed sample looks like silence, so a threshold is refused with loss, an outage, or random or varying times.
Not claimed: that P is correct. The difference is neither uniform nor independent from sample to sample.
Source: Nguyen, Suh 2008, who describe the method; the paper on the filter that they refer to was not obtained. The variance is
that of a uniform difference.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, PyTree
from pydantic import Field

from pcbench.errors import UserError
from pcbench.observers.parts import linear_filter, prediction
from pcbench.protocols import Arrival, Gains, InnovationStats, Now, Observer
from pcbench.synthesis.certificate import Design, DesignContext


class Memory(NamedTuple):
    """Memory of the Kalman filter, and the last value received; q outputs."""

    kf: prediction.Memory
    last_values: Float[PyTree, " q"]  # NaN: none yet


class Options(linear_filter.Options):
    """Assumptions of the filter."""

    threshold: float | list[float] | None = Field(
        None, description="d, of all outputs or of each; default: the scenario's send_threshold"
    )


def init(gains: Gains, xhat0: Float[PyTree, " n"]) -> Memory:
    """Start from the prior; no value has been received."""
    kf, q = linear_filter.init(gains, xhat0), gains.C.shape[0]
    samples = kf.buffer.samples._replace(variance_ratio=jnp.ones(kf.buffer.samples.mask.shape))
    return Memory(kf._replace(buffer=kf.buffer._replace(samples=samples)), jnp.full(q, jnp.nan))


def jump(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> Memory:
    """Use the arriving samples, and the last value received of silent outputs."""
    ratio = jnp.ones_like(arrival.value)
    last_value = jnp.where(arrival.mask, arrival.value, memory.last_values)
    if arrival.silent is not None:
        silent = arrival.silent & ~jnp.isnan(memory.last_values) & (gains.extra > 0)
        ratio = jnp.where(silent, 1 + gains.extra**2 / (3 * gains.R), ratio)
        value = jnp.where(silent, memory.last_values, arrival.value)
        arrival = arrival._replace(value=value, mask=arrival.mask | silent)
    kf = linear_filter.jump(gains, memory.kf, now, arrival._replace(variance_ratio=ratio))
    has_sample = jnp.any(arrival.mask)  # False if silence is not used and nothing has arrived
    return Memory(jax.tree.map(lambda a, b: jnp.where(has_sample, a, b), kf, memory.kf), last_value)


def innovation(gains: Gains, memory: Memory, now: Now, arrival: Arrival) -> InnovationStats:
    """Return the innovation statistics of the samples that arrive; silence is excluded."""
    ratio = jnp.ones_like(arrival.value)
    return linear_filter.innovation(gains, memory.kf, now, arrival._replace(variance_ratio=ratio))


OBSERVER = Observer(
    init=init,
    snapshot=lambda gains, memory, now: linear_filter.FILTER.snapshot(gains, memory.kf, now),
    jump=jump,
    flow=lambda gains, memory, now: memory._replace(kf=linear_filter.FILTER.flow(gains, memory.kf, now)),
    estimate=lambda gains, memory: linear_filter.estimate(gains, memory.kf),
    covariance=lambda gains, memory, now: linear_filter.covariance(gains, memory.kf, now),
    innovation=innovation,
    uses_silence=True,
)


def design(context: DesignContext, options: Options) -> Design:
    """Return the assumptions; raise UserError for thresholds that do not fit the outputs."""
    where, q = f"kf-event in {context.scenario}", len(context.noise_std)
    if options.threshold is not None and not context.send_threshold:
        raise UserError(
            f"{where}: threshold: got {options.threshold}, expected none, as no sensor has a send_threshold whose silence is "
            "information; leave it out."
        )
    threshold = context.send_threshold or (0.0,) * q if options.threshold is None else options.threshold
    d = np.broadcast_to(np.asarray(threshold, float), q) if np.size(threshold) in (1, q) else None
    if d is None or not (np.isfinite(d) & (d >= 0)).all():
        raise UserError(
            f"{where}: threshold: got {threshold}, expected {q} numbers of 0 or more; write one for each output."
        )
    if context.noise_correlation and d.any():
        raise UserError(f"{where}: got correlated measurement noise, expected independent outputs; use kf.")
    return linear_filter.design(
        context, options, "kf-event", extra=d, reason="the error during silence is not Gaussian"
    )
