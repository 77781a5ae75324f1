"""Descriptions of the observers' methods: names, sources, and properties. Tests compare the properties with runs."""

from typing import NamedTuple


class Method(NamedTuple):
    """An observer's method, as the reference pages and `pcbench list` describe it."""

    method: str  # full name
    update: str  # use of a measurement, in one or two sentences
    needs: str  # information that the design uses
    source: str = ""  # paper with sections or equations; `citing` searches references.bib for these words
    exact_moments: bool = True  # whether exact moments exist: its estimate on a linear plant is affine in the noise
    c_export: bool = True


CART = "Mohammed, Wang, Tian 2017, doi 10.3906/elk-1606-160"
PCO = "Li, Wang, Tian 2019, PI Piecewise Continuous Observer Design"
CHAIN = "Alipouri, Zhong 2021, doi 10.3390/act10110281"
ARM = "Peng 2017, doi 10.3390/app7010067"
AGES = "the model and the age of each measurement"
FILTER = f"{AGES}, the variances of measurement and process noise, and the prior of the initial state"
DELAY_PRIOR = "the model, a prior of the delay, the noise variances, and the prior of the initial state"
UNKNOWN_INPUT = "a linear model with an unknown input, one constant delay, and a bound"

ACRONYMS = {  # of the papers, which the legend of a table spells out
    "pccebo": "piecewise continuous and current estimator-based observer",
    "kfbo": "Kalman-filter-based observer",
    "pco": "piecewise continuous observer",
    "pi-pco": "proportional-integral piecewise continuous observer",
    "smo": "sliding-mode observer",
    "pio": "proportional-integral observer",
}
METHODS = {
    "pccebo": Method(
        "Piecewise continuous observer with a current estimator",
        "Corrects the estimate at the time of the measurement with a constant gain, and predicts it to the present.",
        f'{AGES}; with `gain = "riccati"`, `"h2"` or `"hinf"` also noise variances',
        f"{CART}, equations (8), (11), (12) and inequality (23)",
    ),
    "kfbo": Method(
        "Kalman-filter-based observer",
        "Uses the held, delayed measurement as if it were continuous, and predicts the estimate over the delay.",
        "the model, one constant delay, and noise intensities",
        f"{CART}, section 5, equations (25) to (29)",
    ),
    "pco": Method(
        "Piecewise continuous observer of reduced order",
        "Uses the measurement as the measured part of the state, corrects the rest with a constant gain, and predicts to the "
        "present. Sampling intervals may vary.",
        AGES,
        f"{PCO}, equations (2), (12), (18) and (19) without the integral",
    ),
    "pi-pco": Method(
        "Piecewise continuous observer of reduced order with an integral",
        "As `pco`, with an integral of the innovation that compensates a constant disturbance.",
        AGES,
        f"{PCO}, equations (2), (12), (14), (18) and (19)",
    ),
    "chain": Method(
        "Chain observer for unequal delays",
        "One link per delay carries the estimate from the sensor with the longest delay to the present. Each link adds the "
        "measurements that have arrived by then.",
        'the model and the constant delay of each sensor, a whole number of samples; with `gain = "riccati"` also noise '
        "variances",
        f"{CHAIN}, Theorem 3, equations (26) and (27)",
    ),
    "equal-delay": Method(
        "Observer for one delay common to all sensors",
        "Treats every measurement as if all sensors had the same delay.",
        "the model and one delay, by default the shortest",
        f"{CHAIN}, Theorem 1 and section 5, Method 2",
    ),
    "no-delay": Method(
        "Observer designed without the delay",
        "Corrects with a gain for zero delay, from the estimate at the time of the measurement (`aligned`) or from the "
        "present estimate (`plain`).",
        "the model; `aligned` also the delay of each sensor",
        f"{CHAIN}, section 5, Method 3",
    ),
    "smo": Method(
        "Sliding-mode observer with unknown-input reconstruction",
        "Injects a smoothed switching signal, which reconstructs the unknown input.",
        f"{UNKNOWN_INPUT} of the unknown input (`rho`)",
        f"{ARM}, sections 3 and 5, equations (21), (23) and (24)",
        exact_moments=False,
    ),
    "pio": Method(
        "Nonlinear integral-type observer",
        "Injects an integral and a sign of the innovation instead of a sliding mode. They reconstruct the unknown input.",
        f"{UNKNOWN_INPUT} of the slope of the unknown input (`xi`)",
        f"{ARM}, sections 4 and 5, equations (35) and (37)",
        exact_moments=False,
    ),
    "high-gain": Method(
        "High-gain observer with an output predictor",
        "Estimates positions, rates and parameters of a nonlinear plant. It predicts the output between measurements.",
        f"{AGES}; the plant must have the form of the source, as `helicopter` has",
        "Hernandez-Gonzalez et al. 2024, equations (6) and (50), doi 10.3390/aerospace11030206",
        exact_moments=False,
    ),
    "eso": Method(
        "Extended state observer (ESO), linear",
        "Estimates the disturbance of a chain of integrators as one more state. One bandwidth places all poles. Corrects at "
        "the time of the measurement, and predicts to the present with the disturbance held.",
        f"{AGES}; the plant must be a chain of integrators with one measured output",
        "Gao 2003, Scaling and bandwidth-parameterization based controller tuning; Miklosovic, Radke, Gao 2006",
    ),
    "cascade-predictor": Method(
        "Cascade predictors",
        "A chain of observers, each of which predicts over a part of the delay. The first uses the delayed output, predicted "
        "between measurements, and the last estimates the present.",
        "the model and one constant delay",
        "Germani, Manes, Pepe 2002, doi 10.1109/9.981726",
    ),
    "cdob": Method(
        "Communication disturbance observer (CDOB)",
        "Estimates the effect of the delay as a disturbance of the input, with one bandwidth, and adds the response to it to "
        "the output. It tends to a Smith predictor as the bandwidth grows.",
        "the model; ages are not used. The plant must be a chain of integrators with one input and one output, not unstable",
        "Natori, Oboe, Ohnishi 2008 (not obtained)",
    ),
    "super-twisting": Method(
        "Super-twisting observer",
        "A second-order sliding mode in position and rate. Corrects at the time of the measurement by an implicit step, which "
        "does not chatter, and predicts tick by tick to the present.",
        f"{AGES}, and a bound of the error of the modelled acceleration (`f`); the plant must have a position and its rate as "
        "states, and one output",
        "Davila, Fridman, Levant 2005",
        exact_moments=False,
    ),
    "finite-time": Method(
        "Finite-time observer with a delay inside",
        "Combines two estimators of different poles with their own past, so that the error is 0 after a number of regular "
        "measurements. Corrects at the time of the measurement, and predicts to the present.",
        AGES,
        "Engel, Kreisselmeier 2002, doi 10.1109/TAC.2002.800673",
    ),
    "high-gain-predictor": Method(
        "Sampled high-gain observer with an inter-sample output predictor",
        "Multiplies the difference between a predicted and an estimated output by a constant gain. The predicted output is "
        "the measurement at each sample, and follows the model between samples.",
        "the model; the plant has one output",
        "Karafyllis, Kravaris 2009 (not obtained)",
    ),
    "interval": Method(
        "Interval observer",
        "Corrects at the time of the measurement with a constant gain, and predicts to the present. It also computes an "
        "interval of each state, which contains the state for all noise within given bounds.",
        f"{AGES}, and bounds of measurement noise, process noise and the initial error, by default 6 standard deviations",
        "after Mazenc, Dinh 2014 (not obtained)",
    ),
    "lmi-sampled": Method(
        "Sampled-data observer with held innovations and an LMI gain",
        "Holds the innovation of each output until the next one arrives, and multiplies it by a constant gain. A certificate "
        "covers all intervals between samples up to a limit, of each output on its own.",
        "the model and the longest interval between samples; for a nonlinear plant also `parameter_range`, which must "
        "contain its slopes",
        "functional of Fridman 2010 (not obtained)",
    ),
    "ekf": Method(
        "Extended Kalman filter (EKF)",
        "Updates at the time of the measurement with Jacobians at the estimate, and predicts tick by tick to the present. "
        "Estimates unknown inputs and parameters as random walks.",
        FILTER,
        "Jazwinski 1970, chapter 8",
    ),
    "kf": Method(
        "Kalman filter with delay compensation",
        "Updates at the time of the measurement with the gain of that time, and predicts to the present. It filters again "
        "all newer measurements. Optionally estimates an input bias, or an unknown input as a random walk.",
        FILTER,
        "Kalman 1960",
    ),
    "ekf-iterated": Method(
        "Iterated extended Kalman filter",
        "As `ekf`, but linearises the sensor again at each corrected estimate.",
        FILTER,
        "Bell, Cathey 1993, doi 10.1109/9.250476",
    ),
    "ukf": Method(
        "Unscented Kalman filter, or cubature Kalman filter",
        "As `ekf`, but propagates mean and covariance by sigma points instead of Jacobians.",
        FILTER,
        "Julier, Uhlmann 1997, doi 10.1117/12.280797; weights: Wan, van der Merwe 2000; cubature: Arasaratnam, Haykin 2009",
    ),
    "mhe": Method(
        "Moving-horizon estimator",
        "Finds the most likely states at the newest measurements, within bounds, by a fixed number of Gauss-Newton steps.",
        FILTER,
        "Rao, Rawlings, Mayne 2003, doi 10.1109/TAC.2002.808470",
    ),
    "particle": Method(
        "Bootstrap particle filter with systematic resampling",
        "Weights random particles by each measurement at the time it was taken, and resamples if too few are effective.",
        FILTER,
        "Gordon, Salmond, Smith 1993, doi 10.1049/ip-f-2.1993.0015; resampling: Kitagawa 1996",
        exact_moments=False,
        c_export=False,
    ),
    "kf-event": Method(
        "Kalman filter for send on delta",
        "As `kf`. If a sensor sends no sample, the last value received is used with a larger variance.",
        f"{AGES}, the variances of measurement and process noise, the prior of the initial state, and the `send_threshold`",
        "Nguyen, Suh 2008, doi 10.3390/s8020897",
        exact_moments=False,
        c_export=False,
    ),
    "kf-ignore-delay": Method(
        "Kalman filter that ignores delays",
        "Uses a delayed measurement as if it had just been taken.",
        "the model, the noise variances, and the prior of the initial state; ages are not used",
        "Kalman 1960",
    ),
    "kf-drop-delayed": Method(
        "Kalman filter that drops old measurements",
        "As `kf`, but drops measurements that are older than `max_age`.",
        FILTER,
        "Kalman 1960",
    ),
    "kf-reprocess": Method(
        "Kalman filter with reprocessing",
        "Goes back over the `keep` newest measurements and filters them again in the order in which they were taken.",
        FILTER,
        "Moore, Stouch 2014",
    ),
    "kf-cloning": Method(
        "Kalman filter with stochastic cloning",
        "Updates through a copy of the state from the time at which the measurement was taken.",
        FILTER,
        "Roumeliotis, Burdick 2002",
    ),
    "kf-larsen": Method(
        "Kalman filter that extrapolates measurements",
        "Extrapolates a delayed measurement to the present, with the gain for the extrapolated error.",
        FILTER,
        "Larsen, Andersen, Ravn, Poulsen 1998",
    ),
    "kf-alexander": Method(
        "Kalman filter with an early covariance update",
        "Updates the covariance when a measurement is taken, and the estimate when it arrives.",
        FILTER,
        "Alexander 1991",
    ),
    "kf-delayed-horizon": Method(
        "Kalman filter with a delayed fusion horizon",
        "Uses all measurements when they are `lag` old, and predicts to the present. Measurements that arrive later are lost.",
        FILTER,
        "Khosravian, Trumpf, Mahony, Hamel 2015",
    ),
    "kf-shifted-innovation": Method(
        "Kalman filter with a shifted innovation",
        "Adds the innovation of a delayed measurement to the present estimate, after it subtracts the motion that the input "
        "has caused since.",
        FILTER,
        "WPILib, pose estimators",
    ),
    "oosm-a1": Method(
        "Out-of-sequence update by one step of exact retrodiction",
        "Predicts backwards to the time of an out-of-sequence measurement, over at most one update. Older ones are lost.",
        f"{FILTER}; the plant's motion must be invertible",
        "Bar-Shalom 2002, algorithm A",
    ),
    "oosm-b1": Method(
        "Out-of-sequence update by one step of approximate retrodiction",
        "As `oosm-a1`, but neglects the process noise in between.",
        f"{FILTER}; the plant's motion must be invertible",
        "Bar-Shalom 2002, algorithm B",
    ),
    "oosm-lag": Method(
        "Out-of-sequence update by retrodiction over several steps",
        "Predicts backwards over up to `keep` updates as if they were one update.",
        f"{FILTER}; the plant's motion must be invertible",
        "Bar-Shalom, Chen, Mallick 2004, the first of two algorithms",
        c_export=False,
    ),
    "ekf-delay": Method(
        "Extended Kalman filter with the delay as a state",
        "Estimates the state and the delay jointly, from the motion that a measurement shows.",
        DELAY_PRIOR,
        "Nilsson, Skog, Haendel 2010",
        exact_moments=False,
    ),
    "mmae-delay": Method(
        "Multiple-model adaptive estimation of the delay",
        "Runs one Kalman filter per candidate delay, and weights them by the likelihood of the measurements.",
        DELAY_PRIOR,
        "Magill 1965",
        exact_moments=False,
    ),
    "model-only": Method(
        "Model without measurements",
        "Simulates the model from the initial estimate. It is the reference that every observer must improve on.",
        "the model",
    ),
}
