"""The grid of a study: every combination of its axes in every scenario, and the digest of all that decides its numbers."""

import hashlib
import itertools
import json
import math
from collections.abc import Iterator
from importlib.metadata import version
from typing import NamedTuple, TypeVar

from pydantic import BaseModel

from pcbench.errors import UserError
from pcbench.observers import ObserverSpec, entry_of
from pcbench.scenarios import Scenario
from pcbench.study import Choices, Study, choices_of, fits, observers_of, options_of, scenarios_of
from pcbench.study import axes as axis
from pcbench.study.axes import axes_of
from pcbench.study.labels import plugin_in
from pcbench.study.lti_plant import require_plant
from pcbench.study.options import checked_options
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.times import Timing, require_few_cells, times_of, to_ticks
from pcbench.toml_text import TomlTable

V = TypeVar("V")


class Cell(NamedTuple):
    """A grid point: one combination of a study's axes in one scenario, with all numbers."""

    scenario: Scenario  # with the values of the axes
    number: int  # from 0, within its scenario
    values: TomlTable  # by axis, seconds and SI units, as in the tables
    parameters: TomlTable  # of the plant, if the scenario or an axis changes them
    choices: Choices
    times: Timing
    options: dict[str, BaseModel]  # by label of its observers, validated, with defaults
    user_observers: dict[str, UserPlugin]  # user-defined observers by label
    options_digests: dict[str, str]  # digest of the options by label
    digest: str  # of everything that decides its numbers, without observers; empty: not part of a study
    engine: str = "steps"  # steps or definition, see `Study`

    @property
    def key(self) -> tuple[str, int]:
        """Return its scenario's name and its number, the key in a study."""
        return self.scenario.name, self.number

    def entry(self, label: str) -> ObserverSpec:
        """Return the entry of an observer, user-defined or built-in."""
        return self.user_observers[label].entry if label in self.user_observers else entry_of(label)

    def with_fields(self, **changes: object) -> "Cell":
        """Return the grid point with changed fields of its scenario and new times; it is then not part of a study."""
        scenario = self.scenario.with_fields(**changes)
        return self._replace(scenario=scenario, times=times_of(scenario), digest="")


class Grid(NamedTuple):
    """A study with its grid points; those of a scenario are adjacent."""

    study: Study
    cells: list[Cell]


def cell_of(
    scenario: Scenario,
    number: int = 0,
    values: TomlTable | None = None,
    parameters: TomlTable | None = None,
    choices: Choices | None = None,
) -> Cell:
    """Return a scenario as a grid point that is not part of a study, with its times in ticks."""
    values, parameters, choices = values or {}, parameters or {}, choices or Choices()
    cell = Cell(
        scenario,
        number,
        values,
        parameters,
        choices,
        times_of(scenario),
        options={},
        user_observers={},
        options_digests={},
        digest="",
    )
    return cell._replace(engine="definition") if scenario.sampling.sensors_decide else cell


def cells(study: Study, scenario: str, where: str | None = None) -> list[Cell]:
    """Return the grid points of one scenario, one per combination of the axes, in the order in which the axes are written.

    If each axis varies by itself: first values of all axes, then each other value of each axis.
    """
    base, where = scenarios_of(study)[scenario], where or study.name
    axes = {name: axis.axis_values(name, values, base, f"{where}: axes.{name}") for name, values in study.axes.items()}
    lengths = [len(values) for values in axes.values()]
    n_cells = math.prod(lengths) if study.vary == "all" else 1 + sum(lengths) - len(lengths)
    require_few_cells(n_cells, to_ticks(base.duration, base), where)
    choices, out, as_lists, its_axes = choices_of(study), [], axes_with_lists(study), axes_of(base)
    commands = sorted(command_columns(study) - set(its_axes))
    options = {o: options_of(study, base, o) for o in observers_of(study, scenario)}
    plugins = {o: plugin for o in options if (plugin := plugin_in(study, o))}
    digests = {o: options_digest(m, plugins.get(o)) for o, m in options.items()}
    names, tuned = _tuned_by_point(study, base, where)
    for index, point in enumerate(points(study.vary, list(axes.values()))):
        axis_values = dict(zip(axes, point, strict=True))
        fields = {k: v for k, v in axis_values.items() if k in its_axes}
        if "process_std" in axis_values and base.belief.assumed_process_std == base.truth.process_std:
            # designs assume the true process noise, as in the scenario
            fields["assumed_process_std"] = axis_values["process_std"]
        s = base.with_fields(**fields, input=choices.input or base.loop.input)
        if choices.unknown_input:
            if not base.truth.unknown_input:
                raise UserError(
                    f"{where}: options.scenario.unknown_input: got {choices.unknown_input!r} for {scenario}, whose plant has "
                    "no unknown input; expected a scenario such as arm/sine; leave it out."
                )
            s = s.with_fields(unknown_input=choices.unknown_input)
        _require_loop(s, choices, where)
        fits.fits(s, where if where == scenario else f"{where}: {scenario}")
        columns = [name for name in its_axes if name in axis_values or name not in axis.OPTIONAL]
        values = {name: axis.plain(name, s.value(name), name in as_lists) for name in columns}
        values |= dict.fromkeys(commands)  # null: the loop has no controller
        plant_values = {k: v for k, v in axis_values.items() if k.startswith("plant.")}
        parameters = dict(base.truth.parameters) | {k.removeprefix("plant."): v for k, v in plant_values.items()}
        if base.plant == "lti":
            require_plant(s, parameters, where)
        cell = cell_of(s, index, values | plant_values, parameters, choices)
        tuned_options = _tuned_options(study, cell, list(options), names, tuned, where) if tuned else {}
        by_label = digests | {o: options_digest(m, plugins.get(o)) for o, m in tuned_options.items()}
        cell = cell._replace(digest=identity(cell, study.root_seed), engine=engine_of(s, study.engine or "steps"))
        out.append(cell._replace(options=options | tuned_options, user_observers=plugins, options_digests=by_label))
    return out


