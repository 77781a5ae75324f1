"""The columns that only some studies have: of commands and what input costs in loops, of covariances, outliers, chains."""

from collections.abc import Container

from pcbench.statistics import ASKED, RUN_METRICS

AXIS_UNITS = {"command_jitter": "s", "command_loss": "1", "command_std": "unit of the input"}
AXIS_UNITS |= {
    "delay_values": "s",
    "delay_self_transition": "1",
    "delay_weights": "1",
    "delay_gamma_mean": "s",
    "delay_gamma_shape": "1",
}
AXIS_UNITS |= {"delay_sequence": "s"}
AXIS_UNITS |= {"quantization_step": "unit of the output", "dither": "1", "mean_burst_length": "samples"}
AXIS_UNITS |= {"timestamp_offset": "s", "clock_skew": "ppm", "timestamp_jitter": "s"}
AXIS_UNITS |= {"outlier_probability": "1", "outlier_scale": "1", "student_t_dof": "1", "assumed_noise_scale": "1"}
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
    "delay_values": "a sample arrives later by one of these [s], which a Markov chain from sample to sample chooses",
    "delay_self_transition": "probability that the next sample has the same one of delay_values, or else any other "
    "alike; a list where it "
    "depends on the one that is",
    "delay_sequence": "samples arrive later by these [s] in turn, the same in all runs; lost: that one never arrives",
    "delay_weights": "shares of samples, each by itself, that arrive later by each of delay_values, in proportion to these",
    "delay_gamma_mean": "a sample arrives later by a time of a gamma distribution with this mean, in whole ticks",
    "delay_gamma_shape": "shape of that distribution: its mean over its standard deviation, squared",
    "quantization_step": "a sample is rounded to whole steps of this size, which nobody is told; a list where output "
    "channels differ",
    "dither": "1: noise uniform over one step is added before a sample is rounded, and taken off after",
    "mean_burst_length": "mean number of samples in a row that losses take (Gilbert and Elliott); 0: each is lost by itself",
    "timestamp_offset": "a sample's stamp says that it was taken so much later than it was, which nobody is told",
    "clock_skew": "by which the clock of the stamps is fast, from t = 0 on",
    "timestamp_jitter": "a sample's stamp is wrong by up to this much, either way (uniform over whole ticks)",
    "outlier_probability": "that a sample's noise is outlier_scale times what it would be, which nobody is told",
    "outlier_scale": "how many times larger the noise of an outlier is",
    "student_t_dof": "degrees of freedom of Student's t that the noise of samples has, of the same variance, which nobody is "
    "told; inf: it is Gaussian",
    "assumed_noise_scale": "how many times larger than it is the noise of a sample is believed to be",
    "command_jitter": "a command comes to the plant up to this much later (uniform over whole ticks)",
    "command_loss": "probability that a command never comes to the plant, which holds the last one that came",
    "command_std": "standard deviation of one command's noise, which no observer is told",
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
