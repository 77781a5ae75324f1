"""The observers, one file each, and the dict that names them."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from pcbench.observers import dkf, kfbo, open_loop, pccebo, pco
from pcbench.synthesis.certificate import Design, Setting
from pcbench.types import Observer

Takes = Literal["any schedule", "one clock", "one constant delay"]


class Entry(NamedTuple):
    """An observer, the options a study may give it, and how its gains are found.

    `takes` says on which schedules it can work: any; samples of any age and in any order, but all channels together; or
    samples of one constant age only.
    """

    observer: Observer
    options: type[BaseModel]
    design: Callable[[Setting, Any], Design]
    knows_schedule: bool  # perfect start is claimed: true model, true start, no noise => no error
    summary: str
    takes: Takes = "one constant delay"


OBSERVERS = {
    "pccebo": Entry(
        pccebo.OBSERVER,
        pccebo.Options,
        pccebo.design,
        True,
        "current estimator, predicted to now; gain by LMI or Riccati",
        "one clock",
    ),
    "kfbo": Entry(
        kfbo.OBSERVER,
        kfbo.Options,
        kfbo.design,
        False,
        "Kalman filter of the held, late measurement",
        "one constant delay",
    ),
    "pco": Entry(
        pco.OBSERVER,
        pco.Proportional,
        pco.design,
        True,
        "piecewise continuous, reduced order; gain given or by LMI",
        "one clock",
    ),
    "pi-pco": Entry(
        pco.OBSERVER,
        pco.ProportionalIntegral,
        pco.design,
        True,
        "PCO with an integral; gains given or by LMI",
        "one clock",
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
    return max(found, key=len, default=None)


def entry_of(label: str) -> Entry:
    """Return the entry of the observer that a label names; raise KeyError where there is none."""
    return OBSERVERS[base_of(label) or label]
