"""Studies that compare gains of several origins: the key `tuning` of a study.

    published   as a scenario's source prints them (its options), overridden by the study's own options
    design      by the observer's own design for the true noise and delays
    tuned       by `tune`: the same budget for every observer, from the better of the two above on the training runs;
                `only` restricts it to options of those names

Three ranges of seeds are disjoint: the training runs, those that decide between a tuned gain and its start, and the study's
own, on which all are compared. With `exact_objective` in [tune] there are only the study's own.
In a study with several cells, gains are tuned in the first and run in all; with `cells = "all"` they are tuned separately in
every cell. Observers without a design for the noise, or without free parameters, have fewer versions. The resulting study has
explicit options only, so any machine can run, verify and merge it.
"""

import itertools
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from pcbench import planning
from pcbench.dataset import run_study, storage
from pcbench.dataset.manifest import KNOWN_FILES, TEXT
from pcbench.dataset.seed_ranges import Seeds, common, seed_range
from pcbench.errors import UserError
from pcbench.gains import objective_eval, parameters, tune, validation
from pcbench.gains.history import HISTORY, TUNED, AnotherTuning
from pcbench.gains.objective import Objective, objective_of
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import Study, TunedCell, TunedOptions, merge_options, observers_of, scenarios_of
from pcbench.study.grid import Grid, cells
from pcbench.study.grid import points as grid_points
from pcbench.study.labels import entry_in
from pcbench.study.parse import grid_of, one_cell
from pcbench.toml_text import TomlTable

VALIDATION = seed_range(tune.VALIDATION.first, 256)
Options = dict[str, TomlTable]  # by label or observer


class Version(NamedTuple):
    """One observer with the gains of one tuning."""

    label: str  # in the tables
    observer: str  # as the study names it
    tuning: str
    note: str = ""  # why its gains are not the tuned ones


class ExplicitStudy(NamedTuple):
    """A study with explicit options, and the versions of its labels."""

    grid: Grid
    versions: list[Version]  # empty: one tuning only
    aim: Objective | None = None

    @property
    def study(self) -> Study:
        """Return the study."""
        return self.grid.study


def prepare(grid: Grid, out: str | Path | None, overwrite: bool, progress: Progress = SILENT) -> ExplicitStudy:
    """Return the study to run, with designed and tuned gains; tunings are stored in out/tuning, from which they continue.

    Raises UserError for several tunings, or tuned gains, in more than one scenario.
    """
    study = grid.study
    if study.tunings == ["published"]:
        return ExplicitStudy(grid, [])
    if study.tunings == ["design"]:
        labels = dict.fromkeys(o for s in study.scenarios for o in observers_of(study, s))
        design_options = {o: study.options.get(o, {}) | dict(entry_in(study, o).designed or {}) for o in labels}
        return ExplicitStudy(_with_options(study, {o: values for o, values in design_options.items() if values}), [])
    if len(study.scenarios) > 1:
        raise UserError(
            f"{study.name}: tuning: got {study.tunings} for {len(study.scenarios)} scenarios, expected one: gains are tuned "
            "for one task; run a study for each."
        )
    scenario, where = scenarios_of(study)[study.scenarios[0]], f"{study.name}: tune"
    aim = objective_of(study.tune.objective, scenario, study.tune.signal, where)
    if study.tune.exact_objective:
        objective_eval.require_exact_value(aim, where)
    _require_other_seeds(study)
    _require_study_folder(study, out, overwrite)
    published_options = {o: merge_options(study, scenario, o) for o in observers_of(study, scenario.name)}
    validation.require_tunable(study, list(published_options))
    validation.require_free_labels(study, scenario, list(published_options))
    has_tuning, points, gains = "tuned" in study.tunings, [TomlTable()], []
    if has_tuning:  # the values of the axes in every cell in which gains are tuned
        all_points = grid_points(study.vary, list(study.axes.values()))
        all_points = itertools.islice(all_points, 1) if study.tune.cells == "first" else all_points
        points = [dict(zip(study.axes, point, strict=True)) for point in all_points]
    for i, point in enumerate(points):
        point_study = study.model_copy(update={"axes": {k: [v] for k, v in point.items()}}) if has_tuning else study
        folder = None if out is None else f"{out}/tuning"
        if len(points) > 1:
            folder = folder and f"{folder}/{cells(point_study, scenario.name)[0].digest}"
            progress.note(f"tuning in cell {i + 1} of {len(points)}")
        gains.append(_gains_in(point_study, published_options, aim, folder, progress))
    versions = [v for v in _versions_in(points, gains) if v.tuning in study.tunings]
    if len(study.tunings) == 1:  # labels need no suffix
        gains = [cell_gains.relabel({v.label: v.observer for v in versions}) for cell_gains in gains]
        versions = [v._replace(label=v.observer) for v in versions]
    order = list(published_options)
    versions.sort(key=lambda v: (order.index(v.observer), study.tunings.index(v.tuning)))
    record = None
    if has_tuning:
        tuned = [v.label for v in versions if v.tuning == "tuned"]
        by_cell = [
            TunedCell(cell=point, options={label: cell_gains.options[label] for label in tuned})
            for point, cell_gains in zip(points, gains, strict=True)
        ]
        record = TunedOptions(
            scenario=scenario.name,
            cell=points[0],
            metric=aim.metric,
            signal=aim.name,
            options={label: gains[0].tuned_options.get(label, {}) for label in tuned},
            cells=by_cell if len(points) > 1 else None,
        )
    options = {v.label: gains[0].options[v.label] for v in versions}
    return ExplicitStudy(_with_options(study, options, list(options), record), versions, aim)


