"""Functions of `pcbench design`: one design with its certificate, the same design as a study, and trade-offs.

The theorems are in `synthesis`; an observer's `design` calls them.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, get_args

import numpy as np
import tomli_w
from pydantic import BaseModel, ValidationError

from pcbench.errors import UserError, unknown
from pcbench.observers import ObserverSpec
from pcbench.observers.parts.options import METHOD, option_metadata
from pcbench.planning import context_of, run_design, with_computing_time
from pcbench.runtime import config
from pcbench.study import Study
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.parse import StudyLike, one_cell
from pcbench.study.plugins.references import absolute
from pcbench.synthesis.certificate import Design, is_certified
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    import pandas as pd

FEW = 6  # largest array in a row of a trade-off
ZERO_TOL = 1e-15  # relative to an array's largest entry; smaller entries are 0
RATE_FRACTION = 0.999  # of a decay rate: required of a gain given as a number, because it barely has that rate
HIDDEN = ("P", "P1", "P2", "shared_P")  # numbers of a certificate that a trade-off does not show


def design(
    scenario: StudyLike, observer: str, *, gain: str | None = None, overrides: list[str] | None = None
) -> tuple[Study, Cell, Design]:
    """Return an observer's design in the one cell of a scenario; `gain` is one of the observer's design methods.

    Raises UserError for another method, and DesignError if the gains are not certified.
    """
    study, cell = one_cell(scenario, [observer], overrides or [])
    label = label_of(observer)
    if gain is not None:
        entry = cell.entry(label)
        if not (option_name := _method_option(entry)):
            raise UserError(f"--gain: got '{gain}', but {label} has one design method; leave it out.")
        valid = get_args(entry.options.model_fields[option_name].annotation)
        if gain not in valid:
            raise unknown("--gain", f"design method of {label}", gain, valid)
        study, cell = one_cell(replace_options(study, label, {option_name: gain}), [label], [])
    context = context_of(with_computing_time(cell, label))
    return study, cell, run_design(label, cell.entry(label), context, cell.options[label])


def as_study(study: Study, cell: Cell, observer: str, design: Design) -> TomlTable:
    """Return a design as a study, as TOML writes it, with the gains as numbers if options exist for them.

    [resolved.certificate] contains the certificate; reading a study ignores it. These options have been designed again, so
    the study can be run.
    """
    observer = label_of(observer)
    entry, options, c = cell.entry(observer), cell.options[observer], design.certificate
    values = options.model_dump(exclude_none=True)
    if numbers := _as_options(entry.options, options, design):
        with_numbers = {k: v for k, v in values.items() if k != _method_option(entry)} | numbers
        values = _recertify(study, cell, observer, with_numbers) or values
    certificate: TomlTable = {"inequality": c.inequality, "margin": c.margin, "solver": c.solver, "status": c.status}
    certificate |= {"fallback": c.fallback, "decay_rate": c.rate, "certified": is_certified(c._asdict())}
    for key in ("margin", "decay_rate"):
        certificate[key] = float(certificate[key]) if np.isfinite(certificate[key]) else "none"
    raw = absolute(study.model_dump(exclude_none=True, exclude_defaults=True))
    raw["name"] = study.name if study.name.endswith(f"-{observer}") else f"{study.name}-{observer}"
    other_options = {k: v for k, v in raw.pop("options", {}).items() if k != observer}
    raw |= {"options": other_options | {observer: values}} if other_options or values else {}
    return raw | {"resolved": {"certificate": {k: v for k, v in certificate.items() if v is not None}}}


def to_toml(table: TomlTable) -> str:
    """Return a study as TOML text."""
    return tomli_w.dumps(table)


def trade_off(
    scenario: StudyLike,
    observer: str,
    option: str,
    values: Sequence[object],
    *,
    gain: str | None = None,
    overrides: list[str] | None = None,
) -> "pd.DataFrame":
    """Design gains for several values of one option.

    Args:
        scenario: a scenario's name, or a study with one scenario and one grid point.
        observer: name of the observer.
        option: name of the option.
        values: its values.
        gain: how gains are computed, as in `design`.
        overrides: changes of the study as texts.

    Returns:
        A frame with one row per value: the option, `rate` [1/s] of the guaranteed decay (NaN: none), `margin`, `solver`,
        `fallback`, `refused` (the reason for no gains; empty: none), `certified`, and the certificate's numbers, one
        column for each entry.

    Raises:
        UserError: the observer does not have this option, or every value is refused.
    """
    study, cell = one_cell(scenario, [observer], overrides or [])
    observer = label_of(observer)
    name, rows, reasons = option.replace("-", "_"), [], []
    if name not in (fields := cell.entry(observer).options.model_fields):
        raise unknown(f"--sweep of {observer}", "option", option, fields)
    for value in values:
        row: TomlTable = {name: value, "rate": np.nan, "margin": np.nan, "solver": "", "fallback": ""}
        row |= {"certified": None, "refused": ""}
        try:
            with config.float64():
                c = design(replace_options(study, observer, {name: value}), observer, gain=gain)[2].certificate
            row |= {"rate": c.rate, "margin": c.margin, "solver": c.solver, "fallback": c.fallback}
            row["certified"] = is_certified(c._asdict())
            for key, number in c.numbers.items():
                flat = np.asarray(number).ravel()
                if key not in HIDDEN and flat.size <= FEW and np.isrealobj(flat):
                    row |= {key if flat.size == 1 else f"{key}[{i}]": float(x) for i, x in enumerate(flat)}
        except UserError as error:
            reasons.append(error)
            row["refused"] = str(error)
        rows.append(row)
    if len(reasons) == len(rows):
        raise reasons[0]
    import pandas as pd

    return pd.DataFrame(rows)


def replace_options(study: Study, observer: str, options: TomlTable) -> Study:
    """Return a study with some options of an observer changed."""
    current = study.options.get(observer, {})
    return study.model_copy(update={"options": study.options | {observer: current | options}})


def _method_option(entry: ObserverSpec) -> str | None:
    """Return the option that selects an observer's design method, or None."""
    return next(
        (name for name, field in entry.options.model_fields.items() if option_metadata(field).get(METHOD)), None
    )


