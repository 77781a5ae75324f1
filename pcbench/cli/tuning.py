"""Commands that compute gains: `design`, with a certificate, and `tune`."""

import json
from pathlib import Path
from typing import Annotated

from pcbench import toml_text
from pcbench.cli.options import Json, Late, Observer, Quiet, Scenario, Set, Signal
from pcbench.cli.shared import console, names, option, out, require_effect, setup, show_progress
from pcbench.dataset.seed_ranges import Seeds
from pcbench.errors import UserError
from pcbench.toml_text import TomlTable

SeedRange = Annotated[str | None, option("Range of seeds, without its end", metavar="FIRST:END")]


def design(
    scenario: Scenario,
    observer: Observer,
    gain: Annotated[
        str | None, option("Method that computes the gains, such as h2 for pccebo [default: the study's]")
    ] = None,
    sweep: Annotated[
        str | None, option("Option and values for a trade-off: one design per value", metavar="OPTION=A,B,...")
    ] = None,
    file: Annotated[str | None, out("Study file to write (TOML); for a trade-off a .parquet or .csv file")] = None,
    changes: Set = None,
    as_json: Json = False,
) -> None:
    """Compute an observer's gains and their certificate: the inequality, its margin, the solver and the guaranteed decay rate.

    Example: pcbench design cart/gaussian pccebo --gain h2 --sweep decay=0.2,0.5,1,2
    """
    setup()
    import pyarrow as pa

    from pcbench.cli.render import gains
    from pcbench.cli.render.tables import to_json
    from pcbench.dataset import single_table, storage
    from pcbench.gains import design
    from pcbench.runtime import config
    from pcbench.synthesis.certificate import is_certified

    if sweep is not None:
        if file is not None:
            single_table.kind_of(file)
        table = design.trade_off(scenario, observer, *_values(sweep), gain=gain, overrides=changes)
        if file is not None:
            single_table.write_table(file, pa.Table.from_pandas(table, preserve_index=False))
        if as_json:
            print(to_json(table.to_dict("records")))
        else:
            gains.trade_off(f"{observer} in {scenario}", table, console())
        return
    if file is not None:
        _require_writable(Path(file))
    with config.float64():
        study, cell, result = design.design(scenario, observer, gain=gain, overrides=changes)
        text = design.to_toml(design.as_study(study, cell, observer, result)) if file is not None else ""
    if file is not None:
        target = storage.target(Path(file).parent)
        storage.create_folder(target)
        storage.write_file(target, Path(file).name, text.encode())
    if as_json:
        fields = result.certificate._asdict()
        print(to_json({"scenario": scenario, "observer": observer, "certified": is_certified(fields)} | fields))
    else:
        screen = console()
        screen.print(f"{observer} in {scenario}", style="bold")
        gains.gains(result, screen)
        if file is not None:
            screen.say(f"Run it: pcbench run {file}")


def _require_writable(out: Path) -> None:
    """Raise UserError if the file exists and is not the output of a design."""
    try:
        text = out.read_text(encoding="utf-8") if out.is_file() else "[resolved.certificate]"
    except (OSError, ValueError):
        text = ""
    if "[resolved.certificate]" not in text:
        raise UserError(f"--out {out}: this file exists and is no design, expected a new file; give another name.")


def _values(text: str) -> tuple[str, list[object]]:
    """Return the option and the values of OPTION=A,B,...; values are TOML, or plain words."""
    name, equals, listing = text.partition("=")
    if not equals or not name.strip() or not listing.strip():
        raise UserError(f"--sweep: got '{text}', expected OPTION=A,B,... such as decay=0.2,0.5,1.")
    try:
        values = toml_text.parse(f"values = [{listing}]")["values"]
    except ValueError:
        values = [v.strip() for v in listing.split(",")]
    return name.strip(), values


