"""What a scenario is: what is true, what drives the plant, how it is measured, what is believed, how runs are judged.

All in seconds and SI units; n states, s unknowns beside them, q outputs, states in the plant's order. The fields of the five
records have names of their own: an axis, a table's column or a user's option says `delay`, and `having` knows where it is. What
an axis means, and its unit, is in `pcbench.fields`.
"""

from collections.abc import Mapping
from math import inf
from types import MappingProxyType
from typing import Any, NamedTuple, TypeGuard

from pcbench.scenarios.sources import Sources
from pcbench.toml_text import TomlTable

NOTHING: Mapping[str, Any] = MappingProxyType({})
ProcessNoise = tuple[float, ...] | tuple[tuple[float, ...], ...]
PerChannel = float | tuple[float, ...]
Rows = tuple[Any, ...]  # numbers, or tuples of numbers where channels differ
LOST = "lost"  # among delays in turn: this sample never arrives
INTERVAL = "interval"  # a delay: a sample arrives when the next is taken; in ticks it is None


class Truth(NamedTuple):
    """What is true of the plant and told to no observer."""

    x0: tuple[float, ...]  # [n]
    parameter_drift: float = 0.0
    parameters: Mapping[str, object] = NOTHING  # of the plant, where they differ from its own
    process_std: ProcessNoise = ()  # [n], or a root [n, n] of the covariance of a tick's noise
    unknown_input: Sources = ""  # what pushes, as `Loop.input` says it; empty: the plant has none


class Loop(NamedTuple):
    """What drives the plant: a signal, or a controller that closes the loop."""

    input: Sources = ""  # of an open loop: name in `signals`, or one for each with commas; or as data
    controller: str = ""  # of a closed loop: a name in `controllers`; empty: the loop is open
    control: Mapping[str, object] = NOTHING  # the controller's options
    actuator_delay: float | None = None  # None: that of samples in a loop, else 0
    command_jitter: float = 0.0
    command_loss: float = 0.0
    command_std: float = 0.0


def per_channel(value: PerChannel, channels: int) -> tuple[float, ...]:
    """Return what each output channel has of a field that is one number, or one for each channel."""
    return value if isinstance(value, tuple) else (value,) * channels


def has_rows(value: object) -> TypeGuard[tuple[Any, ...]]:
    """Return whether a list has a list for each output channel."""
    return isinstance(value, list | tuple) and any(isinstance(row, list | tuple) for row in value)


class Sampling(NamedTuple):
    """How the plant is measured: when samples are taken, when they arrive, how noisy they are.

    A `PerChannel` is one number for all, or [q] where the channels differ; m delay_values. What is [m] may have a tuple for
    each of q channels; a channel whose tuples are empty has no additional delay.
    """

    sampling_period: tuple[float, ...]  # [q]
    delay: tuple[float | str, ...]  # [q] s, or INTERVAL
    noise_std: tuple[float, ...]  # [q]
    noise_correlation: tuple[tuple[float, ...], ...] = ()  # [q, q] between channels; empty: they are independent
    sampling_pattern: str | tuple[float, ...] = "periodic"  # a name in `PROFILES`, or s in turn
    sampling_jitter: PerChannel = 0.0
    delay_jitter: PerChannel = 0.0
    loss: PerChannel = 0.0
    prefilled: bool = False  # measuring began before t = 0: the first sample arrives at 0; periods are of arrivals
    delay_sine: tuple[float, float] = (0.0, 0.0)  # (a [s], w [rad/s]): every delay is delay + a sin(w t), t of arrival
    outlier_probability: PerChannel = 0.0
    outlier_scale: PerChannel = 10.0
    student_t_dof: float = inf
    continuous: bool = False  # y is measured at every stage of the integration, without noise or delay
    delay_values: Rows = ()  # [m]
    delay_self_transition: Rows = ()  # [m] or [1]; empty: 1 / m
    delay_weights: Rows = ()  # [m]; empty: a chain
    delay_gamma_mean: PerChannel = 0.0
    delay_gamma_shape: PerChannel = 1.0  # 1: the distribution is exponential
    quantization_step: tuple[float, ...] = ()  # [q]; empty, 0: samples are not rounded
    dither: float = 0.0
    send_threshold: tuple[float, ...] = ()  # [q]; empty, 0: every sample is sent
    try_once_discard: float = 0.0
    mean_burst_length: PerChannel = 0.0
    sampling_phase: PerChannel = 0.0
    outage_start: PerChannel = 0.0
    outage_duration: PerChannel = 0.0
    processor_speed: float = inf  # of each observer's own, which makes it late
    timestamp_offset: float = 0.0
    clock_skew: float = 0.0
    timestamp_jitter: float = 0.0
    delay_sequence: tuple[float | str, ...] = ()  # s, or LOST

    @property
    def sensors_decide(self) -> bool:
        """Whether sensors decide which samples they send, if only by a threshold of 0."""
        return bool(self.send_threshold or self.try_once_discard)


