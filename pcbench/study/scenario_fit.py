"""Whether what a table `[scenario]` says fits the plant: lengths of lists, names of signals, a controller's options."""

from collections.abc import Iterable
from typing import Any

from pydantic import ValidationError

from pcbench.controllers import CONTROLLERS
from pcbench.controllers import entry_of as controller_of
from pcbench.errors import UserError, unknown
from pcbench.plants import PLANTS, PlantSpec, signals_of
from pcbench.scenarios import Scenario
from pcbench.scenarios.signals import PATHS
from pcbench.signal_names import names_and_units, require_different
from pcbench.study.pydantic_errors import sentence

# by field: how many numbers, and whether none is allowed as well
SIZES = {
    "x0": ("n", False),
    "process_std": ("n", True),
    "xhat0": ("n", False),
    "prior_std": ("n", False),
    "unknown0": ("s", True),
    "unknown_std": ("s", False),
    "assumed_noise_std": ("q", True),
    "assumed_process_std": ("n", True),
    "initial_box": ("n", True),
    "settle_band": ("n + s", False),
}
EACH = {"n": "state", "s": "unknown", "q": "output", "n + s": "state and unknown"}


def each(given: float | list[float], many: int) -> list[float]:
    """Return a list of numbers as it is, and one number as that of all."""
    return given if isinstance(given, list) else [float(given)] * many


def control(s: Scenario, entry: PlantSpec, where: str) -> dict[str, Any]:
    """The controller's options, checked."""
    name = s.loop.controller
    if name not in CONTROLLERS and "controller" not in s.own:
        raise unknown(f"{where}.controller", "controller (or MODULE:NAME)", name, CONTROLLERS)
    if name == "pd" and entry.inverse is None:
        able = ", ".join(each for each, plant in PLANTS.items() if plant.inverse)
        raise UserError(f"{where}.controller: got 'pd' on {s.plant}, expected a plant that it is for: {able}.")
    control, model = dict(s.loop.control), controller_of(s).options
    try:
        model.model_validate(control)
    except ValidationError as error:
        raise sentence(f"{where}.control", error, {"": model.model_fields}) from None
    if "path" in control and control["path"] not in PATHS:
        raise unknown(f"{where}.control.path", "path", control["path"], PATHS)
    return control


def require_names(text: str, valid: Iterable[str], many: int, what: str, where: str) -> None:
    """Raise UserError for a signal that is none, or where they are neither one nor one for each of `many`."""
    names, columns = [part.strip() for part in text.split(",")], 0
    for name in names:
        if name not in valid:
            raise unknown(where, "input", name, valid)
        columns += 2 if name.startswith("heater") else 1
    if columns not in (1, many):
        raise UserError(f"{where}: got {columns} signals, expected one, or one for each {what} ({many}).")


def require_fit(s: Scenario, many: dict[str, int], entry: PlantSpec, where: str) -> None:
    """Raise UserError for a list of the wrong length, and for what the scoring cannot be."""
    for key, (size, optional) in SIZES.items():
        got, want = len(s.value(key)), many[size]
        if got != want and not (optional and not got):
            raise UserError(
                f"{where}.{key}: got {got} numbers, expected {want}, one for each {EACH[size]} of {s.plant}."
            )
    bound = s.scoring.divergence_threshold
    if isinstance(bound, tuple) and len(bound) != many["n + s"]:
        raise UserError(
            f"{where}.divergence_threshold: got {len(bound)} numbers, expected one, or {many['n + s']}, one for each state and "
            "unknown."
        )
    if not 0 <= s.scoring.steady_start < s.duration:
        raise UserError(
            f"{where}.steady_start: got {s.scoring.steady_start:g} s, expected less than the duration of {s.duration:g} s."
        )
    names = [name for name, _ in signals_of(s)]
    for name in s.scoring.headline:
        if name not in names:
            raise unknown(f"{where}.headline", "signal", name, names)
    require_different(names, f"{where}.signals")


def signals(texts: list[str], many: int, where: str) -> tuple[tuple[str, str], ...]:
    """Names and units from texts such as "angle [rad]"."""
    if len(texts) != many:
        raise UserError(f"{where}: got {len(texts)} names, expected {many}.")
    return names_and_units(texts, where)
