"""Gains by design: one design with its certificate, the same as a study that can be run, and trade-offs."""

from typing import Any, get_args

import numpy as np
import pandas as pd
import tomli_w
from pydantic import BaseModel, ValidationError

from pcbench.errors import UserError, unknown
from pcbench.observers import ObserverSpec
from pcbench.observers.parts.options import WAY, extra
from pcbench.planning import designed, setting
from pcbench.runtime import config
from pcbench.study import Study
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.parse import Described, one_cell
from pcbench.study.plugins.references import absolute
from pcbench.synthesis.certificate import Design, is_certified

FEW = 6  # entries of an array that a row of a trade-off shows
NOTHING = 1e-15  # of an array's size: 0
BACK = 0.999  # part of a decay that is asked when a gain is read back: a proof of all of it stands on an edge
HIDDEN = ("P", "P1", "P2", "shared_P")  # what proves, not what is promised


def design(
    scenario: Described, observer: str, *, gain: str | None = None, overrides: list[str] | None = None
) -> tuple[Study, Cell, Design]:
    """Return an observer's design in a scenario's one cell; `gain` is one of the observer's ways to find gains.

    Raises UserError for another word, DesignError where the gains are not certified.
    """
    study, cell = one_cell(scenario, [observer], overrides or [])
    label = label_of(observer)
    if gain is not None:
        way = _way(cell.entry(label), label, gain)
        study, cell = one_cell(_changed(study, label, {way: gain}), [label], [])
    return study, cell, designed(label, cell.entry(label), setting(cell), cell.options[label])


def as_study(study: Study, cell: Cell, observer: str, found: Design) -> dict[str, Any]:
    """Return a design as a study, as TOML writes it: with the gains as numbers where options can hold them.

    Under [resolved.certificate] stands what proves them; a study that is read leaves it aside. What is returned has been
    designed anew from these options, so it can be run.
    """
    observer = label_of(observer)
    model, options = cell.entry(observer).options, cell.options[observer]
    numbers = _as_options(model, options, found)
    chosen = options.model_dump(exclude_none=True)
    if numbers:
        found_again = {k: v for k, v in chosen.items() if k not in _way_of(cell.entry(observer))} | numbers
        chosen = _proven_again(study, cell, observer, found_again) or chosen
    c = found.certificate
    proof: dict[str, Any] = {
        "inequality": c.inequality,
        "margin": _finite(c.margin),
        "solver": c.solver,
        "status": c.status,
    }
    proof |= {"fallback": c.fallback, "decay_rate": _finite(c.rate), "certified": is_certified(c._asdict())}
    raw = absolute(study.model_dump(exclude_none=True, exclude_defaults=True))
    given = {k: v for k, v in raw.get("options", {}).items() if k != observer}
    raw["name"] = study.name if study.name.endswith(f"-{observer}") else f"{study.name}-{observer}"
    options_table = {"options": given | {observer: chosen}} if given or chosen else {}
    said = {"resolved": {"certificate": {k: v for k, v in proof.items() if v is not None}}}
    return {k: v for k, v in raw.items() if k != "options"} | options_table | said


def to_toml(written: dict[str, Any]) -> str:
    """Return a design as a study's TOML."""
    return tomli_w.dumps(written)


