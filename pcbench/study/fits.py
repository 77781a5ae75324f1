"""Checks whether a grid point can be run: times, measurement errors and loops that fit its tick, duration and observers."""

import itertools
import math
from collections.abc import Iterator

import numpy as np

from pcbench import fields
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.plants import drifts, nonlinear, numbers_of, states_of
from pcbench.plants import entry_of as plant_of
from pcbench.scenarios import INTERVAL, Belief, Sampling, Scenario
from pcbench.scenarios.scenario import LOST, STAMPS, PerChannel, per_channel
from pcbench.simulation.schedule.sampling import ages, gamma_quantile, intervals
from pcbench.study.axes import AXES, plain
from pcbench.study.times import SENSOR_FIELDS, clocks, number, require_few_samples, sensors, to_ticks

# axes that make delays vary from sample to sample, except a jitter
DELAY_AXES = ("delay_values", "delay_sequence", "delay_gamma_mean")
TIMESTAMP_AXES = ("clock_skew", "timestamp_jitter")  # axes that make assumed delays vary
RANDOM_AXES = fields.names(random=True)  # axes that give each run its own times
OF_OUTPUTS = ("quantization_step", "send_threshold")  # empty, or zeros: without effect
REACH = 10  # times the duration: a later sample never arrives


def fits(s: Scenario, where: str) -> None:
    """Raise UserError if times do not fit together, or if a measurement error is impossible or has no effect."""
    each_sensor = list(sensors(s))
    misfits = itertools.chain(
        _of_continuous(s),
        _of_loop(s),
        _of_clocks(s, each_sensor),
        _of_sensors(s, each_sensor),
        _of_correlation(s),
        _of_delays(s, each_sensor),
        _of_stamps(s),
        _of_trigger(s),
        _of_processor(s),
    )
    if sentence := next(misfits, ""):
        raise UserError(f"{where}: {sentence}")
    if not s.sampling.continuous:
        require_few_samples(clocks(s), to_ticks(s.duration, s), s.dt, where)


def _of_continuous(s: Scenario) -> Iterator[str]:
    """Yield a sentence for each sampling axis of a scenario with continuous measurements."""
    if not s.sampling.continuous:
        return
    q = len(s.sampling.delay)
    defaults = {"sampling_period": (s.dt,) * q, "delay": (0.0,) * q, "noise_std": (0.0,) * q}
    defaults |= Sampling._field_defaults | Belief._field_defaults
    for name, value in ((name, defaults[name]) for name in AXES if name in defaults):
        if s.value(name) != value and (name not in OF_OUTPUTS or any(s.value(name))):
            yield (
                f"got {name} = {plain(name, s.value(name))} in {s.name}, whose measurements are continuous and without noise, "
                "expected no such axis; leave it out, or use a scenario with samples, such as arm/sampled."
            )


def _of_loop(s: Scenario) -> Iterator[str]:
    """Yield a sentence for each delay that a closed loop cannot have, and for a drift without effect."""
    sampling, actuator_delay = s.sampling, s.loop.actuator_delay
    # of a loop for any plant the sampler is any: its commands have a delay of their own
    if s.loop.controller and sampling.prefilled:
        if sampling.delay_sequence:
            yield (
                f"got delay_sequence in {s.name}, whose sampling began before t = 0, expected one delay of the "
                "samples; leave it out, or close the loop of another scenario (see pcbench guide closed-loops)."
            )
        if any(clock.random for clock in clocks(s)):
            yield (
                f"got a random schedule in {s.name}, whose sampling began before t = 0, expected one schedule for "
                f"all runs; leave {', '.join(RANDOM_AXES)} and the sampling_pattern 'uniform' out."
            )
        if INTERVAL in sampling.delay:
            yield f"got a delay of one interval in {s.name}, expected seconds: sampling began before t = 0; write a number."
        if len(set(sampling.delay)) > 1:
            delays = ", ".join(f"{d:g}" for d in sampling.delay if not isinstance(d, str))
            yield f"got delays of {delays} s in {s.name}, expected one for all channels; write one number."
        least = 0.0 if actuator_delay is not None else s.dt / 2
        yield from _too_short(s, "delay", float(sampling.delay[0]), least)
        if actuator_delay is not None:
            yield from _too_short(s, "actuator_delay", actuator_delay, s.dt / 2)
    if s.truth.parameter_drift and not drifts(s):
        yield (
            f"got a parameter_drift of {s.truth.parameter_drift:g} in {s.name}, which has no parameter drift, expected 0; "
            "leave it out."
        )


