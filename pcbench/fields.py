"""The fields of a scenario that a study may vary: one record each, the source of axes, columns, units and reference pages.

To add an axis, add a record here, a field of the scenario (`scenarios.scenario`), and the code for its effect. For a time, that
is in `study.times` and `simulation.schedule`. `planning.build` puts any other number into `GridPointParams`, where the
simulation reads it; `simulation.measurements` uses it for measurement noise. `study.fits` refuses invalid combinations.
"""

from collections.abc import Callable
from functools import cache
from typing import NamedTuple


class Limit(NamedTuple):
    """A condition on the numbers of a field, in addition to being finite and of plausible size."""

    holds: Callable[[float], bool]
    expected: str  # the condition as text, at the end of an error message


PROBABILITY = Limit(lambda n: n <= 1, "a probability from 0 to 1; divide a percentage by 100.")
# end of a range: a number; or tick; half: of the shortest interval; period; -period; tail: few samples in it
End = float | str


class Field(NamedTuple):
    """A field of a scenario that may be an axis, its values and its column."""

    name: str
    unit: str  # 1: dimensionless; empty: text
    meaning: str  # of its column
    title: str  # short title in pages
    form: str = "{}"  # value in pages: a text with {} for a number; or times, turns, outputs, states, percent
    # channel, sensor, state, output, value: one, or one per item (outputs: if there are any; values of delay_values)
    per: str = ""
    word: str = ""  # text allowed instead of a number; *: any name
    infinite: str = ""  # meaning of inf
    ticks: bool = False  # whole ticks
    signed: bool = False  # may be below 0
    listed: bool = False  # a value may be a list
    rows: bool = False  # a scenario may have a list per channel
    always: bool = False  # in every table; others only if they are axes
    random: bool = False  # times are drawn in each run
    loop: bool = False  # of loops that a study closes
    limit: Limit | None = None
    search: tuple[End, End] | None = None  # default range of `find-limit`; None: a decade around the scenario's value


