"""The columns that only some studies have: of commands and what input costs in loops, of covariances, outliers, chains."""

from collections.abc import Container

from pcbench.statistics import ASKED, RUN_METRICS

UNITS = dict.fromkeys(
    (
        *(
            "rms_efficiency",
            "divergence_rate",
            "unsettled_rate",
            "lq_cost",
            "steady_lq_cost",
            "nees",
            "nees_dof",
            "signal_nees",
        ),
        *("nis", "nis_dof", "nees_band", "nis_band", "signal_nees_band"),
        *("coverage_1_sigma", "coverage_2_sigma", "coverage_3_sigma"),
    ),
    "1",
)  # of metrics, not the signal's
UNITS |= dict.fromkeys(
    ("input_rms", "steady_input_rms", "pooled_input_rms", "steady_pooled_input_rms"), "unit of the input"
)
CONSISTENCY = (
    "coverage_1_sigma, coverage_2_sigma, coverage_3_sigma, the fraction of runs whose error at tick N-1 is within so "
    "many of the "
    "standard deviations that the observer believes (Wilson's); or nees_band, nis_band, signal_nees_band, whose interval is "
    "the 95 % band of such means of a true covariance (chi-square)"
)
MEANING = {
    "lq_cost": "mean of (x - x_ref)'Q1 (x - x_ref) + (u - u_ref)'Q2 (u - u_ref) over ticks 0 .. N-1, "
    "in a loop with weights; one number a run, with its first signal",
    "steady_lq_cost": "the same from the tail start on",
    "input_rms": "square root of the mean of u'u over ticks 0 .. N-1, in a loop; one number a run, with its first signal",
    "steady_input_rms": "the same from the tail start on",
    "nees": "e' P^-1 e / n at tick N-1, P the covariance that the observer believes its error of the plant's n states to have, "
    "less those it knows: 1 on average of a true one; one number a run, with its first signal",
    "nees_dof": "the n of nees",
    "nis": "nu' S^-1 nu of all samples that came in the order in which they were taken, over how many numbers these were; nu "
    "is what a sample is beyond what the observer expected, S the covariance that it believes nu to have; one number a run, "
    "with its first signal; null: no sample was judged; in stats all squares of all runs over all numbers",
    "nis_dof": "how many numbers nis is over",
    "signal_nees": "e^2 over the variance that the observer believes it to have, at tick N-1; null: it knows this state",
}


def shown(results: Container[str]) -> list[str]:
    """Return the metrics that a table of runs has columns for: those of loops and of covariances only where there are such."""
    return [m for m in RUN_METRICS if m in results or m not in ASKED]