def _too_short(s: Scenario, name: str, mean: float, least: float) -> Iterator[str]:
    """Yield a sentence if a delay of a loop, with its variation, falls below `least` [s]; a constant 0 is allowed."""
    (amplitude, omega), t = s.sampling.delay_sine, (np.arange(to_ticks(s.duration, s) + 1) + 0.5) * s.dt
    lowest = mean + float(np.min(amplitude * np.sin(omega * t)))
    if lowest < least - 1e-9 and (amplitude or mean):
        minimum = math.ceil((mean - lowest + least) / s.dt - 1e-6) * s.dt
        yield f"got {name} = {mean:g} s in {s.name}, " + (
            f"which falls to {max(lowest, 0):g} s or less as it varies, expected at least half a tick on the way to the "
            f"plant, and never below 0; write at least {minimum:g}."
            if amplitude
            else f"expected 0 or at least half a tick; write {minimum:g}."
        )


def _of_clocks(s: Scenario, each_sensor: list[Scenario]) -> Iterator[str]:
    """Yield a sentence for each delay beyond the run, and for each jitter or assumed delay that does not fit."""
    ticks, error = to_ticks(s.duration, s), s.belief.assumed_delay_error
    for sensor in each_sensor:  # checked before the delay values are listed
        mean, shape = number(sensor.sampling.delay_gamma_mean), number(sensor.sampling.delay_gamma_shape)
        if not mean or s.sampling.continuous:
            continue
        if not (latest := gamma_quantile(mean, shape)) <= REACH * s.duration:
            yield (
                f"got delay_gamma_mean = {mean:g} s with delay_gamma_shape = {shape:g}, with which one of 10,000 samples "
                f"has a delay above {latest:.3g} s, expected at most {REACH:g} times the duration of {s.duration:g} s; write a "
                "smaller mean."
            )
    for clock in clocks(s):
        least = intervals(clock._replace(jitter=0), ticks + clock.jitter)[0]
        if clock.jitter and 2 * clock.jitter >= least:
            yield (
                f"got a sampling_jitter of {clock.jitter * s.dt:g} s with intervals down to {least * s.dt:g} s, expected less "
                f"than half the shortest interval, so that samples stay in order; write at most {(least - 1) // 2 * s.dt:g}."
            )
        youngest, lead = ages(clock, ticks)[0], clock.stamp.max_errors(ticks)[1]
        if lead > (assumed_delay := youngest + to_ticks(error, s)) and lead:
            yield (
                f"got timestamps up to {lead * s.dt:g} s after the sampling in {s.name}, whose shortest delay is "
                f"{assumed_delay * s.dt:g} s, expected no arrival before its timestamp; use smaller timestamp errors, a "
                "negative timestamp_offset, or a longer delay."
            )
        if youngest * s.dt + error < -1e-9:
            yield (
                f"got an assumed_delay_error of {error:g} s with a shortest delay of {youngest * s.dt:g} s, "
                f"expected an assumed delay of 0 or more; write at least {-youngest * s.dt:g}."
            )


def _of_sensors(s: Scenario, each_sensor: list[Scenario]) -> Iterator[str]:
    """Yield a sentence for each noise, loss or delay of a sensor that is impossible or has no effect."""
    for sensor in each_sensor:
        sampling, belief = sensor.sampling, sensor.belief
        noiseless = not any(sampling.noise_std)
        if belief.assumed_noise_scale != 1 and noiseless and not any(belief.assumed_noise_std):
            yield (
                f"got assumed_noise_scale = {belief.assumed_noise_scale:g} in {s.name}, whose assumed noise is 0, "
                "expected a noise_std above 0; write one, or leave it out."
            )
        if noiseless and np.isfinite(sampling.student_t_dof):
            yield (
                f"got student_t_dof = {sampling.student_t_dof:g} in {s.name}, whose samples have no noise, expected a "
                "noise_std above 0; write one, or leave it out."
            )
        if noiseless and sampling.outlier_probability:
            yield (
                f"got outlier_probability = {sampling.outlier_probability:g} in {s.name}, whose samples have no noise, "
                "expected a noise_std above 0; write one, or leave it out."
            )
        values, weights, mean = sampling.delay_values, sampling.delay_weights, sampling.delay_gamma_mean
        if weights and len(weights) != len(values):
            yield (
                f"got {len(weights)} values of delay_weights for {len(values)} delay_values, expected one for each; "
                "write as many weights as values."
            )
        if weights and sampling.delay_self_transition:
            yield (
                "got delay_weights and delay_self_transition, expected one of them: delays are independent or a Markov chain; "
                "leave one out."
            )
        if mean and values:
            yield f"got delay_gamma_mean = {mean:g} and delay_values, expected one of them; leave one out."
        loss, burst = number(sampling.loss), number(sampling.mean_burst_length)
        if not burst or (s.sampling.loss and not loss):  # the mean burst length applies to channels that lose samples
            continue
        got = f"got mean_burst_length = {burst:g} in {s.name} with a loss of {loss:g}, expected "
        if not 0 < loss < 1:
            yield f"{got}a loss between 0 and 1; write one, or leave mean_burst_length out."
        elif burst < max(1, loss / (1 - loss)) * (1 - 1e-12):
            least = max(1, loss / (1 - loss))
            yield f"{got}at least {least:g} samples, the shortest mean length with this loss; write more."


