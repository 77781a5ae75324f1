"""Scenarios: the true plant, its input, its measurement, the assumptions of designs, and the scoring of runs.

All in seconds and SI units; n states, s unknown inputs or parameters, q outputs, states in the plant's order. The field names
of the five records are unique. So an axis, a column or an option can refer to `delay`, and `with_fields` finds its record. The
meaning and unit of an axis are in `pcbench.fields`.
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
Rows = tuple[Any, ...]  # numbers, or tuples of numbers if channels differ
LOST = "lost"  # in `delay_sequence`: the sample is lost
INTERVAL = "interval"  # a delay: a sample arrives when the next is taken; in ticks it is None


class Truth(NamedTuple):
    """True values of the plant, which observers do not use."""

    x0: tuple[float, ...]  # [n]
    parameter_drift: float = 0.0
    parameters: Mapping[str, object] = NOTHING  # of the plant, if they differ from its defaults
    process_std: ProcessNoise = ()  # [n], or a root [n, n] of the covariance of the noise per tick
    unknown_input: Sources = ""  # signal of the unknown input, in the form of `Loop.input`; empty: none


class Loop(NamedTuple):
    """The input of the plant: a signal, or a controller that closes the loop."""

    input: Sources = ""  # of an open loop: name in `signals`, or one per input with commas; or as data
    controller: str = ""  # of a closed loop: a name in `controllers`; empty: the loop is open
    control: Mapping[str, object] = NOTHING  # the controller's options
    actuator_delay: float | None = None  # None: in a closed loop the delay of the samples, else 0
    command_jitter: float = 0.0
    command_loss: float = 0.0
    command_std: float = 0.0


def per_channel(value: PerChannel, channels: int) -> tuple[float, ...]:
    """Return the value of each output channel for a field that is one number, or one per channel."""
    return value if isinstance(value, tuple) else (value,) * channels


def has_rows(value: object) -> TypeGuard[tuple[Any, ...]]:
    """Return whether a list contains a list for each output channel."""
    return isinstance(value, list | tuple) and any(isinstance(row, list | tuple) for row in value)


class Sampling(NamedTuple):
    """The measurement of the plant: sampling times, arrival times, noise.

    A `PerChannel` is one number for all, or [q] if the channels differ; m delay_values. A field of size [m] may have a tuple
    for each of q channels. A channel whose tuples are empty has no additional delay.
    """

    sampling_period: tuple[float, ...]  # [q]
    delay: tuple[float | str, ...]  # [q] s, or INTERVAL
    noise_std: tuple[float, ...]  # [q]
    noise_correlation: tuple[tuple[float, ...], ...] = ()  # [q, q] between channels; empty: independent
    sampling_pattern: str | tuple[float, ...] = "periodic"  # a name in `PROFILES`, or intervals [s] that repeat
    sampling_jitter: PerChannel = 0.0
    delay_jitter: PerChannel = 0.0
    loss: PerChannel = 0.0
    prefilled: bool = False  # sampling began before t = 0: the first sample arrives at 0; periods are between arrivals
    delay_sine: tuple[float, float] = (0.0, 0.0)  # (a [s], w [rad/s]): every delay is delay + a sin(w t), t the arrival
    outlier_probability: PerChannel = 0.0
    outlier_scale: PerChannel = 10.0
    student_t_dof: float = inf
    continuous: bool = False  # y is measured at every stage of the integration, without noise or delay
    delay_values: Rows = ()  # [m]
    delay_self_transition: Rows = ()  # [m] or [1]; empty: 1 / m
    delay_weights: Rows = ()  # [m]; empty: a chain
    delay_gamma_mean: PerChannel = 0.0
    delay_gamma_shape: PerChannel = 1.0  # 1: the distribution is exponential
    quantization_step: tuple[float, ...] = ()  # [q]; empty, 0: no rounding
    dither: float = 0.0
    send_threshold: tuple[float, ...] = ()  # [q]; empty, 0: every sample is sent
    try_once_discard: float = 0.0
    mean_burst_length: PerChannel = 0.0
    sampling_phase: PerChannel = 0.0
    outage_start: PerChannel = 0.0
    outage_duration: PerChannel = 0.0
    processor_speed: float = inf  # of each observer's own processor, which delays the estimate
    timestamp_offset: float = 0.0
    clock_skew: float = 0.0
    timestamp_jitter: float = 0.0
    delay_sequence: tuple[float | str, ...] = ()  # s, or LOST

    @property
    def sensors_decide(self) -> bool:
        """Whether sensors decide which samples they send, even with a threshold of 0."""
        return bool(self.send_threshold or self.try_once_discard)


class Belief(NamedTuple):
    """Assumptions of designs and observers."""

    xhat0: tuple[float, ...]  # [n]
    prior_std: tuple[float, ...]  # [n] of x(0) about xhat(0): P0 is diagonal
    model: Mapping[str, Any] = NOTHING  # the plant's parameters, if they differ from its defaults
    drift_intensity: float = 0.0  # 1/s, process noise through the input if the plant drifts
    unknown0: tuple[float, ...] = ()  # [s] initial estimate; empty: zeros
    unknown_std: tuple[float, ...] = ()  # [s] typical size
    assumed_noise_std: tuple[float, ...] = ()  # [q] for channels without noise; empty: none
    assumed_process_std: tuple[float, ...] = ()  # [n] process noise for designs; empty: the true one
    assumed_delay_error: float = 0.0
    assumed_noise_scale: float = 1.0
    initial_box: tuple[
        float, ...
    ] = ()  # [n] with a random initial state, xhat(0) is drawn this close to x(0); empty: x(0) is drawn from P0


class Scoring(NamedTuple):
    """Scoring of runs: the signals, settling and divergence."""

    settle_band: tuple[float, ...]  # [n + s + d], d user-defined errors: a run has settled when |e| stays within it
    divergence_threshold: (
        float | tuple[float, ...]
    )  # a run has diverged when |e| exceeds it; one for all, or [n + s + d]
    steady_start: float = 3.0  # s, start of the tail
    signals: tuple[tuple[str, str], ...] = ()  # (state, unit), if they differ from the plant's
    unknowns: tuple[tuple[str, str], ...] = ()  # (unknown input or parameter, unit), if they differ from the plant's
    headline: tuple[str, ...] = ()  # signals of the closing table; empty: the first


RECORDS = {
    "truth": Truth._fields,
    "loop": Loop._fields,
    "sampling": Sampling._fields,
    "belief": Belief._fields,
    "scoring": Scoring._fields,
}
STAMPS = ("timestamp_offset", "clock_skew", "timestamp_jitter")
RECORD_OF = {field: record for record, fields in RECORDS.items() for field in fields}
CODE = ("user_code",)  # functions, which are in no digest and no file


class Scenario(NamedTuple):
    """A scenario: one experiment with its source."""

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
    user_code: Mapping[str, Any] = NOTHING  # user-defined "plant", "controller" (entry, code); others as named

    def with_fields(self, **changes: object) -> "Scenario":
        """Return the scenario with changed fields, each in its record; raise TypeError for an unknown field."""
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
        """Return the value of a field of any record."""
        return getattr(getattr(self, RECORD_OF[name]) if name in RECORD_OF else self, name)

    def flat(self) -> TomlTable:
        """Return every field by its name, including those of the records, for digests and `study.toml`.

        For user-defined code the value is its digest.
        """
        code = {"code": {kind: plugin.code.digest for kind, plugin in self.user_code.items()}} if self.user_code else {}
        fields = {name: value for name, value in self._asdict().items() if name not in (*RECORDS, *CODE)}
        for record in RECORDS:
            fields |= getattr(self, record)._asdict()
        return fields | code
