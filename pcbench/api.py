"""Functions of the Python API: `run`, `exact_moments`, `simulate`, `operation_counts`, `design` and `tune`."""

import warnings
from collections.abc import Mapping, Sequence
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from pcbench.dataset import run_study, single_table
from pcbench.dataset.result import Result
from pcbench.dataset.run_study import OnWarning
from pcbench.errors import UserError
from pcbench.gains import gain_variants
from pcbench.planning import all_observers, alone, digits, drafts, missing_inputs, padding, processor, samples_of
from pcbench.planning import operation_counts as counts
from pcbench.plants import output_units, signals_of
from pcbench.playback import run_as_log
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress
from pcbench.scenarios.sources import units
from pcbench.study import parse
from pcbench.study.grid import engine_warnings
from pcbench.study.parse import StudyLike
from pcbench.study.plugins.user_plants import plain
from pcbench.synthesis.certificate import Design, is_certified
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    import pandas as pd

    from pcbench.dataset.moments_frames import Exact
    from pcbench.gains.tune import Tuning
    from pcbench.playback.tuning import LogTuning


def run(
    study: StudyLike,
    *,
    seeds: int | None = None,
    first_seed: int | None = None,
    observers: str | Sequence[str] | None = None,
    axes: Mapping[str, object] | None = None,
    options: Mapping[str, TomlTable] | None = None,
    root_seed: int | None = None,
    evaluation: str | None = None,
    out: str | Path | None = None,
    overrides: list[str] | None = None,
    overwrite: bool = False,
    until_se: str | None = None,
    max_seeds: int | None = None,
    devices: int | None = None,
    dask: str | None = None,
    workers: int | None = None,
    block_size: int | None = None,
    memory: str | int | None = None,
    progress: Progress = SILENT,
    on_warning: OnWarning | None = None,
) -> Result:
    """Run a study and return its tables.

    Give `out` to keep the results in a folder: the same call then continues a run that was stopped, and does not repeat
    what is finished. Arrays, tuples, ranges and NumPy numbers may be given instead of lists and numbers.

    Args:
        study: a built-in study, a scenario's name, a TOML file, a dict of the same shape, or a Study.
        seeds: number of seeds (one run each) per grid point and observer.
        first_seed: index of the first seed.
        observers: names of observers. "all" selects those that support all grid points;
            `result.study.excluded` has the reasons for the others.
        axes: values of each axis by name, such as {"delay": [0.1, 0.2]} [s].
        options: options by observer.
        root_seed: root of all random numbers. Two studies with the same root share their noise.
        evaluation: "runs", "exact" or "both".
        out: folder or URI for the dataset. Default: a temporary folder that lives as long as the result.
        overrides: changes of the study as texts, such as "axes.noise_std=0.1".
        overwrite: delete what is in `out` first.
        until_se: "METRIC=VALUE" adds seeds to each grid point until each observer's standard error is at most VALUE.
        max_seeds: maximum seeds per grid point with `until_se`.
        devices: number of devices that compute at the same time. No effect on any number, as for the next four.
        dask: address of a Dask scheduler, or "local".
        workers: number of workers with dask="local".
        block_size: seeds per file.
        memory: bytes that results may take at a time, or a text such as "2GiB". Default: a quarter of the machine's memory.
        progress: is called with the progress (see `runtime.progress`).
        on_warning: is called with each warning. Default: Python warnings.

    Returns:
        The result: `.stats`, `.pairs` and `.runs` are pandas frames. If the study compares several tunings, `.fair` is a
        frame too.

    Raises:
        UserError: a mistake in the study, an argument or the folder, in one sentence.
        DigitsError: a state grows so large that float64 leaves fewer than two digits of the errors.
    """
    observers = [observers] if isinstance(observers, str) else observers
    changes = {"seeds": seeds, "observers": observers, "axes": axes, "options": options, "root_seed": root_seed}
    grid = all_observers.grid_of(study, changes | {"first_seed": first_seed, "evaluation": evaluation}, overrides or [])
    with config.float64():
        run_options = run_study.RunOptions(
            overwrite=overwrite,
            until_se=until_se,
            max_seeds=plain(max_seeds),
            devices=plain(devices),
            dask=dask,
            workers=plain(workers),
            block_size=plain(block_size),
            memory=plain(memory),
            progress=progress,
            on_warning=on_warning or (lambda sentence: None),
        ).checked()
        if on_warning:
            for sentence in all_observers.sentences(grid.study.excluded):
                on_warning(sentence)
        for sentence in [*parse.stability_warnings(grid), *engine_warnings(grid)]:
            (on_warning or warnings.warn)(sentence)
        variants = gain_variants.prepare(grid, out, overwrite, progress)
        if on_warning and variants.study.tuning_sentence:
            on_warning(variants.study.tuning_sentence)
        result = run_study.execute(variants.grid, out, run_options)
        for sentence in missing_inputs.explain_divergence(variants.grid, lambda: result.stats):
            (on_warning or warnings.warn)(sentence)
        if variants.aim is None:
            return result
        from pcbench.gains import fair_comparison  # tuned gains alone need it

        return fair_comparison.report(variants, result, out, run_options)