def _of_correlation(s: Scenario) -> Iterator[str]:
    """Yield a sentence if the noise of the channels cannot be correlated as given."""
    rows, q = s.sampling.noise_correlation, len(s.sampling.delay)
    if not rows:
        return
    rho = np.array(rows) if {len(row) for row in rows} == {len(rows)} else np.zeros((0, 0))
    if rho.shape != (q, q) or (rho != rho.T).any() or (np.diag(rho) != 1).any():
        yield (
            f"got noise_correlation = {[list(row) for row in rows]} in {s.name}, expected {q} rows of {q} numbers: "
            "symmetric, with ones on the diagonal."
        )
    elif np.linalg.eigvalsh(rho)[0] <= 0:
        yield (
            f"got noise_correlation = {[list(row) for row in rows]} in {s.name}, expected every eigenvalue above 0; bring its "
            "entries closer to 0."
        )
    elif len(clocks(s)) > 1 or s.sampling.continuous:
        yield (
            f"got noise_correlation in {s.name}, whose channels are not sampled together, expected one period, delay and "
            "network for all of them; leave it out."
        )
    elif not all(s.sampling.noise_std):
        yield f"got noise_correlation in {s.name} with a noise_std of 0, expected noise in every channel; write its noise_std."


def _of_delays(s: Scenario, each_sensor: list[Scenario]) -> Iterator[str]:
    """Yield a sentence for each field without effect, and for delays that cannot be a Markov chain or a sequence."""
    for name, needs in (("outlier_scale", "outlier_probability"), ("delay_gamma_shape", "delay_gamma_mean")):
        if not s.value(needs) and s.value(name) != Sampling._field_defaults[name]:
            article = "an" if needs[0] in "aeiou" else "a"
            yield (
                f"got {name} = {plain(name, s.value(name))} in {s.name} with {article} {needs} of 0, so it has no effect, "
                "expected both or neither; leave it out."
            )
    for sensor in each_sensor:
        values, stay = sensor.sampling.delay_values, sensor.sampling.delay_self_transition
        if stay and not values:
            yield (
                f"got delay_self_transition in {s.name} without delay_values, so it has no effect, expected both or neither; "
                "write delay_values = [0.0, ...], or leave it out."
            )
        if len(values) == 1 or len(set(values)) < len(values):
            yield (
                f"got delay_values of {plain('delay_values', values)} s, expected two or more different values; write "
                "a constant delay as delay."
            )
        if len(stay) not in (0, 1, len(values)):
            yield (
                f"got {len(stay)} values of delay_self_transition for {len(values)} delay_values, expected one, or one for "
                "each."
            )
    sequence = s.sampling.delay_sequence
    if sequence and set(sequence) == {LOST}:
        yield f"got delay_sequence in {s.name} of which all are '{LOST}', expected a delay among them; write one."
    random_axes = [name for name in RANDOM_AXES if s.value(name)]
    random_axes += ["sampling_pattern 'uniform'"] if s.sampling.sampling_pattern == "uniform" else []
    if sequence and random_axes:
        yield (
            f"got {random_axes[0]} with delay_sequence in {s.name}, expected one of them: the sequence is the same in all "
            "runs, and the other one is random in each run; leave one out."
        )
    if s.sampling.dither and not any(s.sampling.quantization_step):
        yield (
            f"got dither = 1 in {s.name}, whose samples are not rounded, expected a quantization_step above 0; write one, or "
            "leave it out."
        )


