"""The fields of a scenario that a study may vary: one record each, from which axes, columns, units and pages are derived.

A new axis is a record here, a field of the scenario (`scenarios.scenario`), and the code that gives it its effect: on times
in `study.times` and `simulation.schedule`, on noise in `simulation.measurements`, on the plant in `planning.build`. What does
not go with it is refused in `study.fits`.
"""

from typing import NamedTuple


class Field(NamedTuple):
    """A field of a scenario that may be an axis; how a value is given, and what its column holds."""

    name: str
    unit: str  # 1: none; empty: of words
    meaning: str  # of its column
    per: str = (
        ""  # channel, sensor, state, output, value: one, or one for each (outputs: where there is any; of delay_values)
    )
    word: str = ""  # that may stand for a number; *: any, a name
    ticks: bool = False  # whole ticks
    signed: bool = False  # may be below 0
    share: bool = False  # a probability
    listed: bool = False  # one value may be a list
    always: bool = False  # a column of every table; of others only where they are axes
    loop: bool = False  # of loops that a study closes


FIELDS = (
    Field(
        "sampling_period",
        "s",
        "(mean) time between samples; a list where output channels differ",
        per="channel",
        ticks=True,
        always=True,
    ),
    Field(
        "delay",
        "s",
        "age of a sample when it arrives, the mean where it varies with time; a list where output channels differ;"
        " null: one sampling interval",
        per="channel",
        word="interval",
        ticks=True,
        always=True,
    ),
    Field(
        "noise_std",
        "unit of the output",
        "standard deviation of one sample's noise; a list where output channels differ",
        per="channel",
        always=True,
    ),
    Field(
        "parameter_drift",
        "1",
        "scale of the scenario's parameter drift: 0 nominal; on the cart 1 as printed, on the arm and the "
        "helicopter its amplitude",
        signed=True,
        always=True,
    ),
    Field(
        "sampling_pattern",
        "",
        "of the sampling intervals: periodic, sine, uniform (random for each seed), or the intervals [s] in turn",
        word="*",
        listed=True,
        always=True,
    ),
    Field(
        "sampling_jitter",
        "s",
        "a sample is taken up to this much early or late (uniform over whole ticks)",
        per="sensor",
        ticks=True,
        always=True,
    ),
    Field(
        "delay_jitter",
        "s",
        "a sample arrives up to this much later (uniform over whole ticks)",
        per="sensor",
        ticks=True,
        always=True,
    ),
    Field("loss", "1", "probability that a sample never arrives", per="sensor", share=True, always=True),
    Field(
        "assumed_delay_error",
        "s",
        "observers believe every sample to be so much older than it is",
        ticks=True,
        signed=True,
        always=True,
    ),
    Field(
        "actuator_delay",
        "s",
        "from command to plant, the mean where it varies with time; null: in a closed loop that of the samples, "
        "in an open one none",
        ticks=True,
        always=True,
    ),
    Field(
        "process_std",
        "unit of the state",
        "standard deviation of a tick's noise on the states; a list where they differ",
        per="state",
    ),
    Field(
        "delay_values",
        "s",
        "a sample arrives later by one of these [s], which a Markov chain from sample to sample chooses",
        listed=True,
    ),
    Field(
        "delay_self_transition",
        "1",
        "probability that the next sample has the same one of delay_values, or else any other alike; a list where "
        "it depends on the one that is",
        per="value",
    ),
    Field(
        "delay_sequence",
        "s",
        "samples arrive later by these [s] in turn, the same in all runs; lost: that one never arrives",
        word="lost",
        listed=True,
    ),
    Field(
        "delay_weights",
        "1",
        "shares of samples, each by itself, that arrive later by each of delay_values, in proportion to these",
        listed=True,
    ),
    Field(
        "delay_gamma_mean",
        "s",
        "a sample arrives later by a time of a gamma distribution with this mean, in whole ticks",
        per="sensor",
    ),
    Field(
        "delay_gamma_shape",
        "1",
        "shape of that distribution: its mean over its standard deviation, squared",
        per="sensor",
    ),
    Field(
        "outlier_probability",
        "1",
        "that a sample's noise is outlier_scale times what it would be, which nobody is told",
        per="sensor",
        share=True,
    ),
    Field("outlier_scale", "1", "how many times larger the noise of an outlier is", per="sensor"),
    Field(
        "student_t_dof",
        "1",
        "degrees of freedom of Student's t that the noise of samples has, of the same variance, which nobody is "
        "told; inf: it is Gaussian",
        word="inf",
    ),
    Field("assumed_noise_scale", "1", "how many times larger than it is the noise of a sample is believed to be"),
    Field(
        "quantization_step",
        "unit of the output",
        "a sample is rounded to whole steps of this size, which nobody is told; a list where output channels differ",
        per="output",
    ),
    Field("dither", "1", "1: noise uniform over one step is added before a sample is rounded, and taken off after"),
    Field(
        "mean_burst_length",
        "samples",
        "mean number of samples in a row that losses take (Gilbert and Elliott); 0: each is lost by itself",
        per="sensor",
    ),
    Field(
        "sampling_phase",
        "s",
        "time of the first sample; sensors whose phases differ alternate",
        per="sensor",
        ticks=True,
    ),
    Field("outage_start", "s", "start of the time in which no sample that is taken arrives", per="sensor", ticks=True),
    Field("outage_duration", "s", "length of that time; 0: there is none", per="sensor", ticks=True),
    Field(
        "timestamp_offset",
        "s",
        "a sample's stamp says that it was taken so much later than it was, which nobody is told",
        ticks=True,
        signed=True,
    ),
    Field("clock_skew", "ppm", "by which the clock of the stamps is fast, from t = 0 on", signed=True),
    Field(
        "timestamp_jitter",
        "s",
        "a sample's stamp is wrong by up to this much, either way (uniform over whole ticks)",
        ticks=True,
    ),
    Field(
        "command_jitter",
        "s",
        "a command comes to the plant up to this much later (uniform over whole ticks)",
        ticks=True,
        loop=True,
    ),
    Field(
        "command_loss",
        "1",
        "probability that a command never comes to the plant, which holds the last one that came",
        share=True,
        loop=True,
    ),
    Field(
        "command_std",
        "unit of the input",
        "standard deviation of one command's noise, which no observer is told",
        loop=True,
    ),
)


def names(**wanted: object) -> tuple[str, ...]:
    """Return the names of the fields that have all these values, in order."""
    return tuple(f.name for f in FIELDS if all(getattr(f, key) == value for key, value in wanted.items()))
