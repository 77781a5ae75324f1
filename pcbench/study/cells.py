"""The cells of a study: every point of its axes in every scenario, and the record of all that decides their numbers."""

import hashlib
import itertools
import json
import math
from typing import Any, NamedTuple

import tomli_w
from pydantic import BaseModel

from pcbench.errors import UserError
from pcbench.scenarios import Scenario
from pcbench.study import Choices, Study, choices_of, fits, limits, observers_of, options_of, scenarios_of
from pcbench.study import axes as axis
from pcbench.study.axes import AXES
from pcbench.study.times import Times, times_of, whole


class Cell(NamedTuple):
    """One point of a study's axes in one scenario, every number resolved."""

    scenario: Scenario  # with the axes' values put in
    number: int  # from 0, within its scenario
    values: dict[str, Any]  # by axis, seconds and SI units: what the tables say
    parameters: dict[str, Any]  # the plant's, where the scenario or an axis changes them
    choices: Choices
    times: Times

    @property
    def key(self) -> tuple[str, int]:
        """Return its scenario's name and its number: what a study knows it by."""
        return self.scenario.name, self.number

    def having(self, **changes: Any) -> "Cell":
        """Return the cell with fields of its scenario changed, its times with them."""
        scenario = self.scenario.having(**changes)
        return self._replace(scenario=scenario, times=times_of(scenario))


def cell_of(
    scenario: Scenario,
    number: int = 0,
    values: dict[str, Any] | None = None,
    parameters: dict[str, Any] | None = None,
    choices: Choices | None = None,
) -> Cell:
    """Return a scenario as a cell, with its times in ticks."""
    return Cell(scenario, number, values or {}, parameters or {}, choices or Choices(), times_of(scenario))


def cells(study: Study, scenario: str, where: str | None = None) -> list[Cell]:
    """Return every combination of the axes in one scenario, in the order of the axes as written."""
    base, where = scenarios_of(study)[scenario], where or study.name
    axes = {name: axis.axis(name, values, base, f"{where}: axes.{name}") for name, values in study.axes.items()}
    limits.require_few_cells(math.prod(len(values) for values in axes.values()), whole(base.horizon, base), where)
    choices, out, apart = choices_of(study), [], channels_apart(study)
    for index, point in enumerate(itertools.product(*axes.values())):
        given = dict(zip(axes, point, strict=True))
        fields = {k: v for k, v in given.items() if k in AXES}
        changed = base.having(**fields, input=choices.input or base.loop.input)
        if choices.unknown_input:
            if not base.truth.unknown_input:
                raise UserError(
                    f"{where}: options.scenario.unknown_input: got {choices.unknown_input!r} for {scenario}, whose plant has "
                    "no unknown input; expected a scenario such as arm/sine; leave it out."
                )
            changed = changed.having(unknown_input=choices.unknown_input)
        _of_the_loop(changed, choices, where)
        fits.fits(changed, where if where == scenario else f"{where}: {scenario}")
        values = {name: axis.plain(name, changed.value(name), name in apart) for name in AXES}
        own = {k.removeprefix("plant."): v for k, v in given.items() if k.startswith("plant.")}
        values |= {k: v for k, v in given.items() if k.startswith("plant.")}
        out.append(cell_of(changed, index, values, dict(base.truth.parameters) | own, choices))
    return out


def _of_the_loop(s: Scenario, choices: Choices, where: str) -> None:
    """Raise UserError where a choice is of the other kind of loop."""
    given = [name for name, value in choices.loop().items() if value is not None]
    if given and not s.loop.controller:
        raise UserError(
            f"{where}: options.scenario.{given[0]}: got {choices.loop()[given[0]]!r} for {s.name}, where no controller gives "
            "commands, expected a closed loop such as helicopter/constant; leave it out."
        )
    if choices.input and s.loop.controller:
        raise UserError(
            f"{where}: options.scenario.input: got {choices.input!r} for {s.name}, whose input a controller gives, expected a "
            "path to follow (options.scenario.path); leave it out."
        )


def channels_apart(study: Study) -> set[str]:
    """Return the axes in which channels differ in some cell of a study: its tables hold a list for every cell there."""
    known, out = scenarios_of(study), set()
    for name in axis.CHANNELS:
        given = study.axes.get(name) or [known[s].value(name) for s in study.scenarios]
        if any(isinstance(each, list | tuple) and len(set(each)) > 1 for each in given):
            out.add(name)
    return out


def identity(cell: Cell, root_seed: int) -> str:
    """Return the digest of all that decides the numbers of a cell but its observers; equal for equal numbers."""
    said = cell._asdict() | {"scenario": cell.scenario.flat(), "choices": cell.choices.model_dump()}
    del said["number"], said["values"], said["times"]
    text = json.dumps(said | {"root_seed": root_seed}, sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def told(options: BaseModel) -> str:
    """Return the digest of an observer's options: what decides its numbers in a cell besides the cell."""
    text = json.dumps(options.model_dump(), sort_keys=True, default=_plain)
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else dict(value)


def cells_of(study: Study, known: dict[str, list[str]] | None = None) -> list[Cell]:
    """Return the cells of all scenarios of a study; those whose digests are `known`, in order of number, keep their numbers."""
    out = []
    for name in study.scenarios:
        numbers = {digest: i for i, digest in enumerate((known or {}).get(name, []))}
        for cell in cells(study, name):
            number = numbers.setdefault(identity(cell, study.root_seed), len(numbers))
            out.append(cell._replace(number=number))
    return out


def numbering(study: Study, every: list[Cell]) -> dict[str, list[str]]:
    """Return by scenario the digests of its cells in order of number."""
    out: dict[str, list[str]] = {}
    for cell in sorted(every, key=lambda c: c.number):
        out.setdefault(cell.scenario.name, []).append(identity(cell, study.root_seed))
    return out


def resolved(study: Study, every: list[Cell] | None = None) -> dict[str, Any]:
    """Return everything that decides the numbers, for `study.toml` and its hash."""
    options: dict[str, Any] = {"scenario": choices_of(study).model_dump(exclude_none=True)}
    for scenario in study.scenarios:
        base = scenarios_of(study)[scenario]
        options[scenario] = {
            o: options_of(study, base, o).model_dump(exclude_none=True) for o in observers_of(study, scenario)
        }
    known = scenarios_of(study)
    scenarios = {s: _said(json.loads(json.dumps(known[s].flat(), default=dict))) for s in study.scenarios}
    out = study.model_dump(exclude_none=True, exclude={"tuning", "tune"})  # by now they are options like any others
    ran_by = {s: observers_of(study, s) for s in study.scenarios}
    said = {"options": options, "scenarios": scenarios, "observers": ran_by}
    said |= {"cells": numbering(study, every)} if every else {}
    return out | {"resolved": said}


def _said(scenario: dict[str, Any]) -> dict[str, Any]:
    """A scenario without what TOML has no word for: a delay of one interval is written so, nothing left out."""
    delay = [axis.INTERVAL if d is None else d for d in scenario["delay"]]
    model = {k: v for k, v in scenario["model"].items() if v is not None}
    said = {k: v for k, v in scenario.items() if v is not None}
    return said | {"delay": delay, "model": model}


def to_toml(study: Study, every: list[Cell] | None = None) -> str:
    """Return the resolved study as TOML; the part under `[resolved]` is for readers, the rest can be run again."""
    return tomli_w.dumps(resolved(study, every))


def digest(study: Study) -> str:
    """Return the hash of the resolved study: equal for equal numbers."""
    return hashlib.sha256(json.dumps(resolved(study), sort_keys=True).encode()).hexdigest()
