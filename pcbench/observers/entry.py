"""What the dict of observers holds of each."""

from collections.abc import Callable, Mapping
from typing import Any, Literal, NamedTuple

from pydantic import BaseModel

from pcbench.protocols import Observer
from pcbench.synthesis.certificate import Design, DesignContext

Takes = Literal["any schedule", "one clock", "one constant delay", "constant delays"]


class ObserverSpec(NamedTuple):
    """An observer, the options a study may give it, and how its gains are found.

    `takes` says on which schedules it can work: any; samples of any age and in any order, but all channels together;
    samples of one constant age only; or sampled regularly, all channels together, each of a constant age of its own.
    """

    observer: Observer
    options: type[BaseModel]
    design: Callable[[DesignContext, Any], Design]
    knows_schedule: bool  # perfect start is claimed: true model, true start, no noise => no error
    summary: str
    takes: Takes = "one constant delay"
    lanes: int | None = None  # runs a call, if the last bits depend on how many run together; None: they do not
    expensive: bool = (
        False  # its runs may take much longer than others': it has a program of its own, and its turn comes last
    )
    nonlinear: bool = False  # it is designed for plants without a linear model
    smooth: bool = True  # its estimate has a slope by its options, and loops of a length known beforehand
    loops: bool = True  # its estimate can drive a loop; else it looks back further than a loop keeps its inputs
    elsewhere: bool = False  # its estimates are made elsewhere, and scored: it is never simulated
    # options of gains for the noise and delays as they are; None: it has none such
    designed: Mapping[str, Any] | None = None
