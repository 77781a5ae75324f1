"""`observers = "all"`: every observer of pcbench that can run at all grid points of a study, and the reason for each excluded.

Each observer is planned as for a run, with its gains. An observer that is refused at one grid point is excluded from the study.
"""

from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.planning.build import draft
from pcbench.runtime import config
from pcbench.study import Study, parse
from pcbench.study.grid import Cell, Grid
from pcbench.study.labels import entry_in
from pcbench.study.load import StudyLike, raw_of, where_of
from pcbench.study.parse import ALL, FROM_HERE
from pcbench.toml_text import TomlTable


def grid_of(study: StudyLike, changes: TomlTable, overrides: list[str]) -> Grid:
    """Return a study with its grid, as `parse.grid_of`; "all" is replaced by the observers that can run."""
    raw, where = parse.apply_changes(study, changes, overrides)
    return parse.grid(resolve_observers(raw, where), where, FROM_HERE)


def resolve_observers(raw: TomlTable, where: str) -> TomlTable:
    """Return a raw study with every observer that can run instead of "all", and the reasons for the excluded ones."""
    if not parse.names_all(raw):
        return raw
    observers = raw["observers"]
    names, excluded = [name for name in observers if name != ALL] if isinstance(observers, list) else [], {}
    labels = [*OBSERVERS, *(label for label in raw.get("options") or {} if label not in ("scenario", "target"))]
    for label in dict.fromkeys(labels):
        if label in names:
            continue
        try:
            with config.float64():
                _try(raw | {"observers": [label]}, where, label)
        except UserError as error:
            excluded[label] = str(error)
        else:
            names.append(label)
    if not names:
        label, reason = next(iter(excluded.items()))
        raise UserError(f"{where}: observers: no observer can run; the first, {label}, is refused: {reason}")
    return raw | {"observers": names, "excluded": excluded or None}


def _try(raw: TomlTable, where: str, label: str) -> None:
    """Plan one observer at every grid point, with its own design if the study compares gains; or raise UserError."""
    grid = parse.grid(raw, where, FROM_HERE)
    grids, design_options = [grid], entry_in(grid.study, label).designed
    if grid.study.tunings != ["published"] and design_options:
        options = raw.get("options") or {}
        grids.append(
            parse.grid(
                raw | {"options": options | {label: options.get(label, {}) | dict(design_options)}}, where, FROM_HERE
            )
        )
    for cell in (cell for g in grids for cell in g.cells):
        draft(cell, cell.options)


def one_cell(study: StudyLike, observers: list[str], overrides: list[str]) -> tuple[Study, Cell]:
    """Return a study of these observers with its one grid point, as `parse.one_cell`; "all" becomes those that can run."""
    if ALL not in observers:
        return parse.one_cell(study, observers, overrides)
    raw = raw_of(study, overrides, FROM_HERE)
    table = resolve_observers(raw | {"observers": observers}, where_of(study, raw))
    return parse.one_cell(table, table["observers"], [])


def outline(source: str, overrides: list[str]) -> Study:
    """Return the named study, as `parse.outline`; "all" among its observers becomes those that can run."""
    return parse.build_study(resolve_observers(raw_of(source, overrides, FROM_HERE), source), source, FROM_HERE)


def sentences(excluded: dict[str, str] | None) -> list[str]:
    """Return one sentence per excluded observer with its reason."""
    return [f"{label} is left out of all observers: {reason}" for label, reason in (excluded or {}).items()]