def trade_off(
    scenario: Described,
    observer: str,
    option: str,
    values: list[Any],
    *,
    gain: str | None = None,
    overrides: list[str] | None = None,
) -> pd.DataFrame:
    """Return a row for each value of one option of a design: what is promised there, or why it is refused.

    Columns: the option, `rate` [1/s] of the decay promised (NaN: none), `margin`, `solver`, `fallback`, `refused` (empty: it
    stands), `certified` (see `certificate.is_certified`), and the certificate's numbers, small arrays entry by entry. Raises
    UserError where every value is refused.
    """
    study, cell = one_cell(scenario, [observer], overrides or [])
    observer = label_of(observer)
    name, rows, reasons = option.replace("-", "_"), [], []
    if name not in (fields := cell.entry(observer).options.model_fields):
        raise unknown(f"--sweep of {observer}", "option", option, fields)
    for value in values:
        row: dict[str, Any] = {
            name: value,
            "rate": np.nan,
            "margin": np.nan,
            "solver": "",
            "fallback": "",
            "certified": None,
            "refused": "",
        }
        try:
            with config.float64():
                c = design(_changed(study, observer, {name: value}), observer, gain=gain)[2].certificate
            row |= {"rate": c.rate, "margin": c.margin, "solver": c.solver, "fallback": c.fallback}
            row |= {"certified": is_certified(c._asdict())} | _entries(c.numbers)
        except UserError as error:
            reasons.append(error)
            row["refused"] = str(error)
        rows.append(row)
    if len(reasons) == len(rows):
        raise reasons[0]
    return pd.DataFrame(rows)


def _changed(study: Study, observer: str, options: dict[str, Any]) -> Study:
    given = study.options.get(observer, {})
    return study.model_copy(update={"options": study.options | {observer: given | options}})


def _way_of(entry: ObserverSpec) -> list[str]:
    """The option that says how an observer's gains are found, if it has one."""
    return [name for name, field in entry.options.model_fields.items() if extra(field).get(WAY)]


def _way(entry: ObserverSpec, observer: str, gain: str) -> str:
    """The option to set for a way to find gains; raise UserError where the observer has no such."""
    names = _way_of(entry)
    if not names:
        raise UserError(f"--gain: got '{gain}', but {observer} has one way to find its gains; leave it out.")
    valid = get_args(entry.options.model_fields[names[0]].annotation)
    if gain not in valid:
        raise unknown("--gain", f"way to find gains of {observer}", gain, valid)
    return names[0]


def _as_options(model: type[BaseModel], options: BaseModel, found: Design) -> dict[str, Any]:
    """The numbers of a certificate that an option of the same name can hold, where it was left open or named a way."""
    out: dict[str, Any] = {}
    for name, field in model.model_fields.items():
        value = getattr(options, name)
        if (
            name in found.certificate.numbers
            and (value is None or isinstance(value, str))
            and not extra(field).get(WAY)
        ):
            number = np.asarray(found.certificate.numbers[name], float)
            number = np.where(np.abs(number) < NOTHING * np.abs(number).max(initial=0.0), 0.0, number)
            for each in (number.tolist(), *([number.item()] if number.size == 1 else [])):
                try:
                    model.model_validate(options.model_dump() | {name: each})
                except ValidationError:
                    continue
                out[name] = each
    return out


def _proven_again(study: Study, cell: Cell, observer: str, chosen: dict[str, Any]) -> dict[str, Any] | None:
    """The options with these numbers, with as much of a decay as they can be proven to have; None where they are refused."""
    slower = [chosen | {"decay": BACK * chosen["decay"]}] if chosen.get("decay") else []
    for each in (*slower, {k: v for k, v in chosen.items() if k != "decay" or not v}):
        try:
            here = _changed(study.model_copy(update={"options": {}}), observer, each)
            designed(observer, cell.entry(observer), setting(cell), one_cell(here, [observer], [])[1].options[observer])
        except UserError:
            continue
        return each
    return None


def _entries(numbers: Any) -> dict[str, Any]:
    """Numbers as columns: an array of a few entries is name[0], name[1], ..., row by row."""
    out: dict[str, Any] = {}
    for name, value in numbers.items():
        flat = np.asarray(value).ravel()
        if name not in HIDDEN and flat.size <= FEW and np.isrealobj(flat):
            out |= {name if flat.size == 1 else f"{name}[{i}]": float(x) for i, x in enumerate(flat)}
    return out


def _finite(x: float) -> float | str:
    return float(x) if np.isfinite(x) else "none"