def exact_moments(
    study: StudyLike,
    *,
    observers: str | Sequence[str] | None = None,
    axes: Mapping[str, object] | None = None,
    options: Mapping[str, TomlTable] | None = None,
    root_seed: int | None = None,
    overrides: list[str] | None = None,
    schedules: int = 64,
    progress: Progress = SILENT,
) -> "Exact":
    """Return means and variances of the errors over infinitely many seeds, without simulating any.

    The answer is exact if plant, observer and controller are affine in the noise for a given schedule. This is checked in
    each grid point. If the check fails, the `reason` column of `stats` explains why.

    Args:
        study: as in `run`, like the next five.
        observers: names of observers.
        axes: values of each axis by name.
        options: options by observer.
        root_seed: root of all random numbers, here of the schedules.
        overrides: changes of the study as texts.
        schedules: number of schedules to average over if each run has its own, 2 or more.
        progress: is called with the progress.

    Returns:
        `.stats` is like that of a result; `.moments()` has mean and standard deviation of the errors over time;
        `.covariance()` is the joint covariance of all errors of a grid point.

    Raises:
        UserError: a mistake in the study or an argument, in one sentence.
    """
    from pcbench.dataset.moments_frames import Exact  # with pandas

    if schedules < 2:
        raise UserError(f"schedules: got {schedules}, expected 2 or more.")
    observers = [observers] if isinstance(observers, str) else observers
    changes = {"observers": observers, "axes": axes, "options": options, "root_seed": root_seed}
    with config.float64():
        grid = all_observers.grid_of(study, changes, overrides or [])
        return Exact(gain_variants.prepare(grid, None, False, progress).grid, schedules)


