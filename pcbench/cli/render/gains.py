"""Tables and sentences for `design`, `tune` and `check`."""

from typing import TYPE_CHECKING

import numpy as np
import pandas as pd
from rich.text import Text

from pcbench.checking.targets import Finding
from pcbench.cli.render.tables import Column, Screen, mean
from pcbench.statistics.number_format import UNPROVEN, mark_uncertified
from pcbench.study.labels import label_of
from pcbench.synthesis.certificate import Design, is_certified
from pcbench.toml_text import TomlTable

if TYPE_CHECKING:
    from pcbench.gains.tune import Tuning
    from pcbench.playback.tuning import LogTuning

VARIANCES = ("R", "Q")  # options whose root is a standard deviation


def gains(design: Design, screen: Screen) -> None:
    """Print a certificate and the main numbers of a design."""
    c = design.certificate
    solution = f"\nmargin {c.margin:.6g}, solver {c.solver}, status {c.status}" if np.isfinite(c.margin) else ""
    screen.print(f"certificate: {c.inequality}{solution}", highlight=True)
    if is_certified(c._asdict()) is False:
        screen.print(f"{UNPROVEN.removeprefix('* ')} these gains.", style="bold", highlight=True)
    if c.fallback:
        screen.print(f"fallback: {c.fallback}", highlight=True)
    rate = f"{c.rate:.6g} 1/s or faster" if np.isfinite(c.rate) else "not guaranteed"
    screen.print(f"decay rate of the errors: {rate}", highlight=True)
    for name, value in c.numbers.items():
        width = max(screen.width - len(name) - 3, 20)
        body = np.array2string(np.asarray(value), width, precision=12, separator=", ", suppress_small=False)
        screen.print(f"{name} =\n{body}" if "\n" in body else f"{name} = {body}", highlight=True)


def trade_off(title: str, table: pd.DataFrame, screen: Screen) -> None:
    """Print a trade-off: the option, the guaranteed rate, and the other numbers that change."""
    option = table.columns[0]
    fixed = [option, "rate", "margin", "solver"]  # columns that are always printed
    varying = [c for c in table.columns if c not in (*fixed, "fallback", "refused") and table[c].nunique() > 1]
    heads = [head + (" [1/s]" if head == "rate" else "") for head in (*fixed, *varying)]
    designs = table[table.refused == ""]
    values = [[f"{v:.4g}" if isinstance(v, float) else str(v) for v in designs[name]] for name in (*fixed, *varying)]
    columns = [Column(head, cells, is_text=head == option) for head, cells in zip(heads, values, strict=True)]
    screen.fit(mark_uncertified(title, table.certified), columns)
    if len(designs) > 1 and not varying and designs.rate.nunique() <= 1:
        screen.print(f"{option} has no effect here: these gains do not depend on it; use another --gain.")
    screen.say_unproven(table.certified)
    for row in table[table.refused != ""].to_dict("records"):
        screen.print(f"{option} = {row[option]}: {row['refused']}")
    for row in designs[designs.fallback != ""].to_dict("records"):
        screen.print(f"{option} = {row[option]}, fallback: {row['fallback']}")


def print_tuning(tuning: "Tuning", observer: str, folder: str | None, screen: Screen) -> None:
    """Print a tuning: start and tuned options with their metric on training and validation seeds."""
    objective, validations, of_runs = tuning.objective, tuning.judgements, not tuning.exact
    columns = [Column("seeds", [str(j.seeds) for j in validations], is_text=True)] if of_runs else []
    columns += [
        Column("", [j.what for j in validations], is_text=True),
        Column("start", [mean(j.start, j.start_se) for j in validations]),
        Column("tuned", [mean(j.tuned, j.tuned_se) for j in validations]),
        Column("tuned - start", [mean(j.difference, j.difference_se, "+") for j in validations]),
    ]
    if of_runs:
        columns.append(Column("diverged", [f"{j.diverged[0]} -> {j.diverged[1]}" for j in validations], spare=1))
    quantity = ("" if of_runs else "expected ") + (
        "mean square" if objective.metric != objective.base else objective.metric
    )
    name, points = mark_uncertified(observer, [tuning.certified]), f"{len(tuning.points)} points by {tuning.method}"
    screen.fit(f"{name}: {quantity} of {objective.name}, {points}", columns)
    screen.say_unproven([tuning.certified])
    for name, value in tuning.best.items():
        screen.print(f"{name} = {_option(value)}   (start: {_option(tuning.start[name])})")
    if tuning.kept_start:
        screen.print(f"The start is kept: {tuning.kept_start}.")
    if folder is not None:
        rival = "model-only" if observer == "kf" else "kf"
        label = label_of(observer)
        screen.say(
            f"Compare it: pcbench run {folder}/tuned.toml --observers {label},{rival} --out results/{label}-tuned"
        )


def _option(value: object) -> str:
    return "[" + ", ".join(map(_option, value)) + "]" if isinstance(value, list | tuple) else f"{value:.6g}"