class _Gains(NamedTuple):
    """The gains of all versions in one cell."""

    versions: list[Version]
    options: Options  # by label
    tuned_options: Options  # by label, the tuned options; empty if the start was kept

    def relabel(self, labels: dict[str, str]) -> "_Gains":
        """Return these gains under other labels; a label without a new one is left out."""
        versions = [v._replace(label=labels[v.label]) for v in self.versions if v.label in labels]
        options, tuned_options = (
            {labels[o]: values for o, values in all_of.items() if o in labels}
            for all_of in (self.options, self.tuned_options)
        )
        return _Gains(versions, options, tuned_options)


def _gains_in(
    study: Study, published_options: Options, aim: Objective, folder: str | None, progress: Progress
) -> _Gains:
    """Return the gains of all versions in a study of one cell; tunings are stored in `folder`."""
    gains = _Gains([], {}, {})
    for observer, printed_options in published_options.items():
        sources: dict[str, Mapping[str, Any] | None] = {"published": {}, "design": entry_in(study, observer).designed}
        for tuning, source_options in sources.items():
            if source_options is not None:
                gains.versions.append(Version(f"{observer}-{tuning}", observer, tuning))
                gains.options[f"{observer}-{tuning}"] = printed_options | dict(source_options)
    if "tuned" in study.tunings:
        for observer, start in _better_starts(study, gains.versions, gains.options, aim, progress).items():
            note, tuned_options = _tune_observer(study, observer, start, folder, progress)
            label = f"{observer}-tuned"
            gains.versions.append(Version(label, observer, "tuned", note))
            gains.options[label], gains.tuned_options[label] = start | tuned_options, tuned_options
    return gains


def _versions_in(points: list[TomlTable], gains: list[_Gains]) -> list[Version]:
    """Return the versions of all cells; in a cell without a version, it has published gains and a note."""
    first: dict[str, Version] = {}
    for cell_gains in gains:
        first |= {v.label: v for v in cell_gains.versions if v.label not in first}
    out = []
    for label, version in first.items():
        notes = []
        for cell_gains in gains:
            label_notes = [v.note for v in cell_gains.versions if v.label == label]
            if not label_notes:
                cell_gains.options[label] = cell_gains.options[f"{version.observer}-published"]
            notes.append(label_notes[0] if label_notes else "nothing to tune, so gains as printed")
        places = [", ".join(f"{name} = {value}" for name, value in point.items()) for point in points]
        text = "; ".join(f"at {place}: {note}" for place, note in zip(places, notes, strict=True) if note)
        out.append(version._replace(note=notes[0] if len(set(notes)) == 1 else text))
    return out


def _with_options(
    study: Study, options: Options, observers: list[str] | None = None, record: TunedOptions | None = None
) -> Grid:
    changes = {"options": study.options | options, "tuning": "published", "observers": observers}
    return grid_of(study, changes | {"tuned": record and record.model_dump()}, [])


def training_study(study: Study) -> Study:
    """Return the study on the training runs, or with exact evaluation."""
    if study.tune.exact_objective:
        return study.model_copy(update={"evaluation": "exact"})
    training = _training(study)
    return study.model_copy(update={"first_seed": training.first, "seeds": training.many})


