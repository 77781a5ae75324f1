"""Tuning of an observer's free parameters in a scenario, within a budget, validated on other seeds than those of the tuning.

With `exact_objective`, the objective is its expected value over all noise, without seeds and without validation.
"""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pcbench import planning
from pcbench.dataset import storage
from pcbench.dataset.seed_ranges import Seeds, common, seed_range
from pcbench.errors import UserError
from pcbench.gains import history, objective_eval, optimizers, parameters
from pcbench.gains.design import RATE_FRACTION, replace_options
from pcbench.gains.history import Evaluation, History, Judgement
from pcbench.gains.objective import Objective, objective_of
from pcbench.gains.parameters import Vector
from pcbench.gains.validation import judge, rejection_reason
from pcbench.planning import padding
from pcbench.protocols import Gains
from pcbench.runtime import config, ending
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import Study, merge_options, parse
from pcbench.study.grid import Cell
from pcbench.study.labels import label_of
from pcbench.study.options import with_options_of
from pcbench.study.plugins.references import absolute
from pcbench.study.serialize import digest
from pcbench.synthesis.certificate import Design, DesignContext, is_certified
from pcbench.toml_text import TomlTable

BUDGET = 60
TRAINING = seed_range(3_000_000_000, 256)  # far from the usual seeds of studies
VALIDATION = seed_range(3_500_000_000, 1024)


class NoStart(UserError):
    """The start of a tuning has no finite objective."""


class Tuning(NamedTuple):
    """The result of a tuning."""

    study: TomlTable  # the scenario and the observer with the chosen options: the content of tuned.toml
    start: TomlTable  # free parameters at the start
    best: TomlTable  # free parameters at the least value
    kept_start: str  # why the start is chosen; empty: `best` is chosen
    judgements: list[Judgement]
    points: list[Evaluation]
    method: str
    objective: Objective
    certified: bool | None = None  # whether the chosen gains are certified; None: the observer has no gains
    exact: bool = False  # whether the objective is its expected value; `judgements` then contains only that


def tune(
    scenario: parse.StudyLike,
    observer: str,
    *,
    budget: int = BUDGET,
    objective: str | None = None,
    signal: str | None = None,
    optimizer: str | None = None,
    exact_objective: bool = False,
    only: list[str] | None = None,
    training_seeds: Seeds = TRAINING,
    validation_seeds: Seeds = VALIDATION,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    progress: Progress = SILENT,
) -> Tuning:
    """Tune an observer's free parameters (`only` some of them) for a metric of a signal, and validate them on other seeds.

    `scenario` is a scenario's name, or a study with one scenario and one cell. `budget` is the largest number of points, each
    of which simulates all training runs. `training_seeds` and `validation_seeds` are ranges of seeds, (first, one past the
    last). `exact_objective` uses the expected value over all noise instead, without seeds. The default objective is rmse,
    with `exact_objective` pooled_rmse. With `out`, a folder, the history is stored there, and a stopped call continues if
    repeated. A finished tuning is cached for the same call of the same code. `progress` is notified of each point.
    Raises UserError for arguments that do not fit, a start without a value, and a folder with another tuning.
    """
    where = f"tune {observer}"
    training, validation = Seeds(*training_seeds), Seeds(*validation_seeds)
    _check(budget, training, validation, exact_objective, where)
    with config.float64(), ending.temporary_folder() as spare:
        study, cell = parse.one_cell(scenario, [observer], overrides or [])
        observer = label_of(observer)
        where = f"{where} in {cell.scenario.name}"
        aim = objective_of(objective or ("pooled_rmse" if exact_objective else "rmse"), cell.scenario, signal, where)
        draws = "exact" if exact_objective else f"seeds {training}"
        method = f"{optimizer or 'the optimizer that fits'}, {draws}, {', '.join(only or ['all'])} free"
        current = merge_options(study, cell.scenario, observer)
        observer_study = with_options_of(study, observer)
        origin = f"{current or 'its defaults'}, {digest(observer_study, [cell])[:12]}"
        about = f"{where}: {aim.metric} of {aim.name} by {method}, from {origin}"
        task = f"{about}, {budget} points" + ("" if exact_objective else f", judged on {validation}")
        target = storage.target(str(out) if out is not None else spare)
        basis = history.basis_of(observer_study, cell)
        history.copy_from_cache(target, task, about, basis)
        if record := history.load_finished(target, task, about, basis):
            return Tuning(objective=aim, **record)
        tuned = _optimize(
            study,
            cell,
            observer,
            aim,
            lambda names: History(target, about, names, basis),
            budget=budget,
            optimizer=optimizer,
            only=only,
            seeds={} if exact_objective else {"training": training, "validation": validation},
            where=where,
            progress=progress,
        )
        history.finish(target, task, tuned)
        history.keep_result(target, task, basis)
        return tuned