def simulate(
    scenario: StudyLike,
    observers: str | Sequence[str],
    *,
    seed: int = 0,
    overrides: list[str] | None = None,
    log: str | Path | None = None,
) -> "pd.DataFrame":
    """Simulate one run and return it tick by tick, ticks 0 .. N.

    Estimates are those of the present, after the measurements that arrive at the tick have been used.

    Args:
        scenario: a scenario's name, or a study (TOML file, dict, `pcbench.lti`) with one scenario and one grid point.
        observers: names of observers, or "all". A closed loop takes one.
        seed: index of the seed.
        overrides: changes of the study as texts, such as "scenario.delay=0.2".
        log: folder for measurements, inputs and truth as a recording for `pcbench.replay`. Default: none is written.

    Returns:
        A frame with t [s], each signal (states, then the plant's unknown inputs or parameters), OBSERVER.SIGNAL for each
        estimate, OBSERVER.ERROR for each of the plant's own errors, u1.. (input held over the tick), and y1.. (newest
        measurement that has arrived; NaN before the first). With the option `consistency` also OBSERVER.SIGNAL.sigma, the
        assumed standard deviation; of an observer with bounds OBSERVER.SIGNAL.low and .high, the ends of its interval; in a
        closed loop target.SIGNAL, the set point. `attrs["excluded"]` has the reasons why observers of "all" are missing.

    Raises:
        UserError: a mistake in the study or an argument, in one sentence.
        DigitsError: a state grows so large that float64 leaves fewer than two digits of the errors.
    """
    names = [observers] if isinstance(observers, str) else list(observers)
    if not 0 <= seed < 2**32:
        raise UserError(f"--seed: got {seed}, expected a seed index of 0 or more, below 2^32.")
    with config.float64():
        study, cell = all_observers.one_cell(scenario, names, overrides or [])
        if cell.scenario.loop.controller and len(cell.options) > 1:
            raise UserError(
                f"{study.name}: got {len(cell.options)} observers in a closed loop, expected one: each drives its own "
                "plant; simulate them one at a time."
            )
        if isfinite(cell.scenario.sampling.processor_speed) and len(cell.options) > 1:
            raise UserError(
                f"{study.name}: got {len(cell.options)} observers with a processor_speed, expected one: each uses the samples "
                "that its own processor has time for; simulate them one at a time."
            )
        (p,) = (alone(point, study.root_seed, seed) for point in padding.fit(list(drafts([cell]))))
        import pandas as pd

        from pcbench.simulation import trajectory

        out = trajectory.jit_record()(p.layout, p.problem, np.asarray(study.root_seed), np.asarray(seed))
        out = jax.tree.map(np.asarray, out)
        digits.require_of_trace(p, out.x, [out.estimates[key] for key, _ in p.layout.observers])
        samples = samples_of(p.cell, (study.root_seed, seed)) if log is not None else []
    signal_names = [name for name, _ in signals_of(p.cell.scenario)]
    signals, error_names = signal_names[: out.x.shape[1]], signal_names[out.x.shape[1] :]
    if log is not None:
        tables = run_as_log.tables_of(samples, p.problem.schedule, out, p.cell.scenario.dt, signals)
        for name, table in tables.items():
            single_table.write_table(Path(log) / f"{name}.parquet", table)
    columns = {"t": np.arange(len(out.x)) * p.cell.scenario.dt}
    columns |= {signal: out.x[:, i] for i, signal in enumerate(signals)}
    keys = {name: key for name, (key, _) in zip(p.labels, p.layout.observers, strict=True)}
    for name, key in keys.items():
        columns |= {f"{name}.{signals[i]}": column for i, column in enumerate(out.estimates[key].T)}
    for name, key in keys.items():
        errors = out.errors.get(key, np.zeros((0, 0))).T
        columns |= {f"{name}.{signal}": column for signal, column in zip(error_names, errors, strict=False)}
    for name, key in keys.items():
        sigma = out.sigma.get(key, np.zeros((0, 0))).T
        columns |= {f"{name}.{signals[i]}.sigma": column for i, column in enumerate(sigma)}
    for name, key in keys.items():
        for i, ends in enumerate(out.bounds[key].T if key in out.bounds else ()):
            columns |= {f"{name}.{signals[i]}.low": ends[0], f"{name}.{signals[i]}.high": ends[1]}
    columns |= {f"target.{signals[i]}": column for i, column in enumerate(out.target.T)}
    columns |= {f"u{i + 1}": u for i, u in enumerate(out.u.T)}
    columns |= {f"y{i + 1}": y for i, y in enumerate(_forward_fill(out.newest).T)}
    frame = pd.DataFrame(columns)
    input_units = units(p.cell.scenario.loop.input, out.u.shape[1])
    frame.attrs["excluded"] = study.excluded or {}  # reasons for observers of "all" that are missing
    frame.attrs["input_units"] = {f"u{i + 1}": unit for i, unit in enumerate(input_units)}
    frame.attrs["output_units"] = {f"y{i + 1}": unit for i, unit in enumerate(output_units(p.cell.scenario))}
    frame.attrs["predicts_unknown_input"] = dict(p.predicts_unknown_input)  # by observer
    frame.attrs["certified"] = {o: is_certified(c._asdict()) for o, c in p.certificates.items()}
    return frame


