"""Check the values of a study's axes, in seconds and SI units. The axes are declared in `pcbench.fields`.

Every error is one sentence: the place, the value, what was expected, and how to correct it.
"""

import math
from collections.abc import Sequence
from typing import Any

from pcbench import fields
from pcbench.errors import UserError, brief_repr, unknown
from pcbench.plants import drifts, entry_of, parameters_in
from pcbench.scenarios import INTERVAL, Scenario
from pcbench.scenarios.scenario import LOST, has_rows
from pcbench.simulation.schedule.sampling import PROFILES

SMALLEST = 1e-12
LARGEST = 1e12  # limit of any number of a scenario, in SI units
CHANNELS = fields.names(per="channel")  # one value, or one per output channel
# one value, or one per output channel; if channels differ, a scenario has one per channel
SENSORS = fields.names(per="sensor")
STATES = fields.names(per="state")  # one value, or one per state
OUTPUTS = fields.names(per="output")  # one value, or one per output, if there is any
UNBOUNDED = fields.names(word="inf")
TIMES = fields.names(ticks=True)
SIGNED = fields.names(signed=True)
LISTS = fields.names(listed=True)  # axes whose value may be a list
ROWS = fields.names(rows=True)  # axes for which a scenario may have a list per output channel
AXES = fields.names(loop=False)
COMMANDS = fields.names(loop=True)  # axes of loops that a study closes
OPTIONAL = fields.names(always=False, loop=False)  # in the tables only if they are an axis
Value = str | float | tuple[Any, ...]  # value of an axis in a scenario: numbers, texts or rows in a tuple
Plain = str | float | None | list[float | str | None]  # the same value in the tables
LIMITS = {f.name: f.limit for f in fields.FIELDS if f.limit}


def axis_values(name: str, values: Sequence[object], base: Scenario, where: str) -> list[Value]:
    """Return an axis' values as in a scenario; raise UserError with the first invalid value."""
    valid = [*axes_of(base), *(f"plant.{p}" for p in parameters_in(base))]
    if name not in valid:
        raise unknown(where, f"axis of {base.name}", name, valid)
    if not values:
        raise UserError(f"{where}: got an empty list, expected at least one value; leave the axis out or fill it.")
    if name in ROWS and any(map(has_rows, values)):
        raise UserError(
            f"{where}: got a list for each channel, expected one list for all in an axis; write {name} in a table "
            "[scenarios.NAME], one for each value."
        )
    out = [axis_value(name, value, base, f"{where}[{i}]") for i, value in enumerate(values)]
    if name == "parameter_drift" and any(out) and not drifts(base):
        raise UserError(
            f"{where}: got {brief_repr(values)} for {base.name}, which has no parameter drift, expected 0; leave it out"
            + (", or write in [lti.plant] how the plant differs from its model." if base.plant == "lti" else ".")
        )
    if len({str(v) for v in out}) < len(out):
        raise UserError(
            f"{where}: got a value twice in {brief_repr(values)}, expected each once; remove the repeated one."
        )
    return out


def axes_of(s: Scenario) -> tuple[str, ...]:
    """Return the axes of a scenario, without its plant's parameters."""
    return (*AXES, *COMMANDS) if s.loop.controller not in ("", "pd") else AXES


def axis_value(name: str, value: object, base: Scenario, where: str) -> Value:
    """Return one value of an axis as in a scenario."""
    if name in ROWS and has_rows(value):
        return _of_each_channel(name, value, base, where)
    if name in LISTS or name == "delay_self_transition":
        return _list(name, value, base, where)
    is_list = isinstance(value, list | tuple)
    if name not in (*CHANNELS, *STATES, *OUTPUTS) and not (name in SENSORS and is_list):
        return _single(name, value, base, where)
    if name in OUTPUTS and value in ([], ()):
        return ()
    n, quantity = (len(base.truth.x0), "state") if name in STATES else (len(base.sampling.delay), "output channel")
    entries = list(value) if isinstance(value, list) or (name in SENSORS and isinstance(value, tuple)) else [value] * n
    if len(entries) != n:
        raise UserError(f"{where}: got {len(entries)} values, expected one or {n} (a value for each {quantity}).")
    if name in SENSORS:
        numbers = tuple(_single(name, v, base, where) for v in entries)
        return numbers if len(set(numbers)) > 1 else numbers[0]
    if name == "delay" and isinstance(value, str):
        if value.startswith(("from:", "in-turn:")):
            raise UserError(
                f"{where}: got {brief_repr(value)}, expected no recording among the values of an axis; write it as "
                "`delay` of a table [scenarios.NAME], one for each recording."
            )
        if value != INTERVAL:
            raise UserError(
                f"{where}: got {brief_repr(value)}, expected seconds or '{INTERVAL}' (one sampling interval)."
            )
        return (INTERVAL,) * n
    numbers = tuple(number(v, where, least=0.0) for v in entries)
    for v in numbers if name in TIMES else ():
        _require_whole_ticks(name, v, base, where)
    return numbers