def _as_options(model: type[BaseModel], options: BaseModel, design: Design) -> TomlTable:
    """Return the certificate's numbers as options of the same names, for options that are None or a word."""
    out: TomlTable = {}
    for name, field in model.model_fields.items():
        is_open = getattr(options, name) is None or isinstance(getattr(options, name), str)
        if name not in design.certificate.numbers or not is_open or option_metadata(field).get(METHOD):
            continue
        number = np.asarray(design.certificate.numbers[name], float)
        number = np.where(np.abs(number) < ZERO_TOL * np.abs(number).max(initial=0.0), 0.0, number)
        for value in (number.tolist(), *([number.item()] if number.size == 1 else [])):
            try:
                model.model_validate(options.model_dump() | {name: value})
            except ValidationError:
                continue
            out[name] = value
    return out


def _recertify(study: Study, cell: Cell, observer: str, options: TomlTable) -> TomlTable | None:
    """Return the options with the largest decay that can be certified for these numbers; None if they are refused."""
    slow_candidates = [options | {"decay": RATE_FRACTION * options["decay"]}] if options.get("decay") else []
    for candidate in (*slow_candidates, {k: v for k, v in options.items() if k != "decay" or not v}):
        try:
            explicit = replace_options(study.model_copy(update={"options": {}}), observer, candidate)
            context = context_of(with_computing_time(cell, observer))
            run_design(observer, cell.entry(observer), context, one_cell(explicit, [observer], [])[1].options[observer])
        except UserError:
            continue
        return candidate
    return None
