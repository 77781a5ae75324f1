"""What the tables, the planner and the observers need to know of a plant."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pcbench.dynamics.linear import Model
from pcbench.protocols import Plant


class PlantSpec(NamedTuple):
    """A plant with what the tables and the observers need to know of it."""

    plant: Plant
    signals: tuple[tuple[str, str], ...]  # (state, unit); empty: the scenario's
    numbers: Any  # default parameters, a NamedTuple
    nominal: Callable[[Any], Model]  # the linear model that observers know
    prepare: Callable[[Any, float, int], Any]  # (numbers, dt [s], ticks) -> params
    summary: str
    unknowns: tuple[tuple[str, str], ...] = ()  # (what observers may estimate beside the states, unit)
    heavy: bool = False  # a tick costs so much that fewer lanes a call are as fast
    model: Callable[..., Any] | None = None  # (params, now, x, unknowns) -> dx/dt; None: `nominal` is the model
    successor: Callable[..., Any] | None = None  # likewise -> x one tick later, of a plant that is given by its step
    sensor: Callable[..., Any] | None = None  # (params, now, x, unknowns) -> y; None: `nominal`'s
    parts: Callable[..., Any] | None = None  # (params, u, x) -> a, phi of accelerations a p + phi with parameters p
    inverse: Callable[..., Any] | None = None  # (params, unknowns, path, rates, accelerations) -> u
    positive: tuple[str, ...] = ()  # parameters that must be greater than 0
    signs: tuple[str, ...] = ()  # parameters that are 1 or -1
    ranges: tuple[tuple[float, float], ...] = ()  # of the unknowns, where observers look for them; empty: anywhere
    drifts: bool = True  # whether `drift` has an effect; of a plant of one's own where it differs from the model
    # numbers -> dx/dt at the operating point where `nominal` is the slope and of which signals are deviations; None: no such
    residual: Callable[[Any], Any] | None = None
    operating_point: tuple[tuple[float, ...], tuple[float, ...]] | None = None  # (x0 [n], u0 [m]) of such signals
    tick: float | None = None  # s, of a plant given by its step; None: any