def _of_stamps(s: Scenario) -> Iterator[str]:
    """Yield a sentence if timestamps would not be in the order of the samples, or if a clock skew has no effect."""
    skew, ticks = abs(s.sampling.clock_skew), to_ticks(s.duration, s)
    if skew and round(1e-6 * skew * ticks) == 0:
        yield (
            f"got a clock_skew of {s.sampling.clock_skew:g} ppm in {s.name}, which moves no timestamp by half a tick "
            f"({s.dt / 2:g} s) within the duration, so no result would change; write more than {5e5 / ticks:.3g} ppm, use a "
            "shorter tick, or leave it out."
        )
    if skew > 1e5:
        yield f"got a clock_skew of {skew:g} ppm, expected at most 100,000; write a smaller one."
    for clock in clocks(s):
        least = intervals(clock, ticks)[0]
        if clock.stamp.jitter and 2 * clock.stamp.jitter >= least * (1 - 1e-6 * skew) - 1:
            yield (
                f"got a timestamp_jitter of {s.sampling.timestamp_jitter:g} s with intervals down to {least * s.dt:g} s, "
                "expected less than half the shortest interval, so that timestamps stay in order; write at most "
                f"{max((least - 2) // 2, 0) * s.dt:g}."
            )


def _of_trigger(s: Scenario) -> Iterator[str]:
    """Yield a sentence if sensors cannot decide which samples they send, or if a protocol has no effect."""
    sampling = s.sampling
    axis = "try_once_discard" if sampling.try_once_discard else "send_threshold"
    if not sampling.try_once_discard and not any(sampling.send_threshold):
        return
    if sampling.prefilled:
        yield (
            f"got {axis} in {s.name}, whose sampling began before t = 0, expected samples from t = 0 on; leave it out, or "
            "close the loop of another scenario."
        )
    if np.isfinite(sampling.processor_speed):
        yield f"got {axis} with a processor_speed, expected one of them; leave one out."
    sensor_clocks = clocks(s)
    is_random = any(c.jitter or c.profile == "uniform" for c in sensor_clocks)
    if sampling.try_once_discard and (
        len({(c.period, c.phase, c.profile) for c in sensor_clocks}) > 1 or is_random * len(sensor_clocks) > 1
    ):
        yield (
            f"got try_once_discard = 1 in {s.name}, whose outputs are sampled at different times, expected one "
            "sampling_period and one sampling_phase, and delays that are equal if sampling times are random; make them equal."
        )
    if sampling.try_once_discard and any(sampling.send_threshold) and not all(sampling.send_threshold):
        thresholds = plain("send_threshold", sampling.send_threshold)
        yield (
            f"got try_once_discard = 1 with the send_threshold {thresholds}, expected all thresholds above 0, or none: changes "
            "are compared in units of them; write the others."
        )
    if sampling.try_once_discard and len(sampling.delay) == 1:
        yield f"got try_once_discard = 1 in {s.name}, which has one output, expected two or more; leave it out."


def _of_processor(s: Scenario) -> Iterator[str]:
    """Yield a sentence if samples are not the regular ones of one sensor, which the schedule of a processor takes in turn."""
    speed, sensor_clocks = s.sampling.processor_speed, clocks(s)
    if s.sampling.continuous or not np.isfinite(speed):
        return
    misfits = [name for name in RANDOM_AXES if s.value(name)]
    misfits += ["sampling_pattern"] if s.sampling.sampling_pattern != "periodic" else []
    misfits += ["delay_sequence"] if s.sampling.delay_sequence else []
    misfits += ["prefilled"] if s.sampling.prefilled else []
    misfits += ["channels that differ"] if len({(c.period, c.delay, c.phase) for c in sensor_clocks}) > 1 else []
    if misfits:
        yield (
            f"got processor_speed = {speed:g} with {', '.join(misfits)}, expected regular samples of one sensor; "
            "leave one of them out."
        )


def works_on(label: str, entry: ObserverSpec, s: Scenario, where: str) -> None:
    """Raise UserError if an observer does not support a scenario."""
    if sentence := next(itertools.chain(_model_refusals(label, entry, s), _schedule_refusals(label, entry, s)), ""):
        raise UserError(f"{where}: {label} in {s.name} got {sentence}")