def tune(
    scenario: Scenario,
    observer: Observer,
    budget: Annotated[int | None, option("Number of simulations of all training runs [default: 60]")] = None,
    objective: Annotated[
        str | None, option("Metric to minimise [default: rmse; with --exact-objective: pooled_rmse]")
    ] = None,
    signal: Signal = None,
    optimizer: Annotated[
        str | None, option("Optimizer: descent (with gradients) or search [default: descent, if it is possible]")
    ] = None,
    exact_objective: Annotated[
        bool,
        option("Use the expected value over all noise, without training and validation seeds", "--exact-objective"),
    ] = False,
    only: Annotated[str | None, option("Comma-separated options to tune [default: all tunable ones]")] = None,
    training_seeds: SeedRange = None,
    validation_seeds: SeedRange = None,
    log: Annotated[
        str | None, option("Recording: tune noise intensities by its likelihood, and test them on its last part")
    ] = None,
    delay: Late = None,
    find_delay: Annotated[
        bool, option("Find the delay of each channel of the recording too, with a 95 % interval", "--find-delay")
    ] = False,
    max_delay: Annotated[
        float | None, option("Longest delay to search [s] [default: ten sampling intervals of the slowest channel]")
    ] = None,
    changes: Set = None,
    folder: Annotated[
        str | None,
        out(
            "Folder for tuned.toml, the history and, with --find-delay, recording.toml and delay.png; the same command "
            "continues a stopped tuning"
        ),
    ] = None,
    quiet: Quiet = False,
    as_json: Json = False,
) -> None:
    """Tune an observer's free parameters on some seeds, and test them on others.

    With --log, tune its noise intensities on a recording. With --find-delay, find the delays of its channels too.

    Examples: pcbench tune cart/white pccebo --out tuned;  pcbench tune motor.toml kf --log flight --find-delay --out tuned
    """
    setup()
    from pcbench.cli.render import gains
    from pcbench.cli.render.tables import to_json
    from pcbench.gains import history, tune

    run_options = {
        "--objective": objective,
        "--signal": signal,
        "--optimizer": optimizer,
        "--training-seeds": training_seeds,
        "--validation-seeds": validation_seeds,
        "--exact-objective": exact_objective or None,
    }
    if log is not None and (conflicts := [name for name, value in run_options.items() if value is not None]):
        raise UserError(
            f"{conflicts[0]} has no effect with --log: the objective on a recording is its likelihood; leave "
            f"{' and '.join(conflicts)} out, or --log."
        )
    if log is None:
        log_options = {"--delay": delay, "--find-delay": find_delay, "--max-delay": max_delay}
        require_effect(log_options, "without --log", "leave it out, or give --log")
    options: TomlTable = {"budget": tune.BUDGET if budget is None else budget, "out": folder, "overrides": changes}
    options["only"] = None if only is None else names(only)
    with show_progress(quiet or as_json, "designing gains") as options["progress"]:
        if log is not None:
            from pcbench.playback.tuning import tune_log

            log_tuning = tune_log(
                log, scenario, observer, delay=delay, find_delay=find_delay, max_delay=max_delay, **options
            )
        else:
            tuning = tune.tune(
                scenario,
                observer,
                objective=objective,
                signal=signal,
                optimizer=optimizer,
                exact_objective=exact_objective,
                training_seeds=_seeds(training_seeds, "--training-seeds", tune.TRAINING),
                validation_seeds=_seeds(validation_seeds, "--validation-seeds", tune.VALIDATION),
                **options,
            )
    if log is not None:
        if log_tuning.delays and folder is not None:
            from pcbench.plots import delay_profiles, save

            save(delay_profiles(log_tuning.delays), str(Path(folder) / "delay.png"))
        if as_json:
            fields = {name: value for name, value in log_tuning._asdict().items() if name not in ("study", "delays")}
            fields |= {"delay": {d.channel: d._asdict() for d in log_tuning.delays}} if find_delay else {}
            fields["intensities"] = [i._asdict() for i in log_tuning.intensities]
            print(to_json(fields | {"points": len(log_tuning.points), "method": "likelihood"}))
        elif not quiet:
            gains.tuned_on_log(log_tuning, observer, log, folder, console())
    elif as_json:
        summary: TomlTable = {"start": tuning.start, "best": tuning.best, "kept_start": tuning.kept_start}
        goal = {"metric": tuning.objective.metric, "signal": tuning.objective.name, "unit": tuning.objective.unit}
        summary |= {"goal": goal, "certified": tuning.certified, "exact": tuning.exact}
        summary |= {"judgements": [history.as_record(j) for j in tuning.judgements]}
        print(json.dumps(summary | {"points": len(tuning.points), "method": tuning.method}, indent=2))
    elif not quiet:
        gains.print_tuning(tuning, observer, folder, console())


def _seeds(text: str | None, where: str, default: Seeds) -> Seeds:
    """Return the seeds of FIRST:END."""
    if text is None:
        return default
    first, colon, end = text.partition(":")
    if not (colon and first.strip().isdecimal() and end.strip().isdecimal() and int(first) < int(end)):
        raise UserError(f"{where}: got '{text}', expected FIRST:END such as 0:256; write that.")
    return Seeds(int(first), int(end))
