"""The observers, one file each, and the dict that names them."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel

from pcbench.observers import dkf, kfbo, open_loop, pccebo
from pcbench.synthesis.certificate import Design, Setting
from pcbench.types import Observer


class Entry(NamedTuple):
    """An observer, the options a study may give it, and how its gains are found."""

    observer: Observer
    options: type[BaseModel]
    design: Callable[[Setting, Any], Design]
    knows_schedule: bool  # perfect start is claimed: true model, true start, no noise => no error
    summary: str


OBSERVERS = {
    "pccebo": Entry(
        pccebo.OBSERVER, pccebo.Options, pccebo.design, True, "current estimator, predicted to now; gain by LMI"
    ),
    "kfbo": Entry(kfbo.OBSERVER, kfbo.Options, kfbo.design, False, "Kalman filter of the held, late measurement"),
    "dkf": Entry(dkf.OBSERVER, dkf.Options, dkf.design, True, "delay-compensated Kalman filter, the fair baseline"),
    "open-loop": Entry(
        open_loop.OBSERVER, open_loop.Options, open_loop.design, True, "the model alone, never corrected: the floor"
    ),
}
