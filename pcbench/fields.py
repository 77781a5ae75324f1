"""The fields of a scenario that a study may vary: one record each, from which axes, columns, units and pages are derived.

A new axis is a record here, a field of the scenario (`scenarios.scenario`), and the code that gives it its effect. For a time
that is `study.times` and `simulation.schedule`. Any other number is put into `GridPointParams` by `planning.build`, where the
simulation reads it; measurement noise is made from it by `simulation.measurements`. What does not go with it is refused in
`study.fits`.
"""

from collections.abc import Callable
from typing import NamedTuple


class Limit(NamedTuple):
    """What a number of a field must be, besides finite and of a sensible size."""

    holds: Callable[[float], bool]
    expected: str  # the same in words, as a sentence ends with them


PROBABILITY = Limit(lambda n: n <= 1, "a probability from 0 to 1; divide a percentage by 100.")
End = (
    float | str
)  # of a range: a number; or tick; half: of the shortest interval; period; -period; tail: few samples in it


class Field(NamedTuple):
    """A field of a scenario that may be an axis; how a value is given, and what its column holds."""

    name: str
    unit: str  # 1: none; empty: of words
    meaning: str  # of its column
    title: str  # of a page's row, short
    form: str = "{}"  # a value on the page: a text with {} for a number; or times, turns, outputs, states, percent
    # channel, sensor, state, output, value: one, or one for each (outputs: where there is any; of delay_values)
    per: str = ""
    word: str = ""  # that may stand for a number; *: any, a name
    ticks: bool = False  # whole ticks
    signed: bool = False  # may be below 0
    listed: bool = False  # one value may be a list
    always: bool = False  # a column of every table; of others only where they are axes
    random: bool = False  # of times: drawn again in each run
    loop: bool = False  # of loops that a study closes
    limit: Limit | None = None
    search: tuple[End, End] | None = None  # where `find-limit` looks; None: a decade about the scenario's own value