FIELDS = (
    Field(
        "sampling_period",
        "s",
        "time between samples (the mean if it varies); a list if output channels differ",
        title="sampling period",
        form="times",
        per="channel",
        ticks=True,
        always=True,
        search=("tick", "tail"),
    ),
    Field(
        "delay",
        "s",
        "time from sampling to arrival (the mean if it varies); a list if output channels differ; null: one sampling "
        "interval",
        title="delay",
        form="times",
        per="channel",
        word="interval",
        ticks=True,
        always=True,
        search=(0.0, "tail"),
    ),
    Field(
        "noise_std",
        "unit of the output",
        "standard deviation of the measurement noise; a list if output channels differ",
        title="measurement noise (std)",
        form="outputs",
        per="channel",
        always=True,
    ),
    Field(
        "parameter_drift",
        "1",
        "scale of the scenario's parameter drift: 0 nominal; on the cart 1 as published, on the arm and "
        "the helicopter its amplitude",
        title="parameter drift",
        signed=True,
        always=True,
        search=(0.0, 2.0),
    ),
    Field(
        "sampling_pattern",
        "",
        "pattern of the sampling intervals: periodic, sine, uniform (random in each run), or a list of intervals [s] "
        "that repeats",
        title="sampling pattern",
        form="times",
        word="*",
        listed=True,
        always=True,
    ),
    Field(
        "sampling_jitter",
        "s",
        "largest shift of a sampling time, earlier or later (uniform over whole ticks)",
        title="sampling jitter",
        form="± {} s",
        per="sensor",
        ticks=True,
        always=True,
        search=(0.0, "half"),
        random=True,
    ),
    Field(
        "delay_jitter",
        "s",
        "largest additional delay of a sample (uniform over whole ticks)",
        title="delay jitter",
        form="0 to {} s",
        per="sensor",
        ticks=True,
        always=True,
        search=(0.0, "tail"),
        random=True,
    ),
    Field(
        "loss",
        "1",
        "probability that a sample is lost",
        title="lost samples",
        form="percent",
        per="sensor",
        always=True,
        limit=PROBABILITY,
        search=(0.0, 0.9),
        random=True,
    ),
    Field(
        "assumed_delay_error",
        "s",
        "assumed delay minus true delay of every sample",
        title="error of the assumed delay",
        form="{} s",
        ticks=True,
        signed=True,
        always=True,
        search=(0.0, "period"),
    ),
    Field(
        "actuator_delay",
        "s",
        "delay from command to plant (the mean if it varies); null: in a closed loop the delay of the samples, in an "
        "open loop none",
        title="actuator delay",
        form="{} s",
        ticks=True,
        always=True,
        search=(0.0, "tail"),
    ),
    Field(
        "process_std",
        "unit of the state",
        "standard deviation of the noise added to each state at every tick; a list if the states differ",
        title="process noise per tick (std)",
        form="states",
        per="state",
    ),
    Field(
        "delay_values",
        "s",
        "possible additional delays [s] of a sample: a Markov chain from sample to sample, or independent with "
        "delay_weights",
        title="additional delay, one of",
        form="times",
        listed=True,
        random=True,
        rows=True,
    ),
    Field(
        "delay_self_transition",
        "1",
        "probability that the next sample has the same additional delay; otherwise each other value is equally likely. "
        "A list: one per value",
        title="probability of the same additional delay",
        per="value",
        limit=Limit(lambda n: n < 1, "a probability below 1, so that the delay changes."),
        search=(0.0, 0.95),
        rows=True,
    ),
    Field(
        "delay_sequence",
        "s",
        "additional delays [s] that repeat in this order, the same in all runs; lost: the sample is lost",
        title="additional delays in this order",
        form="turns",
        word="lost",
        listed=True,
    ),
    Field(
        "delay_weights",
        "1",
        "relative frequencies of the delay_values, drawn independently for each sample",
        title="their relative frequencies (independent)",
        listed=True,
        limit=Limit(lambda n: n > 0, "weights greater than 0; leave that value out."),
        rows=True,
    ),
    Field(
        "delay_gamma_mean",
        "s",
        "mean of a gamma-distributed additional delay, rounded to whole ticks",
        title="additional delay (gamma distribution), mean",
        form="{} s",
        per="sensor",
        search=(0.0, "tail"),
        random=True,
    ),
    Field(
        "delay_gamma_shape",
        "1",
        "shape of the gamma distribution: (mean / standard deviation)^2; 1: exponential",
        title="shape of the gamma distribution",
        per="sensor",
        limit=Limit(lambda n: n > 0, "a shape greater than 0; write 1 for an exponential distribution."),
        search=(0.5, 10.0),
    ),
    Field(
        "outlier_probability",
        "1",
        "probability that a sample is an outlier; the assumed noise contains no outliers",
        title="outliers",
        form="percent",
        per="sensor",
        limit=PROBABILITY,
        search=(0.0, 0.5),
    ),
    Field(
        "outlier_scale",
        "1",
        "factor by which the noise of an outlier is larger",
        title="noise of an outlier",
        form="{} times as large",
        per="sensor",
    ),
    Field(
        "student_t_dof",
        "1",
        "degrees of freedom of noise with a Student's t distribution and the same variance; inf: Gaussian. The assumed "
        "noise is Gaussian",
        title="distribution of the measurement noise",
        form="Student's t, {} degrees of freedom",
        word="inf",
        infinite="Gaussian",
        limit=Limit(
            lambda n: n > 2,
            "more than 2 degrees of freedom, so that Student's t has a variance; write 2.5 or more, or inf for Gaussian noise.",
        ),
        search=(2.1, 30.0),
    ),
    Field(
        "assumed_noise_scale",
        "1",
        "assumed standard deviation of the measurement noise divided by the true one",
        title="assumed measurement noise (std)",
        form="{} times the true one",
        limit=Limit(
            lambda n: n > 0,
            "a number greater than 0: the assumed noise divided by the true one; write 1 if they are equal.",
        ),
        search=(0.1, 10.0),
    ),
    Field(
        "quantization_step",
        "unit of the output",
        "step to whose multiples a sample is rounded; the assumed noise does not contain the rounding. A list if output "
        "channels differ",
        title="quantization step",
        form="outputs",
        per="output",
    ),
    Field(
        "dither",
        "1",
        "1: uniform noise over one quantization step, added before rounding and subtracted afterwards; 0: none",
        title="dither",
        form="subtractive, over one step",
        limit=Limit(lambda n: n in (0, 1), "1 (with subtractive dither) or 0 (without)."),
    ),
    Field(
        "send_threshold",
        "unit of the output",
        "least change of an output since its last sample sent at which its sensor sends a sample (send on delta); 0: every "
        "sample is sent. A list if output channels differ",
        title="samples sent at a change of",
        form="outputs",
        per="output",
    ),
    Field(
        "try_once_discard",
        "1",
        "1: of the outputs sampled together, only the one that has changed most since it was last sent is sent; changes are "
        "divided by send_threshold, if set. 0: all are sent",
        title="protocol",
        form="try-once-discard",
        limit=Limit(lambda n: n in (0, 1), "1 (try-once-discard) or 0 (all outputs)."),
    ),
    Field(
        "mean_burst_length",
        "samples",
        "mean number of consecutive lost samples (Gilbert-Elliott model); 0: independent losses",
        title="mean length of a burst of losses",
        form="{} samples",
        per="sensor",
        search=(2.0, 20.0),
    ),
    Field(
        "sampling_phase",
        "s",
        "time of the first sample; sensors with different phases alternate",
        title="time of the first sample",
        form="{} s",
        per="sensor",
        ticks=True,
    ),
    Field(
        "outage_start",
        "s",
        "start of an outage: all samples taken during it are lost",
        title="start of the outage",
        form="{} s",
        per="sensor",
        ticks=True,
    ),
    Field(
        "outage_duration",
        "s",
        "duration of the outage; 0: no outage",
        title="duration of the outage",
        form="{} s",
        per="sensor",
        ticks=True,
        search=(0.0, "tail"),
    ),
    Field(
        "processor_speed",
        "multiplications/s",
        "speed of each observer's own processor, whose computing time delays the estimate; inf: no limit",
        title="speed of each observer's processor",
        form="{} multiplications/s",
        word="inf",
        infinite="no limit",
        limit=Limit(lambda n: n > 0, "a speed greater than 0; write inf for no limit."),
    ),
    Field(
        "timestamp_offset",
        "s",
        "timestamp minus true sampling time of every sample; the design does not include it",
        title="timestamp offset",
        form="{} s",
        ticks=True,
        signed=True,
        search=("-period", "period"),
    ),
    Field(
        "clock_skew",
        "ppm",
        "relative rate error of the clock that sets the timestamps, from t = 0; positive: fast",
        title="clock skew",
        form="{} ppm",
        signed=True,
        search=(0.0, 1000.0),
    ),
    Field(
        "timestamp_jitter",
        "s",
        "largest random error of a timestamp, earlier or later (uniform over whole ticks)",
        title="timestamp jitter",
        form="± {} s",
        ticks=True,
        search=(0.0, "half"),
        random=True,
    ),
    Field(
        "command_jitter",
        "s",
        "largest additional delay of a command (uniform over whole ticks), in loops with a [controller] table",
        title="command jitter",
        form="0 to {} s",
        ticks=True,
        loop=True,
        search=(0.0, "tail"),
    ),
    Field(
        "command_loss",
        "1",
        "probability that a command is lost and the plant holds the previous one, in loops with a [controller] table",
        title="lost commands",
        form="percent",
        loop=True,
        limit=PROBABILITY,
        search=(0.0, 0.9),
    ),
    Field(
        "command_std",
        "unit of the input",
        "standard deviation of the noise of a command, in loops with a [controller] table; the design does not "
        "include it",
        title="noise of a command (std)",
        loop=True,
    ),
)


@cache
def names(**flags: object) -> tuple[str, ...]:
    """Return the names of the fields with all these values, in order."""
    return tuple(f.name for f in FIELDS if all(getattr(f, key) == value for key, value in flags.items()))
