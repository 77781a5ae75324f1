"""Observers of the field: the printed numbers of their designs, each from the function that designs or bounds the observer."""

import numpy as np
from scipy.linalg import expm
from scipy.optimize import brentq

from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import Claim, all_digits, report_finding
from pcbench.synthesis import bandwidth, cascade, finite_time, interval_observer, sampled_high_gain, send_on_delta

FORMS: tuple[sampled_high_gain.Form, ...] = ("hold", "predictor", "impulse")
PERIOD, OMEGA = 0.01, 20.0  # s, 1/s of the extended state observer
LINK_TICKS = 100  # of a link of the cascade
SOURCES = {
    "cascade": "Germani, Manes, Pepe 2002 [V]",
    "eso": "Miklosovic, Radke, Gao 2006 [V]",
    "high gain": "Karafyllis, Kravaris 2009 [V]",
    "finite time": "Engel, Kreisselmeier 2002 [V]",
    "interval": "Mazenc, Dinh 2014 [V]",
    "event": "Astrom, Bernhardsson 2002 [V]",
}


def rows() -> list[Claim]:
    """Return every claim on observers and their sampling."""
    limits = {form: [sampled_high_gain.limit(form, n) for n in (2, 3, 4)] for form in FORMS}
    rates = [sampled_high_gain.decay_rate("predictor", 2, interval) for interval in (0.1, 3.0)]
    trigger = send_on_delta.expected(1.0)
    link_delays = [longest_link(gain) for gain in (1.5, 2.0, 3.0)]
    largest_gain = brentq(lambda gain: longest_link(gain) - 2.5 / 3, 1.2, 1.4)
    return [
        all_digits(
            "cascade, x' = a x: longest link, times a, at gains of 1.5 a, 2 a, 3 a",
            "0.7523, 0.6046, 0.4352",
            link_delays,
            SOURCES["cascade"],
        ),
        all_digits(
            "cascade, x' = a x: largest gain / a of three links over a delay of 2.5 / a",
            "1.3025",
            largest_gain,
            SOURCES["cascade"],
        ),
        all_digits("eso: gains at w = 20, T = 0.01", "0.451188, 8.964126, 59.562428", eso_gains(), SOURCES["eso"]),
        all_digits(
            "high gain, n = 2, innovation held: largest theta T", "1.000", limits["hold"][0], SOURCES["high gain"]
        ),
        all_digits(
            "high gain, n = 2, output predictor: largest theta T",
            "4.99991",
            limits["predictor"][0],
            SOURCES["high gain"],
        ),
        all_digits("high gain, n = 2, impulse: largest theta T", "0.828", limits["impulse"][0], SOURCES["high gain"]),
        all_digits(
            "high gain, output predictor: decay at theta T = 0.1, 3", "0.973, 0.232", rates, SOURCES["high gain"]
        ),
        all_digits(
            "finite time: norm of K at D = 0.5, 2", "192, 5.42", [weight(0.5), weight(2.0)], SOURCES["finite time"]
        ),
        *(
            all_digits(f"interval observer, poles {a}, {b}: final widths", printed, widths((a, b)), SOURCES["interval"])
            for a, b, printed in ((0.2, 0.3, "3.179, 4.776"), (0.4, 0.5, "3.767, 4.167"), (0.6, 0.7, "5.533, 3.947"))
        ),
        all_digits("send on delta, d = 1: mean interval", "1.000", trigger.interval, SOURCES["event"]),
        all_digits("send on delta, d = 1: mean variance", "0.1667", trigger.variance, SOURCES["event"]),
        report_finding(
            "observers: largest theta T of the high gain, n = 3 and 4",
            "; ".join(f"{form} {', '.join(f'{limit:.5f}' for limit in values[1:])}" for form, values in limits.items()),
        ),
    ]


def longest_link(gain: float) -> float:
    """Return the longest delay of a link whose errors decay, for x' = x + u and a gain [1/s], measured at every tick."""

    def excess(delay: float) -> float:
        seconds = delay / (LINK_TICKS + 0.5)  # an input that is held over a tick delays by half a tick more
        Phi = np.full((1, 1), np.exp(seconds))
        return cascade.radius(Phi, np.eye(1), gain * (Phi - 1), LINK_TICKS, 0) - 1

    return float(brentq(excess, 0.2, 0.99))


def eso_gains() -> Matrix:
    """Return the gains of the extended state observer of a double integrator, in the form of the source."""
    Phi = np.array([[1.0, PERIOD, PERIOD**2 / 2], [0.0, 1.0, PERIOD], [0.0, 0.0, 1.0]])
    return bandwidth.current_gain(Phi, np.eye(3)[:1], float(np.exp(-OMEGA * PERIOD)), 0.0, "eso")[:, 0]


def weight(delay: float) -> float:
    """Return the norm of the weights of a double integrator, with poles -1, -2 and -3, -4, over a delay [s]."""
    A, C = np.eye(2, k=1), np.eye(2)[:1]
    flows = (expm((A - np.array([[a + b], [a * b]]) @ C) * delay) for a, b in ((1.0, 2.0), (3.0, 4.0)))
    return float(np.linalg.norm(np.hstack(finite_time.weights(*flows)), 2))


def widths(poles: tuple[float, float]) -> Matrix:
    """Return the final widths of the interval observer of a double integrator, h = 0.5, |w| <= 0.2, |v| <= 0.05."""
    Phi, b, C = np.array([[1.0, 0.5], [0.0, 1.0]]), np.array([[0.125], [0.5]]), np.eye(2)[:1]
    L = interval_observer.gain(Phi, C, max(poles), [*poles], "interval")
    gains, _ = interval_observer.certify(Phi, C, L, "interval")
    noise = interval_observer.accumulate_noise(Phi, 0.2 * b, gains.V_inv, 1)[1]
    return interval_observer.final_width(gains, Phi, C, noise, np.array([0.05]))