def operation_counts(
    study: StudyLike, *, observers: str | Sequence[str] | None = None, overrides: list[str] | None = None
) -> "pd.DataFrame":
    """Count the multiplications and the memory of observers.

    Args:
        study: as in `run`.
        observers: names of observers. Default: the study's.
        overrides: changes of the study as texts.

    Returns:
        A frame with one row per grid point and observer: `sample` and `tick` are multiplications per measurement and per
        tick of one run, `memory` is bytes kept from tick to tick (see `planning/operation_counts`). With a `processor_speed`
        also `computing_time` [s] of a measurement (inf: too long for a run), and `stride`: one measurement in how many is used.

    Raises:
        UserError: a mistake in the study or an argument, in one sentence.
    """
    import pandas as pd

    with config.float64():
        names = [observers] if isinstance(observers, str) else observers
        grid = all_observers.grid_of(study, {} if names is None else {"observers": list(names)}, overrides or [])
        limited = any(isfinite(cell.scenario.sampling.processor_speed) for cell in grid.cells)
        rows = [
            {
                "scenario": p.cell.scenario.name,
                "cell": p.cell.number,
                **p.cell.values,
                "observer": label,
                **count._asdict(),
                **(dict(zip(("computing_time", "stride"), processor.times_in(p.cell), strict=True)) if limited else {}),
            }
            for p in drafts(grid.cells)
            for label, count in counts.costs(p).items()
        ]
    table = pd.DataFrame(rows)
    table.attrs["excluded"] = grid.study.excluded or {}  # reasons for observers of "all" that are missing
    return table


def _forward_fill(arrived: np.ndarray) -> np.ndarray:
    """Return the last arrival of each channel at every tick, [N+1, q], from the arrivals at each; NaN before the first."""
    last = np.maximum.accumulate(np.where(np.isnan(arrived), -1, np.arange(len(arrived))[:, None]))
    return np.where(last >= 0, np.take_along_axis(arrived, np.maximum(last, 0), 0), np.nan)


def design(
    scenario: StudyLike, observer: str, *, gain: str | None = None, overrides: list[str] | None = None
) -> Design:
    """Compute an observer's gains in a scenario, with their certificate.

    Args:
        scenario: a scenario's name, or a study with one scenario and one grid point.
        observer: name of the observer.
        gain: how gains are computed, as in `pcbench design --gain`. Default: the study's.
        overrides: changes of the study as texts.

    Returns:
        The gains, and the certificate: inequality, margin, solver, whether it was a fallback, and the guaranteed decay rate
        [1/s].

    Raises:
        UserError: a mistake in the study or an argument, in one sentence.
        DesignError: the gains are not certified; the sentence has the margin.
    """
    with config.float64():
        from pcbench.gains.design import design as design_in_study

        return design_in_study(scenario, observer, gain=gain, overrides=overrides)[2]


# arguments for simulated runs only
SIMULATION_ONLY = ("objective", "signal", "optimizer", "exact_objective", "training_seeds", "validation_seeds")


def tune(
    scenario: StudyLike,
    observer: str,
    *,
    log: str | Path | None = None,
    delay: float | None = None,
    start: float | None = None,
    **how: Any,
) -> "Tuning | LogTuning":
    """Tune an observer's free parameters on simulated runs, or its noise intensities on a recording.

    Args:
        scenario: a scenario's name, or a study with one scenario and one grid point.
        observer: name of the observer.
        log: a recording (see `replay`). Default: simulated runs.
        delay: delay of every measurement [s], for a recording without arrival times.
        start: time of tick 0 in the recording [s]. Default: its first time.
        **how: budget, only, out, overrides and progress; with a recording also find_delay (True: find the delay of each
            channel first) and max_delay [s]; without one objective, signal, optimizer, exact_objective, training_seeds and
            validation_seeds. See `gains.tune.tune` and `playback.tuning.tune_log`.

    Returns:
        The tuned options, and what they reach on seeds, or on a part of the recording, that were not used for tuning.

    Raises:
        UserError: a mistake in the study, the recording or an argument, in one sentence.
    """
    if log is None:
        if delay is not None or start is not None:
            raise UserError(
                f"{'start' if delay is None else 'delay'} has no effect without log; give log, or leave it out."
            )
        from pcbench.gains.tune import tune as on_runs

        return on_runs(scenario, observer, **how)
    if names := [name for name in SIMULATION_ONLY if name in how]:
        raise UserError(f"{names[0]} has no effect with log; leave {' and '.join(names)} out, or log.")
    from pcbench.playback.tuning import tune_log

    return tune_log(log, scenario, observer, delay=delay, start=start, **how)