def _of_each_channel(name: str, value: Sequence[object], base: Scenario, where: str) -> Value:
    """Return a list per output channel, or one list if they are equal."""
    q = len(base.sampling.delay)
    if len(value) != q or not all(isinstance(row, list | tuple) for row in value):
        raise UserError(f"{where}: got {brief_repr(value)}, expected one list of numbers, or {q} (one per channel).")
    rows = tuple(_list(name, row, base, f"{where}[{j}]") for j, row in enumerate(value))
    return rows if len(set(rows)) > 1 else rows[0]


def _single(name: str, value: object, base: Scenario, where: str) -> float:
    """Return the value of an axis that is a single number."""
    if name in UNBOUNDED and value == math.inf:
        return math.inf
    n = number(value, where, None if name in SIGNED or name.startswith("plant.") else 0.0)
    if name in TIMES:
        _require_whole_ticks(name, n, base, where)
    plant, parameter = entry_of(base), name.removeprefix("plant.")
    if parameter in plant.positive and n <= 0:
        raise UserError(f"{where}: got {brief_repr(value)}, expected a number greater than 0; write a positive one.")
    if parameter in plant.signs and abs(n) != 1:
        raise UserError(f"{where}: got {brief_repr(value)}, expected a sign; write 1 or -1.")
    if name in LIMITS and not LIMITS[name].holds(n):
        raise UserError(f"{where}: got {brief_repr(value)}, expected {LIMITS[name].expected}")
    return n


def number(value: object, where: str, least: float | None) -> float:
    """Return a finite number of plausible size, at least `least`."""
    if isinstance(value, bool) or not isinstance(value, int | float) or value != value or abs(value) == math.inf:
        raise UserError(f"{where}: got {brief_repr(value)}, expected a finite number; write a number in SI units.")
    if abs(value) > LARGEST:
        raise UserError(
            f"{where}: got {brief_repr(value)}, expected a number of at most {LARGEST:g} in size; write SI units."
        )
    if 0 < abs(value) < SMALLEST:
        raise UserError(f"{where}: got {value!r}, expected 0 or a number of at least {SMALLEST:g} in size; write 0.")
    if least is not None and value < least:
        raise UserError(
            f"{where}: got {value!r}, expected a number of at least {least:g}; change its sign or leave it out."
        )
    return float(value)


def _list(name: str, value: object, base: Scenario, where: str) -> str | tuple[float | str, ...]:
    """Return a list of numbers or an allowed text; for the sampling pattern, also a name."""
    if name == "sampling_pattern" and isinstance(value, str):
        if value not in PROFILES:
            raise unknown(where, "sampling_pattern (or list of intervals)", value, PROFILES)
        return value
    expected = {
        "sampling_pattern": f"one of {', '.join(PROFILES)} or a list of intervals [s].",
        "delay_sequence": f"a list of seconds and '{LOST}', one for each sample in turn.",
    }
    if name in expected and (not isinstance(value, list | tuple) or (not value and name == "sampling_pattern")):
        raise UserError(f"{where}: got {brief_repr(value)}, expected {expected[name]}")
    least = None if name == "sampling_pattern" else 0.0
    entries = value if isinstance(value, list | tuple) else [value]
    out = tuple(v if v == LOST and name == "delay_sequence" else number(v, where, least) for v in entries)
    for v in out:
        if isinstance(v, str):
            continue
        if name == "sampling_pattern" and v <= 0:
            raise UserError(f"{where}: got an interval of {v:g} s, expected at least one tick, {base.dt:g} s.")
        if name in LIMITS and not LIMITS[name].holds(v):
            raise UserError(f"{where}: got {v:g}, expected {LIMITS[name].expected}")
        if name not in ("delay_self_transition", "delay_weights"):
            _require_whole_ticks("sampling_period" if name == "sampling_pattern" else "delay", v, base, where)
    return out


def _require_whole_ticks(name: str, value: float, base: Scenario, where: str) -> None:
    ticks = value / base.dt
    if abs(ticks - round(ticks)) > 1e-6:
        below, above = max(math.floor(ticks), int(name == "sampling_period")) * base.dt, math.ceil(ticks) * base.dt
        nearest = f"{above:.12g}" if below == above else f"{below:.12g} or {above:.12g}"
        raise UserError(
            f"{where}: got {value:.12g} s, expected a whole number of ticks of {base.dt:g} s in {base.name}; "
            f"write {nearest}."
        )
    if name == "sampling_period" and round(ticks) < 1:
        raise UserError(f"{where}: got {value:g} s, expected at least one tick, {base.dt:g} s in {base.name}.")
    if abs(value) > base.duration:
        raise UserError(f"{where}: got {value:g} s, expected at most the duration of {base.name}, {base.duration:g} s.")


def plain(name: str, value: Value, as_list: bool = False) -> Plain:
    """Return a value as in the tables: equal channels as one unless `as_list`, one sampling interval as null."""
    if not isinstance(value, tuple):
        return value
    if has_rows(value):
        return " and ".join(str(plain(name, row)) or "none" for row in value)
    if name in LISTS:
        return ", ".join(v if isinstance(v, str) else f"{v:g}" for v in value)
    entries = [None if v == INTERVAL else v for v in value]
    return entries if not entries or as_list or len(set(entries)) > 1 else entries[0]