OptionsByPoint = dict[tuple[object, ...], dict[str, TomlTable]]  # by values of axes, the options of each label


def _tuned_by_point(study: Study, base: Scenario, where: str) -> tuple[list[str], OptionsByPoint]:
    """Return the axes and options of a scenario's grid points that were tuned separately; empty if none."""
    record = study.tuned if study.tuned and study.tuned.scenario == base.name else None
    cells, out = (record and record.cells) or [], OptionsByPoint()
    names = list(cells[0].cell) if cells else []
    for i, entry in enumerate(cells):
        place = f"{where}: tuned.cells[{i}].cell"
        if list(entry.cell) != names:
            raise UserError(f"{place}: got {', '.join(entry.cell)}, expected {', '.join(names)}, as the first has.")
        point = tuple(axis.axis_values(name, [v], base, f"{place}.{name}")[0] for name, v in entry.cell.items())
        out[point] = entry.options
    return names, out


def _tuned_options(
    study: Study, cell: Cell, labels: list[str], names: list[str], tuned: OptionsByPoint, where: str
) -> dict[str, BaseModel]:
    """Return the options tuned at this grid point; raise UserError if only other grid points were tuned."""
    values = {f"plant.{name}": value for name, value in cell.parameters.items()}
    point = tuple(values[name] if name in values else cell.scenario.value(name) for name in names)
    if (by_label := tuned.get(point)) is not None:
        place = f"{study.name}: tuned.cells: options"
        return {o: checked_options(study, o, by_label[o], f"{place}.{o}") for o in labels if o in by_label}
    missing = sorted({label for t in tuned.values() for label in t} & set(labels))
    if not missing:
        return {}
    at = ", ".join(f"{name} = {axis.plain(name, value)}" for name, value in zip(names, point, strict=True))
    raise UserError(
        f"{where}: tuned.cells: got no gains of {', '.join(missing)} at {at}, expected those of every grid point; tune again "
        "with this one in the axes."
    )


def points(vary: str, axes: list[list[V]]) -> Iterator[tuple[V, ...]]:
    """Return the values of the axes at every grid point."""
    if vary == "all":
        yield from itertools.product(*axes)
        return
    first = tuple(values[0] for values in axes)
    yield first
    for i, values in enumerate(axes):
        yield from ((*first[:i], value, *first[i + 1 :]) for value in values[1:])


def _require_loop(s: Scenario, choices: Choices, where: str) -> None:
    """Raise UserError if an option for closed loops is given for an open loop, or the reverse."""
    loop_choices = [(name, value) for name, value in choices.loop().items() if value is not None]
    if loop_choices and s.loop.controller != "pd":
        got = f"{where}: options.scenario.{loop_choices[0][0]}: got {loop_choices[0][1]!r} for {s.name}"
        if not s.loop.controller:
            raise UserError(
                f"{got}, which has no controller, expected a closed loop such as helicopter/constant; leave it out."
            )
        raise UserError(
            f"{got}, whose loop is closed by {s.loop.controller}, expected pd, the only controller with this "
            "option; leave it out."
        )
    if choices.input and s.loop.controller:
        raise UserError(
            f"{where}: options.scenario.input: got {choices.input!r} for {s.name}, whose input comes from a controller, "
            "expected options.scenario.path instead; leave it out."
        )