FIELDS = (
    Field(
        "sampling_period",
        "s",
        "(mean) time between samples; a list where output channels differ",
        title="a sample every",
        form="times",
        per="channel",
        ticks=True,
        always=True,
        search=("tick", "tail"),
    ),
    Field(
        "delay",
        "s",
        "age of a sample when it arrives, the mean where it varies with time; a list where output channels differ;"
        " null: one sampling interval",
        title="each late by",
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
        "standard deviation of one sample's noise; a list where output channels differ",
        title="noise of a sample (std)",
        form="outputs",
        per="channel",
        always=True,
    ),
    Field(
        "parameter_drift",
        "1",
        "scale of the scenario's parameter drift: 0 nominal; on the cart 1 as printed, on the arm and the "
        "helicopter its amplitude",
        title="parameter_drift",
        signed=True,
        always=True,
        search=(0.0, 2.0),
    ),
    Field(
        "sampling_pattern",
        "",
        "of the sampling intervals: periodic, sine, uniform (random for each seed), or the intervals [s] in turn",
        title="sampling intervals",
        form="times",
        word="*",
        listed=True,
        always=True,
    ),
    Field(
        "sampling_jitter",
        "s",
        "a sample is taken up to this much early or late (uniform over whole ticks)",
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
        "a sample arrives up to this much later (uniform over whole ticks)",
        title="delay jitter",
        form="up to {} s more",
        per="sensor",
        ticks=True,
        always=True,
        search=(0.0, "tail"),
        random=True,
    ),
    Field(
        "loss",
        "1",
        "probability that a sample never arrives",
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
        "observers assume every sample to be this much older than it is",
        title="observers assume samples older by",
        form="{} s",
        ticks=True,
        signed=True,
        always=True,
        search=(0.0, "period"),
    ),
    Field(
        "actuator_delay",
        "s",
        "from command to plant, the mean where it varies with time; null: in a closed loop that of the samples, "
        "in an open one none",
        title="commands late by",
        form="{} s",
        ticks=True,
        always=True,
        search=(0.0, "tail"),
    ),
    Field(
        "process_std",
        "unit of the state",
        "standard deviation of a tick's noise on the states; a list where they differ",
        title="process noise a tick (std)",
        form="states",
        per="state",
    ),
    Field(
        "delay_values",
        "s",
        "a sample arrives later by one of these [s], which a Markov chain from sample to sample chooses",
        title="delays longer by, a Markov chain",
        form="times",
        listed=True,
        random=True,
    ),
    Field(
        "delay_self_transition",
        "1",
        "probability that the next sample has the same one of delay_values, or else any other alike; a list where "
        "it depends on the one that is",
        title="chance to stay so",
        per="value",
        limit=Limit(lambda n: n < 1, "a probability below 1: a delay that never changes is no chain."),
        search=(0.0, 0.95),
    ),
    Field(
        "delay_sequence",
        "s",
        "samples arrive later by these [s] in turn, the same in all runs; lost: that one never arrives",
        title="delays longer by, in turn",
        form="turns",
        word="lost",
        listed=True,
    ),
    Field(
        "delay_weights",
        "1",
        "shares of samples, each by itself, that arrive later by each of delay_values, in proportion to these",
        title="shares of these, each by itself",
        listed=True,
        limit=Limit(lambda n: n > 0, "shares greater than 0; leave that step out."),
    ),
    Field(
        "delay_gamma_mean",
        "s",
        "a sample arrives later by a time of a gamma distribution with this mean, in whole ticks",
        title="delays longer by a gamma distribution's, mean",
        form="{} s",
        per="sensor",
        search=(0.0, "tail"),
        random=True,
    ),
    Field(
        "delay_gamma_shape",
        "1",
        "shape of that distribution: its mean over its standard deviation, squared",
        title="its shape",
        per="sensor",
        limit=Limit(lambda n: n > 0, "a shape greater than 0; write 1 for an exponential."),
        search=(0.5, 10.0),
    ),
    Field(
        "outlier_probability",
        "1",
        "that a sample's noise is outlier_scale times what it would be, which no observer takes into account",
        title="outliers among samples",
        form="percent",
        per="sensor",
        limit=PROBABILITY,
        search=(0.0, 0.5),
    ),
    Field(
        "outlier_scale",
        "1",
        "how many times larger the noise of an outlier is",
        title="noise of an outlier",
        form="{} times a sample's",
        per="sensor",
    ),
    Field(
        "student_t_dof",
        "1",
        "degrees of freedom of Student's t that the noise of samples has, of the same variance, which no "
        "observer takes into account; inf: it is Gaussian",
        title="noise of samples",
        form="Student's t, {} degrees of freedom",
        word="inf",
        limit=Limit(
            lambda n: n > 2,
            "more than 2 degrees of freedom, so that Student's t has a variance; write 2.5 or more, or inf for Gaussian noise.",
        ),
        search=(2.1, 30.0),
    ),
    Field(
        "assumed_noise_scale",
        "1",
        "how many times larger than it is the noise of a sample is assumed to be",
        title="observers assume noise larger by",
        form="{} times",
        limit=Limit(
            lambda n: n > 0,
            "a number greater than 0: how many times larger noise is assumed to be than it is; write 1 if that is right.",
        ),
        search=(0.1, 10.0),
    ),
    Field(
        "quantization_step",
        "unit of the output",
        "a sample is rounded to whole steps of this size, which no observer takes into account; a list where output "
        "channels differ",
        title="samples rounded to steps of",
        form="outputs",
        per="output",
    ),
    Field(
        "dither",
        "1",
        "1: noise uniform over one step is added before a sample is rounded, and taken off after",
        title="dither",
        form="subtractive, over one step",
        limit=Limit(lambda n: n in (0, 1), "1 (with subtractive dither) or 0 (without)."),
        search=(0.0, 1.0),
    ),
    Field(
        "mean_burst_length",
        "samples",
        "mean number of samples in a row that losses take (Gilbert and Elliott); 0: each is lost by itself",
        title="lost in a row, mean",
        form="{} samples",
        per="sensor",
        search=(2.0, 20.0),
    ),
    Field(
        "sampling_phase",
        "s",
        "time of the first sample; sensors whose phases differ alternate",
        title="first sample at",
        form="{} s",
        per="sensor",
        ticks=True,
    ),
    Field(
        "outage_start",
        "s",
        "start of the time in which no sample that is taken arrives",
        title="no sample arrives that is taken from",
        form="{} s",
        per="sensor",
        ticks=True,
    ),
    Field(
        "outage_duration",
        "s",
        "length of that time; 0: there is none",
        title="for",
        form="{} s",
        per="sensor",
        ticks=True,
        search=(0.0, "tail"),
    ),
    Field(
        "timestamp_offset",
        "s",
        "a sample's stamp says that it was taken so much later than it was, which no observer takes into account",
        title="stamps ahead by",
        form="{} s",
        ticks=True,
        signed=True,
        search=("-period", "period"),
    ),
    Field(
        "clock_skew",
        "ppm",
        "by which the clock of the stamps is fast, from t = 0 on",
        title="clock of stamps fast by",
        form="{} ppm",
        signed=True,
        search=(0.0, 1000.0),
    ),
    Field(
        "timestamp_jitter",
        "s",
        "a sample's stamp is wrong by up to this much, either way (uniform over whole ticks)",
        title="stamps wrong by",
        form="± {} s",
        ticks=True,
        search=(0.0, "half"),
        random=True,
    ),
    Field(
        "command_jitter",
        "s",
        "a command comes to the plant up to this much later (uniform over whole ticks)",
        title="commands later by",
        form="up to {} s more",
        ticks=True,
        loop=True,
        search=(0.0, "tail"),
    ),
    Field(
        "command_loss",
        "1",
        "probability that a command never comes to the plant, which holds the last one that came",
        title="lost commands",
        form="percent",
        loop=True,
        limit=PROBABILITY,
        search=(0.0, 0.9),
    ),
    Field(
        "command_std",
        "unit of the input",
        "standard deviation of one command's noise, which observers do not know of",
        title="noise of a command (std)",
        loop=True,
    ),
)


def names(**wanted: object) -> tuple[str, ...]:
    """Return the names of the fields that have all these values, in order."""
    return tuple(f.name for f in FIELDS if all(getattr(f, key) == value for key, value in wanted.items()))
