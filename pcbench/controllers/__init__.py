"""The controllers of closed loops, one file each, and the dict that names them."""

from collections.abc import Callable
from typing import Any, NamedTuple

from pydantic import BaseModel

from pcbench.controllers import pd
from pcbench.protocols import Controller
from pcbench.scenarios import Scenario


class Entry(NamedTuple):
    """A controller, its options, and how its numbers are made."""

    controller: Callable[[Any], Controller]  # options ->
    options: type[BaseModel]
    prepare: Callable[..., Any]  # (options, delay, dt [s], rows, ticks, model, inverse) -> params


CONTROLLERS = {"pd": Entry(pd.controller, pd.Options, pd.prepare)}


def entry_of(scenario: Scenario) -> Entry:
    """Return the controller of a scenario's loop: the one that it carries itself, or else the one of its name."""
    entry: Entry = CONTROLLERS[scenario.loop.controller] if scenario.loop.law is None else scenario.loop.law
    return entry
