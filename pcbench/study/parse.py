"""Parse a study from a name or a TOML file, with overrides, and check it before anything runs.

Every error is one sentence: the place, the value, what was expected, and how to correct it.
"""

from pydantic import ValidationError

from pcbench.errors import UserError, short, unknown
from pcbench.observers import OBSERVERS
from pcbench.plants import signals_of
from pcbench.scenarios import Scenario
from pcbench.signal_names import require_different
from pcbench.study import KEYS, LTI, Study, checked_options, controller_table, fits, labels_of, scenarios_of, times
from pcbench.study.grid import Cell, Grid, cells
from pcbench.study.labels import base_in
from pcbench.study.load import StudyLike, normalize_raw, raw_of, where_of
from pcbench.study.plugins import registry
from pcbench.study.plugins.references import Gate, PluginReference, references_in
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.plugins.user_plants import plain
from pcbench.study.pydantic_errors import user_error
from pcbench.toml_text import TomlTable

ALL = "all"  # all observers that can run


def _load_plugin(reference: PluginReference, where: str) -> UserPlugin:
    """Run the code that a study names, with paths relative to the working folder."""
    return registry.load(reference.kind, reference.reference, where)


FROM_HERE = Gate(_load_plugin, files=True)  # for a study given by the user


def load(source: str, overrides: list[str] | None = None) -> Study:
    """Return a checked study from a built-in name, a scenario's name or a TOML file, with `key=value` overrides applied."""
    return parse(raw_of(source, overrides or [], FROM_HERE), source)


def build_study(raw: TomlTable, where: str, gate: Gate) -> Study:
    """Return the study that `raw` describes, with names and options checked, without its grid.

    `gate` controls access to code and files.

    Raises UserError with the place of the error.
    """
    raw = normalize_raw(raw, where, None, gate)
    table, tables = raw.get("scenario"), raw.get("tables")
    own_names = [LTI] if raw.get("lti") is not None else []
    if table is not None:
        own_names.append(str((table.get("name") if isinstance(table, dict) else None) or raw.get("name")))
    own_names += tables if isinstance(tables, dict) else ()
    if own_names and not raw.get("scenarios"):  # no other scenarios are named
        raw = raw | {"scenarios": own_names}
    try:
        study = Study.model_validate(raw)
    except ValidationError as error:
        raise user_error(where, error, KEYS) from None
    by_place = {"scenario": study.scenario} if study.scenario else {}
    by_place |= {f"scenarios.{name}": t for name, t in (study.tables or {}).items()}
    labels = {o for t in by_place.values() for o in (*(t.observers or ()), *(t.options or ()))}
    if (n_labels := len({*(study.observers or ()), *study.options, *labels})) > times.LABELS:
        raise UserError(
            f"{where}: got {n_labels:,} observers and options of observers, expected at most {times.LABELS:,}; divide the "
            "study."
        )
    for reference in references_in(raw):
        place = f"{where}: {reference.key if reference.kind == 'observer' else reference.kind}"
        study._plugins[reference.key] = gate.code(reference, place)
    scenarios = scenarios_of(study, where)
    for name in study.scenarios:
        if name not in scenarios:
            raise unknown(f"{where}: scenarios", "scenario", name, scenarios)
    require_different(study.scenarios, f"{where}: scenarios", "remove one")
    lists = {"observers": study.observers, "lti.observers": study.lti.observers if study.lti else None}
    for place, names in (lists | {f"{place}.observers": t.observers for place, t in by_place.items()}).items():
        if names is not None:
            _require_observers(study, names, f"{where}: {place}")
    options = {f"{place}.": table.options or {} for place, table in by_place.items()} | {"": study.options}
    for place, by_label in options.items():
        for name, values in by_label.items():
            checked_options(study, name, values, f"{where}: {place}options.{name}")
    return study


def outline(source: str, overrides: list[str]) -> Study:
    """Return the named study, as `build_study`; its code is run, its grid is not made.

    If its observers are "all", they are not yet resolved, and those of its scenarios are used.
    """
    raw = raw_of(source, overrides, FROM_HERE)
    if names_all(raw):
        del raw["observers"]
    return build_study(raw, source, FROM_HERE)


