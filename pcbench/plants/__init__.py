"""The plants, one file each, and the dict that names them."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pcbench.plants import cart
from pcbench.synthesis.linear import Model
from pcbench.types import Plant


class Entry(NamedTuple):
    """A plant with what the tables and the observers need to know of it."""

    plant: Plant
    signals: tuple[tuple[str, str], ...]  # (state, unit)
    numbers: Any  # default parameters, a NamedTuple
    nominal: Callable[[Any], Model]  # the linear model that observers know
    prepare: Callable[[Any, float, int], Any]  # (numbers, dt [s], ticks) -> params
    summary: str


PLANTS = {
    "cart": Entry(
        cart.PLANT, cart.SIGNALS, cart.Numbers(), cart.nominal, cart.prepare, "mobile cart under a camera, 2 states"
    ),
}