def _require_other_seeds(study: Study) -> None:
    """Raise UserError if the study's own seeds overlap those of the tuning; an exact objective has none."""
    seeds = seed_range(study.first_seed, study.seeds)
    for tuning in () if study.tune.exact_objective else (_training(study), VALIDATION):
        if common(seeds, tuning).many:
            raise UserError(
                f"{study.name}: got seeds {seeds.first} .. {seeds.stop - 1}, expected none of {tuning.first} .. "
                f"{tuning.stop - 1}, on which gains are tuned; give another first_seed."
            )


def _training(study: Study) -> Seeds:
    return seed_range(tune.TRAINING.first, study.tune.training)


def _require_study_folder(study: Study, out: str | Path | None, overwrite: bool) -> None:
    """Raise UserError if a folder has other contents, before writing; `overwrite` removes earlier tunings."""
    if out is None:
        return
    target = storage.target(str(out))
    manifest, names = storage.read_bytes(target, TEXT), storage.file_names(target)
    other_files = [name for name in names if not name.startswith(KNOWN_FILES)]
    if manifest is None and other_files:
        raise UserError(
            f"{target.name}: contains other files ({other_files[0]}), expected a new or empty folder; give another with --out."
        )
    if manifest is not None and not any(name.startswith(KNOWN_FILES) for name in names) and not overwrite:
        raise UserError(
            f"{target.name}: contains the results of another study, expected {study.name}'s; give a new folder with --out, or "
            "start over with --overwrite."
        )
    tunings = re.compile(rf"{KNOWN_FILES[0]}(.+/)?({re.escape(HISTORY)}|{re.escape(TUNED)})")
    for name in [name for name in names if overwrite and tunings.fullmatch(name)]:
        storage.remove(target, name)


def _better_starts(
    study: Study, versions: list[Version], options: Options, aim: Objective, progress: Progress
) -> Options:
    """Return the start of each observer with free parameters: the options of its better version on the training runs."""
    free = {v.label: v for v in versions if _is_free(study, v, options[v.label])}
    if not free:
        return {}
    progress.note("comparing starts")
    starts = _with_options(training_study(study), {label: options[label] for label in free}, list(free))
    stats = run_study.execute(starts).stats
    rows = stats[(stats.signal == aim.name) & (stats.metric == aim.base)].set_index("observer")
    best: dict[str, tuple[tuple[float, float], str]] = {}
    for label, v in free.items():
        mean = float(rows["mean"][label])
        merit = float(rows["diverged"][label]), mean if np.isfinite(mean) else np.inf
        if v.observer not in best or merit < best[v.observer][0]:
            best[v.observer] = merit, label
    return {observer: options[label] for observer, (_, label) in best.items()}


def _is_free(study: Study, version: Version, options: TomlTable) -> bool:
    """Return whether a version has free parameters that affect its gains."""
    observer = version.observer
    only = validation.tune_only(study, observer)
    if not parameters.tunable(entry_in(study, observer)) or only == []:
        return False
    trial_study = study.model_copy(update={"options": study.options | {observer: options}, "tuning": "published"})
    cell = one_cell(trial_study, [observer], [])[1]
    context = planning.context_of(planning.with_computing_time(cell, observer))
    design = planning.run_design(observer, cell.entry(observer), context, cell.options[observer])
    try:
        return bool(tune.free_parameters(observer, cell, context, design, only, study.name))
    except parameters.NothingFree:
        return False


def _tune_observer(
    study: Study, observer: str, start: TomlTable, folder: str | None, progress: Progress
) -> tuple[str, TomlTable]:
    """Return the reason why the start is kept (empty: it is not), and the tuned options."""
    settings = study.tune
    seeds: TomlTable = {"training_seeds": _training(study), "validation_seeds": VALIDATION}
    changes = {"options": study.options | {observer: start}, "tuning": "published", "observers": [observer]}
    try:
        result = tune.tune(
            study.model_copy(update=changes | {"seeds": 1, "first_seed": 0}),
            observer,
            budget=settings.budget,
            objective=settings.objective,
            signal=settings.signal,
            exact_objective=settings.exact_objective,
            only=validation.tune_only(study, observer),
            out=folder and f"{folder}/{observer}",
            progress=Progress(
                begin=lambda what, many: progress.note(f"tuning {observer}"),
                note=lambda text: progress.note(f"tuning {observer}: {text}"),
            ),
            **({} if settings.exact_objective else seeds),
        )
    except tune.NoStart:
        return "the start has no finite value on the training runs", {}
    except AnotherTuning as error:
        raise UserError(f"{str(error).removesuffix('.')}, or start over with --overwrite.") from None
    return result.kept_start, {} if result.kept_start else result.best