class Belief(NamedTuple):
    """What designers and observers assume."""

    xhat0: tuple[float, ...]  # [n]
    prior_std: tuple[float, ...]  # [n] of x(0) about xhat(0): P0 is diagonal
    model: Mapping[str, Any] = NOTHING  # the plant's parameters, where they differ from its own
    drift_intensity: float = 0.0  # 1/s, process noise through the input where the plant drifts
    unknown0: tuple[float, ...] = ()  # [s] at the start; empty: zeros
    unknown_std: tuple[float, ...] = ()  # [s] their typical size
    assumed_noise_std: tuple[float, ...] = ()  # [q] for channels without noise; empty: none
    assumed_process_std: tuple[float, ...] = ()  # [n] in place of the plant's process noise; empty: as it is
    assumed_delay_error: float = 0.0
    assumed_noise_scale: float = 1.0
    initial_box: tuple[float, ...] = ()  # [n] a random start draws xhat(0) this close to x(0); empty: x(0), from P0


class Scoring(NamedTuple):
    """What runs are judged by: the signals, and when one has settled or diverged."""

    settle_band: tuple[float, ...]  # [n + s + d], d errors of a user's own: a run has settled when |e| stays within
    divergence_threshold: (
        float | tuple[float, ...]
    )  # a run has diverged when an |e| leaves it; one for all, or [n + s + d]
    steady_start: float = 3.0  # s, where the tail starts
    signals: tuple[tuple[str, str], ...] = ()  # (state, unit), where they differ from the plant's own
    unknowns: tuple[tuple[str, str], ...] = ()  # (what observers may estimate beside the states, unit), likewise
    headline: tuple[str, ...] = ()  # signals that a closing table shows; empty: the first


RECORDS = {
    "truth": Truth._fields,
    "loop": Loop._fields,
    "sampling": Sampling._fields,
    "belief": Belief._fields,
    "scoring": Scoring._fields,
}
STAMPS = ("timestamp_offset", "clock_skew", "timestamp_jitter")
RECORD_OF = {field: record for record, fields in RECORDS.items() for field in fields}
CODE = ("own",)  # functions, which no digest and no file holds


class Scenario(NamedTuple):
    """One published experiment."""

    name: str
    summary: str
    source: str  # paper and section
    plant: str
    observers: tuple[str, ...]
    truth: Truth
    loop: Loop
    sampling: Sampling
    belief: Belief
    scoring: Scoring
    dt: float = 1e-3  # s, the tick
    duration: float = 10.0  # s
    options: Mapping[str, TomlTable] = NOTHING  # by observer
    own: Mapping[str, Any] = NOTHING  # a user's own "plant", "controller" (entry, code); else as named

    def having(self, **changes: object) -> "Scenario":
        """Return the scenario with fields changed, each in the record that has it; raise TypeError for one that none has."""
        new: TomlTable = {}
        for name, value in changes.items():
            record = RECORD_OF.get(name)
            if record:
                new[record] = new.get(record, getattr(self, record))._replace(**{name: value})
            elif name in self._fields and name not in RECORDS:
                new[name] = value
            else:
                raise TypeError(f"a scenario has no field '{name}'")
        return self._replace(**new)

    def value(self, name: str) -> Any:
        """Return the field of a name, from the record that has it."""
        return getattr(getattr(self, RECORD_OF[name]) if name in RECORD_OF else self, name)

    def flat(self) -> TomlTable:
        """Return every field by its name, the records' among them: what digests are made of and `study.toml` says.

        Of a user's own code it is the digest.
        """
        code = {"code": {kind: mine.code.digest for kind, mine in self.own.items()}} if self.own else {}
        fields = {name: value for name, value in self._asdict().items() if name not in (*RECORDS, *CODE)}
        for record in RECORDS:
            fields |= getattr(self, record)._asdict()
        return fields | code
