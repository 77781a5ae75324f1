"""The observers, one file each, and the dict that names them."""

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from pcbench.observers import chain, dkf, ekf, equal_delay, high_gain, kfbo, no_delay, open_loop, pccebo, pco, pio, smo
from pcbench.protocols import Observer
from pcbench.synthesis.certificate import Design, Setting

LONGEST = 80  # characters of a label, which names a folder
Takes = Literal["any schedule", "one clock", "one constant delay", "constant delays"]


class Entry(NamedTuple):
    """An observer, the options a study may give it, and how its gains are found.

    `takes` says on which schedules it can work: any; samples of any age and in any order, but all channels together;
    samples of one constant age only; or sampled regularly, all channels together, each of a constant age of its own.
    """

    observer: Observer
    options: type[BaseModel]
    design: Callable[[Setting, Any], Design]
    knows_schedule: bool  # perfect start is claimed: true model, true start, no noise => no error
    summary: str
    takes: Takes = "one constant delay"
    heavy: bool = False  # a tick costs so much that one of them in a loop's body is as fast as two, and compiles faster
    nonlinear: bool = False  # it is designed for plants without a linear model
    smooth: bool = True  # its estimate has a slope by its options, and loops of a length known beforehand
    # options of gains for the noise and delays as they are; None: it has none such
    designed: Mapping[str, Any] | None = None


OBSERVERS = {
    "pccebo": Entry(
        pccebo.OBSERVER,
        pccebo.Options,
        pccebo.design,
        True,
        "current estimator, predicted to now; gain by LMI or Riccati",
        "one clock",
        designed={"gain": "riccati"},
    ),
    "kfbo": Entry(
        kfbo.OBSERVER,
        kfbo.Options,
        kfbo.design,
        False,
        "Kalman filter of the held, late measurement",
        "one constant delay",
        designed={"R": "noise"},
    ),
    "pco": Entry(
        pco.OBSERVER,
        pco.Proportional,
        pco.design,
        True,
        "piecewise continuous, reduced order; gain given or by LMI",
        "one clock",
        designed={"Kp": "lmi"},
    ),
    "pi-pco": Entry(
        pco.OBSERVER,
        pco.ProportionalIntegral,
        pco.design,
        True,
        "PCO with an integral; gains given or by LMI",
        "one clock",
        designed={"Kp": "lmi", "Ki": "lmi"},
    ),
    "chain": Entry(
        chain.OBSERVER,
        chain.Options,
        chain.design,
        True,
        "a link for each delay, from the latest sensor to now; poles or Riccati",
        "constant delays",
        designed={"gain": "riccati"},
    ),
    "equal-delay": Entry(
        equal_delay.OBSERVER,
        equal_delay.Options,
        equal_delay.design,
        False,
        "pretends one delay for all channels",
        "constant delays",
    ),
    "no-delay": Entry(
        no_delay.OBSERVER,
        no_delay.Options,
        no_delay.design,
        False,
        "the classical observer, designed as if nothing were late",
        "constant delays",
    ),
    "smo": Entry(
        smo.OBSERVER,
        smo.Options,
        smo.design,
        True,
        "sliding mode: injects a signal that is the unknown input; gains printed or by LMI",
        "one constant delay",
        heavy=True,
        smooth=False,
        designed={"gains": "design"},
    ),
    "pio": Entry(
        pio.OBSERVER,
        pio.Options,
        pio.design,
        True,
        "PI with a sign: injects a signal that is the unknown input; gains printed or by LMI",
        "one constant delay",
        heavy=True,
        smooth=False,
        designed={"gains": "design"},
    ),
    "high-gain": Entry(
        high_gain.OBSERVER,
        high_gain.Options,
        high_gain.design,
        True,
        "of positions, rates and parameters, with a predictor of the output; printed or robust",
        "any schedule",
        heavy=True,
        nonlinear=True,
    ),
    "ekf": Entry(
        ekf.OBSERVER,
        ekf.Options,
        ekf.design,
        True,
        "extended Kalman filter, re-propagated from the measurement's own time; parameters estimated",
        "any schedule",
        heavy=True,
        nonlinear=True,
        smooth=False,
    ),
    "dkf": Entry(
        dkf.OBSERVER,
        dkf.Options,
        dkf.design,
        True,
        "delay-compensated Kalman filter, the fair baseline",
        "any schedule",
    ),
    "open-loop": Entry(
        open_loop.OBSERVER,
        open_loop.Options,
        open_loop.design,
        True,
        "the model alone, never corrected: the floor",
        "any schedule",
    ),
}


def base_of(label: str) -> str | None:
    """Return the observer that a label names: its own name, or name-anything (an observer run with other options)."""
    found = [name for name in OBSERVERS if label == name or label.startswith(name + "-")]
    plain = label.isprintable() and len(label) <= LONGEST
    return max(found, key=len, default=None) if plain else None


def entry_of(label: str) -> Entry:
    """Return the entry of the observer that a label names; raise KeyError where there is none."""
    return OBSERVERS[base_of(label) or label]