def _model_refusals(label: str, entry: ObserverSpec, s: Scenario) -> Iterator[str]:
    """Yield why an observer does not support the plant or the loop, what it needs, and which observer supports it."""
    if nonlinear(s) and not entry.nonlinear:
        residual = plant_of(s).residual
        change = np.ones(0) if residual is None else residual(numbers_of(s))
        if change.any():
            i = int(np.argmax(np.abs(change)))
            yield (
                f"an operating point that is no equilibrium ({states_of(s)[i][0]} changes by itself, by {change[i]:.3g}), "
                f"expected an equilibrium, which a linear model needs; move the point, leave {label} out, or use ekf."
            )
        if residual is None:
            alternatives = ", ".join(name for name, spec in OBSERVERS.items() if spec.nonlinear)
            yield (
                f"a nonlinear plant, expected one with a linear model; leave {label} out, or use one of {alternatives}."
            )
    if s.loop.controller and not entry.loops:
        yield (
            "a closed loop, expected an open one: it needs older inputs than a loop stores; "
            f"leave {label} out, or use ekf."
        )
    if s.sampling.continuous and entry.observer.field is None:
        alternatives = ", ".join(name for name, spec in OBSERVERS.items() if spec.observer.field)
        yield (
            f"continuous measurements, expected samples: it has no continuous-time form; leave {label} out, use one "
            f"of {alternatives}, or use a scenario with samples."
        )


def _schedule_refusals(label: str, entry: ObserverSpec, s: Scenario) -> Iterator[str]:
    """Yield why an observer does not support the schedule, what it needs, and which observer supports it."""
    sampling = s.sampling
    is_periodic = sampling.sampling_pattern == "periodic"
    is_interval = INTERVAL in sampling.delay and not (is_periodic and not sampling.sampling_jitter)
    delay_axes = [name for name in (*DELAY_AXES, *TIMESTAMP_AXES) if s.value(name)]
    if entry.takes == "one constant delay" and (sampling.delay_jitter or delay_axes or is_interval):
        varies = ", ".join(delay_axes) or "a delay of one interval that varies"
        yield (
            f"{f'a delay_jitter of {_list_values(sampling.delay_jitter)} s' if sampling.delay_jitter else varies}, expected "
            f"one constant delay: it does not use the age of a sample; leave {label} out, or use pccebo, pco or kf."
        )
    if entry.takes == "constant delays":
        shifts = ("delay_jitter", "sampling_jitter", "sampling_phase")
        variations = [f"a {name} of {_list_values(v)} s" for name in shifts if np.any(v := s.value(name))]
        variations += delay_axes
        variations += (
            [] if is_periodic else [f"the sampling_pattern {plain('sampling_pattern', sampling.sampling_pattern)}"]
        )
        if variations:
            yield (
                f"{', '.join(variations)}, expected regular samples with constant delays, the first at t = 0; leave "
                f"{label} out, or use kf."
            )
    if entry.observer.uses_silence and any(sampling.send_threshold):
        causes = ("loss", "outage_duration", "delay_jitter", "sampling_jitter", *DELAY_AXES)
        silences = [name for name in causes if np.any(s.value(name))] + ([] if is_periodic else ["sampling_pattern"])
        if silences:
            yield (
                f"{', '.join(silences)} with a send_threshold, expected a network that delivers every sample in time, so that "
                f"silence means that none was sent; leave {label} out, or use kf."
            )
    if entry.observer.on_sample and (timestamp_axes := ", ".join(name for name in STAMPS if s.value(name))):
        yield (
            f"{timestamp_axes}, expected correct timestamps: it copies the state when a sample is taken, whatever its "
            f"timestamp; leave {label} out, or use kf."
        )
    if entry.takes == "one clock" and len(clocks(s)) > 1:
        values = {name: s.value(name) for name in SENSOR_FIELDS}
        differences = "; ".join(
            f"{k} = {plain(k, v)}" for k, v in values.items() if isinstance(v, tuple) and len(set(v)) > 1
        )
        yield (
            f"channels that differ ({differences}), expected one period, one delay and one network for all; make them equal, "
            "or use kf."
        )


def _list_values(value: PerChannel) -> str:
    return ", ".join(f"{v:g}" for v in per_channel(value, 1))