def axes_with_lists(study: Study) -> set[str]:
    """Return the axes whose channels differ at any grid point of a study; its tables then have a list in every row."""
    scenarios, out = scenarios_of(study), set()
    for name in (*axis.CHANNELS, *axis.STATES, *axis.OUTPUTS, "delay_self_transition"):
        values = study.axes.get(name) or [scenarios[s].value(name) for s in study.scenarios]
        if any(isinstance(v, list | tuple) and len(set(v)) > 1 for v in values):
            out.add(name)
    return out


def command_columns(study: Study) -> set[str]:
    """Return the columns on commands that every table of a study has if one of its scenarios has a controller."""
    scenarios = scenarios_of(study)
    return {
        name
        for s in study.scenarios
        for name in axes_of(scenarios[s])
        if name in axis.COMMANDS and name not in axis.OPTIONAL
    }


def identity(cell: Cell, root_seed: int) -> str:
    """Return the digest of everything that decides a grid point's numbers, without its observers."""
    decisive = {
        "scenario": cell.scenario.flat(),
        "parameters": cell.parameters,
        "choices": cell.choices.model_dump(),
        "root_seed": root_seed,
    }
    return _digest(decisive)


def options_digest(options: BaseModel, plugin: UserPlugin | None = None) -> str:
    """Return the digest of an observer's options, and of its code if it is user-defined."""
    return _digest([options.model_dump(exclude_none=True), plugin.code.digest] if plugin else options.model_dump())


def _digest(decisive: object) -> str:
    text = json.dumps(decisive, sort_keys=True, default=lambda v: v.tolist() if hasattr(v, "tolist") else dict(v))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def with_engine(grid: Grid, engine: str | None) -> Grid:
    """Return the study with the engine that it names, by default steps.

    `engine` is the first engine of its dataset, which is kept. If that engine is not usable, the definition computes new runs.
    """
    study, cells = grid
    if engine is None:
        name = usable_engine(study.engine or "steps")
    else:
        name = engine if study.engine is None or usable_engine(study.engine) == engine else study.engine
    return Grid(
        study.model_copy(update={"engine": name}), [c._replace(engine=engine_of(c.scenario, name)) for c in cells]
    )


def engine_of(s: Scenario, engine: str) -> str:
    """Return the engine of a scenario: the definition if sensors decide, as other engines fix arrivals before a run."""
    return "definition" if s.sampling.sensors_decide else usable_engine(engine)


def usable_engine(engine: str) -> str:
    """Return the engine, or the definition if the engine does not support the installed jax."""
    from pcbench.engine import jaxpr_compat  # imports jax

    return engine if engine == "definition" or jaxpr_compat.is_supported() else "definition"


def engine_warnings(grid: Grid) -> list[str]:
    """Return a sentence if runs are computed by the definition because the engines do not support this jax."""
    slower = any(c.engine == "definition" and not c.scenario.sampling.sensors_decide for c in grid.cells)
    if not slower or grid.study.engine == "definition" or grid.study.evaluation == "exact":
        return []
    return [
        f"jax {version('jax')} is newer than the versions that pcbench's fast engines support: the engine "
        "`definition` computes the runs, more slowly and with the same numbers to 1e-11; install an earlier jax for speed."
    ]


def cells_of(study: Study) -> list[Cell]:
    """Return the grid points of all scenarios of a study."""
    return [cell for name in study.scenarios for cell in cells(study, name)]


def reseed(cells: list[Cell], root_seed: int) -> list[Cell]:
    """Return the grid points with another root seed, and so other random numbers."""
    return [cell._replace(digest=identity(cell, root_seed)) for cell in cells]


def number_cells(cells: list[Cell], order: dict[str, list[str]]) -> list[Cell]:
    """Return the grid points renumbered; those with the digests `order` (by scenario, by number) keep their numbers."""
    numbers = {name: {digest: i for i, digest in enumerate(digests)} for name, digests in order.items()}
    out = []
    for cell in cells:
        by_digest = numbers.setdefault(cell.scenario.name, {})
        out.append(cell._replace(number=by_digest.setdefault(cell.digest, len(by_digest))))
    return out


def numbering(cells: list[Cell]) -> dict[str, list[str]]:
    """Return the digests of the grid points by scenario, in order of number."""
    out: dict[str, list[str]] = {}
    for cell in sorted(cells, key=lambda c: c.number):
        out.setdefault(cell.scenario.name, []).append(cell.digest)
    return out