def names_all(raw: TomlTable) -> bool:
    """Return whether "all" is among the observers of a raw study."""
    observers = raw.get("observers")
    return observers == ALL or (isinstance(observers, list) and ALL in observers)


def grid(raw: TomlTable, where: str, gate: Gate) -> Grid:
    """Return the study that `raw` describes with its grid; raise UserError with the place of the error."""
    study, all_cells = build_study(raw, where, gate), []
    for name in study.scenarios:
        scenario_cells = cells(study, name, where)
        for observer in scenario_cells[0].options:
            for cell in scenario_cells:
                fits.works_on(observer, cell.entry(observer), cell.scenario, where)
        all_cells += scenario_cells
    return Grid(study, all_cells)


def stability_warnings(grid: Grid) -> list[str]:
    """Return a sentence for every loop that its controller does not stabilise; raise DesignError if a law has no gain."""
    scenarios = {(cell.scenario.name, str(cell.scenario.loop)): cell.scenario for cell in grid.cells}
    return [warning for s in scenarios.values() if (warning := controller_table.warning(s, grid.study.name))]


def parse(raw: TomlTable, where: str) -> Study:
    """Return the checked study that `raw` describes; raise UserError with the place of the error."""
    return grid(raw, where, FROM_HERE).study


def grid_of(study: StudyLike, changes: TomlTable, overrides: list[str]) -> Grid:
    """Return a checked study with its grid from a name, a TOML file, a dict or a Study, with top-level `changes`."""
    return grid(*apply_changes(study, changes, overrides), FROM_HERE)


def apply_changes(study: StudyLike, changes: TomlTable, overrides: list[str]) -> tuple[TomlTable, str]:
    """Return a raw study from a name, a TOML file, a dict or a Study, with `changes`, and its name in messages."""
    raw = raw_of(study, overrides, FROM_HERE)
    where = where_of(study, raw)
    return raw | {key: plain(value) for key, value in changes.items() if value is not None}, where


def one_cell(source: StudyLike, observers: list[str], overrides: list[str]) -> tuple[Study, Cell]:
    """Return a study of these observers with its one grid point; raise UserError if it has more."""
    study, all_cells = grid_of(source, {"observers": observers}, overrides)
    if len(all_cells) > 1:
        raise UserError(
            f"{study.name}: got {len(all_cells)} grid points, expected one here; name one scenario, and give each axis one "
            "value."
        )
    return study, all_cells[0]


def scenario_of(source: str, overrides: list[str] | None = None) -> Scenario:
    """Return the one scenario of a name or a TOML file; raise UserError if there are more."""
    return scenario_in(outline(source, overrides or []), source)


def scenario_in(study: Study, where: str) -> Scenario:
    """Return the one scenario of a study; raise UserError if there are more."""
    if len(study.scenarios) > 1:
        raise UserError(f"{where}: got {len(study.scenarios)} scenarios, expected one here; name a scenario.")
    return scenarios_of(study)[study.scenarios[0]]


def _require_observers(study: Study, names: list[str], where: str) -> None:
    """Raise UserError if a list of observers is empty, or contains an unknown or repeated name."""
    if not names:
        raise UserError(f"{where}: got an empty list, expected at least one of {', '.join(OBSERVERS)}.")
    valid = set(labels_of(study))
    for name in names:
        if name == ALL and where.endswith(": observers"):
            raise UserError(f"{where}: got 'all', expected the name of one observer here; see pcbench list observers.")
        if name == ALL:
            raise UserError(
                f'{where}: got "all", expected names here; write observers = "all" at the top of the study.'
            )
        if name not in valid and (base := base_in(study, name)) is not None:
            raise UserError(
                f"{where}: got '{short(name)}' without options, expected some for a label of {base}; write "
                f"[options.{short(name)}]."
            )
        if name not in valid:
            raise unknown(where, "observer", name, valid)
    require_different(names, where, "remove one")


def require_signals(study: Study, names: list[str] | None, where: str) -> None:
    """Raise UserError for a signal that no scenario of a study has."""
    scenarios = scenarios_of(study)
    signals = [signal for name in study.scenarios for signal, _ in signals_of(scenarios[name])]
    for name in names or []:
        if name not in signals:
            raise unknown(where, f"signal of {study.name}", name, set(signals))
