"""What a scenario is: plant, input, schedule, noise, drift and horizon, in seconds and SI units."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple


class Scenario(NamedTuple):
    """One published experiment. n states, s unknowns beside them, q outputs; the plant's own states, in its order."""

    name: str
    summary: str
    source: str  # paper and section
    plant: str
    observers: tuple[str, ...]
    sampling_period: tuple[float, ...]  # [q] s
    delay: tuple[float | None, ...]  # [q] s; None: one interval, a sample arrives when the next is taken
    noise_std: tuple[float, ...]  # [q] of one sample
    drift: float  # scale of the plant's parameter drift
    input: str  # name in `signals`
    x0: tuple[float, ...]  # [n]
    xhat0: tuple[float, ...]  # [n]
    prior_std: tuple[float, ...]  # [n] of x(0) about xhat(0): P0 is diagonal
    settle_band: tuple[float, ...]  # [n + s] a run has settled when |e| stays within
    bound: float | tuple[float, ...]  # a run has diverged when an |e| leaves it; one for all, or [n + s]
    dt: float = 1e-3  # s, the tick
    horizon: float = 10.0  # s
    tail: float = 3.0  # s, where the tail starts
    drift_intensity: float = 0.0  # process noise through the input a designer assumes where the plant drifts, 1/s
    options: Mapping[str, dict[str, Any]] = MappingProxyType({})  # by observer
    # of the sampling intervals: a name in sampling.PROFILES, or s in turn
    profile: str | tuple[float, ...] = "periodic"
    jitter: float = 0.0  # s, a sample is taken up to this much early or late
    delay_jitter: float = 0.0  # s, a sample arrives up to this much later
    loss: float = 0.0  # probability that a sample never arrives
    process_std: tuple[float, ...] = ()  # [n] of the noise added to each state at every tick; empty: none
    assumed_noise_std: tuple[float, ...] = ()  # [q] what designers assume of channels without noise; empty: none
    assumed_process_std: tuple[float, ...] = ()  # [n] what designers assume where no noise is added; empty: none
    assumed_delay_error: float = 0.0  # s, observers believe samples to be so much older than they are
    parameters: Mapping[str, Any] = MappingProxyType({})  # of the plant, where not its own: what observers do not know
    model: Mapping[str, Any] = MappingProxyType({})  # of the plant, where not its own: what observers do know
    signals: tuple[tuple[str, str], ...] = ()  # (state, unit), where not the plant's own
    unknowns: tuple[tuple[str, str], ...] = ()  # (what observers may estimate beside the states, unit), likewise
    unknown_std: tuple[float, ...] = ()  # [s] their typical size
    unknown_input: str = ""  # name in `signals`, or one for each with commas; empty: the plant has none
    continuous: bool = False  # y is measured at every stage of the integration, without noise or delay
    headline: tuple[str, ...] = ()  # signals that a closing table shows; empty: the first
    unknown0: tuple[float, ...] = ()  # [s] what observers take for the unknowns at the start; empty: zeros
    start_box: tuple[float, ...] = ()  # [n] of a random start: xhat(0) uniform about x(0); empty: x(0) from P0
    controller: str = ""  # of a closed loop: a name in `controllers`; empty: the input is a signal
    control: Mapping[str, Any] = MappingProxyType({})  # its options
    actuator_delay: float | None = None  # s, from command to plant, of a closed loop; None: that of the measurements
    early: bool = False  # measuring began before t = 0: the first sample arrives at 0, the period is between arrivals
    delay_swing: tuple[float, float] = (0.0, 0.0)  # (a [s], w [rad/s]): every delay is delay + a sin(w t), t of arrival