def tuned_on_log(tuning: "LogTuning", observer: str, log: str, folder: str | None, screen: Screen) -> None:
    """Print the delays, the tuned intensities, and compare start and tuned on the held-out part."""
    if tuning.delays:
        columns = [
            Column("channel", [d.channel for d in tuning.delays], is_text=True),
            Column("delay [s]", [f"{d.estimate:.4g}" for d in tuning.delays]),
            Column("95 % interval", [f"{d.low:.4g} to {d.high:.4g}" for d in tuning.delays]),
            Column("searched", [f"{d.search_range[0]:.4g} to {d.search_range[1]:.4g}" for d in tuning.delays], spare=1),
        ]
        screen.fit("delay: time from the physical instant of a measurement to its recorded timestamp", columns)
    rows, scores = tuning.intensities, tuning.held_out.values()
    ends = [f"{i.low:.4g} to {i.high:.4g}" if i.low else f"below {i.high:.4g}" for i in rows]
    roots = [f"{i.value**0.5:.4g}" if i.name.partition("[")[0] in VARIANCES else "-" for i in rows]
    columns = [
        Column("intensity", [i.name for i in rows], is_text=True),
        Column("start", [f"{i.start:.4g}" for i in rows]),
        Column("tuned", [f"{i.value:.4g}" for i in rows]),
        Column("95 % interval", ["-" if np.isnan(i.low) else end for i, end in zip(rows, ends, strict=True)]),
        Column("root", roots, spare=1),
    ]
    screen.fit(f"{observer}: maximum likelihood on {log}, {len(tuning.points)} points by descent", columns)
    columns = [
        Column("held out", list(tuning.held_out), is_text=True),
        Column("log-likelihood\nper value", [f"{s['log_likelihood']:.4g}" for s in scores]),
        Column("NIS", [f"{s['nis']:.3f}" for s in scores]),
        Column("verdict", [str(s["verdict"]) for s in scores], is_text=True),
        Column("ljung_box_p", [f"{s['ljung_box_p']:.3g}" for s in scores]),
    ]
    samples = tuning.held_out["tuned"]["samples"]
    screen.fit(f"test on the last part ({samples} samples), after tuning on the first part only", columns)
    screen.say(f"tuned - start: {tuning.gain:+.4g} (standard error {tuning.gain_se:.2g}).", *tuning.notes)
    if tuning.kept_start:
        screen.say(f"The start is kept: {tuning.kept_start}.")
    if folder is not None:
        plant, log = f"{folder}/tuned.toml", f"{folder}/recording.toml" if tuning.delays else log
        screen.say(f"Replay it: pcbench replay {log} --plant {plant} --observers {observer} --out replayed")


def fair(table: pd.DataFrame, screen: Screen) -> None:
    """Print the metric with published, designed and tuned gains on training and held-out runs, and against the Kalman bound."""
    rows: list[TomlTable] = table.to_dict("records")  # type: ignore[assignment]
    of_runs = bool(table.training_se.any())  # expected values have no error
    title = "{scenario}: {metric} of {signal} [{unit}], ".format(**rows[0])
    title += "training and held-out runs" if of_runs else "expected value and runs"
    bound = ["-" if np.isnan(r["rms_efficiency"]) else f"{100 * r['rms_efficiency']:.1f} %" for r in rows]
    training = [mean(r["training"], r["training_se"]) for r in rows]
    columns = [Column("grid point", [str(r["cell"]) for r in rows])] if table.cell.nunique() > 1 else []
    columns += [
        Column("observer", [mark_uncertified(r["observer"], [r["certified"]]) for r in rows], is_text=True),
        Column("gains", [r["tuning"] for r in rows], is_text=True),
        Column("held out", [mean(r["held_out"], r["held_out_se"]) for r in rows]),
        Column("rms\nefficiency", bound),
        Column("training" if of_runs else "expected", training, spare=2),
        Column("gap", [mean(r["gap"], r["gap_se"], "+") for r in rows], spare=1),
    ]
    if table.diverged.any():
        columns.append(Column("diverged", [str(r["diverged"]) for r in rows]))
    screen.fit(title, columns)
    screen.say_unproven(table.certified)
    for label, note in dict.fromkeys((row["label"], row["note"]) for row in rows if row["note"]):
        screen.print(f"{label}: the start is kept: {note}.")


def print_findings(title: str, findings: list[Finding], screen: Screen) -> None:
    """Print every check with its verdict and the reason."""
    colours = {"passes": "green", "fails": "red"}
    verdicts = [Text(f.verdict, colours.get(f.verdict, "yellow")) for f in findings]
    checks, reasons = ([getattr(f, name) for f in findings] for name in ("check", "why"))
    columns = [Column("check", checks, is_text=True), Column("verdict", verdicts, is_text=True)]
    screen.fit(title, [*columns, Column("reason", reasons, prose=True)])