def _optimize(
    study: Study,
    cell: Cell,
    observer: str,
    aim: Objective,
    open_history: Callable[[list[str]], History],
    *,
    budget: int,
    optimizer: str | None,
    only: list[str] | None,
    seeds: dict[str, Seeds],
    where: str,
    progress: Progress,
) -> Tuning:
    """Return the best of `budget` points, validated on other `seeds`; without seeds, the objective is its expected value."""
    context = planning.context_of(planning.with_computing_time(cell, observer))
    start_design = planning.run_design(observer, cell.entry(observer), context, cell.options[observer])
    if decay := getattr(cell.options[observer], "decay", None):
        # a gain designed for a rate barely has it, so a certificate of that rate may fail for a gain near it
        study, cell = parse.one_cell(replace_options(study, observer, {"decay": RATE_FRACTION * decay}), [observer], [])
    free, start = free_parameters(observer, cell, context, start_design, only, where)
    gains = gains_at(observer, cell, context, free)
    (p,) = padding.fit(list(planning.drafts([cell])))
    objective_eval.check_estimates(p, aim, where)
    method = objective_eval.method_for(optimizer, aim, p, not seeds, where)
    if seeds:
        evaluate = objective_eval.evaluator(method, p, aim, study.root_seed, np.arange(*seeds["training"]), gains)
    else:
        evaluate = objective_eval.exact_evaluator(p, aim, len(start), gains, where)
    trials = open_history(parameters.entries(free))
    progress.begin("points", budget)
    progress.note("compiling")
    descend(method, trials, start, evaluate, budget, where, progress)
    best = np.array(trials.best.parameters)
    tuned_options, kept_start = parameters.to_options(free, best), ""
    if seeds:
        progress.note("validation on other seeds")
        judgements = judge(study, observer, tuned_options, aim, seeds)
        kept_start = rejection_reason(judgements)
    else:
        judgements = [objective_eval.exact_judgement(aim, trials.points[0].value, trials.best.value)]
    chosen = parameters.with_values(cell.options[observer], free, start if kept_start else best)
    return Tuning(
        study=with_options(study, observer, {} if kept_start else tuned_options),
        start=parameters.to_options(free, start),
        best=tuned_options,
        kept_start=kept_start,
        judgements=judgements,
        points=trials.points,
        method=method,
        objective=aim,
        certified=is_certified(
            planning.run_design(observer, cell.entry(observer), context, chosen).certificate._asdict()
        ),
        exact=not seeds,
    )


def gains_at(
    observer: str, cell: Cell, context: DesignContext, free: list[parameters.Free]
) -> Callable[[Vector], Gains]:
    """Return the observer's gains as a function of its free parameters."""
    entry, options = cell.entry(observer), cell.options[observer]
    return lambda at: planning.run_design(observer, entry, context, parameters.with_values(options, free, at)).gains


def free_parameters(
    observer: str, cell: Cell, context: DesignContext, design: Design, only: list[str] | None, where: str
) -> tuple[list[parameters.Free], Vector]:
    """Return the free parameters on which the gains depend, and their start; errors as of `parameters.start`."""
    entry, options, numbers = cell.entry(observer), cell.options[observer], design.certificate.numbers
    free, at = parameters.start(observer, entry, options, numbers, only, where)
    gains = gains_at(observer, cell, context, free)
    sensitive = parameters.sensitive_names(free, at, lambda point: optimizers.numbers(gains(point)))
    if not sensitive:
        names = ", ".join(f.name for f in free)
        raise parameters.NothingFree(
            f"{where}: got free parameters ({names}) on which its gains do not depend with this design method, expected one "
            "on which they do; change the design method, or tune another observer."
        )
    return parameters.start(observer, entry, options, numbers, sensitive, where)


def descend(
    optimizer: str,
    trials: History,
    start: Vector,
    evaluate: objective_eval.Evaluate,
    budget: int,
    where: str,
    progress: Progress,
) -> None:
    """Evaluate points from a start on, and write their history; raise NoStart if the objective at the start is not finite."""

    def ask(at: Vector) -> tuple[float, Vector]:
        first = not trials.points
        value, slope = trials.ask(at, evaluate)
        if first and not np.isfinite(value):
            raise NoStart(
                f"{where}: a training run diverges, or the gains are refused, at the start; expected a start that works; write "
                "another one under [options]."
            )
        progress.step(1)
        progress.note(f"least so far {trials.best.value:.5g}")
        return value, slope

    storage.create_folder(trials.target)
    if optimizer == "descent":
        optimizers.descent(ask, start, budget)
    else:
        optimizers.search(lambda at: ask(at)[0], start, budget)
    trials.write()


def _check(budget: int, training: Seeds, validation: Seeds, exact: bool, where: str) -> None:
    if budget < 1:
        raise UserError(f"{where}: --budget: got {budget}, expected 1 or more; leave it out for {BUDGET}.")
    if exact and (training, validation) != (TRAINING, VALIDATION):
        raise UserError(
            f"{where}: --exact-objective: got training or validation seeds, expected none: an expected value needs no runs; "
            "leave --training-seeds and --validation-seeds out, or --exact-objective."
        )
    for name, seeds in (("--training-seeds", training), ("--validation-seeds", validation)):
        if seeds.many < 2 or seeds.first < 0 or seeds.stop > 2**32:
            raise UserError(f"{where}: {name}: got {seeds}, expected two seeds or more of 0:4294967296.")
    if common(training, validation).many:
        raise UserError(
            f"{where}: got training seeds {training} and validation seeds {validation}, which overlap; expected none "
            "in common, because a tuning cannot be validated on its own training runs; give others."
        )


def with_options(study: Study, observer: str, values: TomlTable) -> TomlTable:
    """Return the study as TOML writes it, with the options `values` for the observer."""
    raw = absolute(study.model_dump(exclude_none=True, exclude_defaults=True))
    options = raw.get("options", {})
    observer_options = options.get(observer, {}) | values
    return raw | ({"options": options | {observer: observer_options}} if observer_options else {})
