"""The columns that only closed loops have: the way of their commands, and what their input costs."""

from collections.abc import Container

from pcbench.statistics import OF_RUN, RUN_METRICS

AXIS_UNITS = {"command_jitter": "s", "command_loss": "1", "command_std": "unit of the input"}
UNITS = dict.fromkeys(
    ("efficiency", "divergence", "unsettled", "cost", "tail_cost"), "1"
)  # of metrics, not the signal's
UNITS |= dict.fromkeys(
    ("input_rms", "tail_input_rms", "pooled_input_rms", "tail_pooled_input_rms"), "unit of the input"
)
MEANING = {
    "command_jitter": "a command comes to the plant up to this much later (uniform over whole ticks)",
    "command_loss": "probability that a command never comes to the plant, which holds the last one that came",
    "command_std": "standard deviation of one command's noise, which no observer is told",
    "cost": "mean of x'Q1 x + u'Q2 u over ticks 0 .. N-1, in a loop with weights; one number a run, with its first signal",
    "tail_cost": "the same from the tail start on",
    "input_rms": "square root of the mean of u'u over ticks 0 .. N-1, in a loop; one number a run, with its first signal",
    "tail_input_rms": "the same from the tail start on",
}


def shown(results: Container[str]) -> list[str]:
    """Return the metrics that a table of runs has columns for: those of loops only where there are such."""
    return [m for m in RUN_METRICS if m in results or m not in OF_RUN]
