"""Gains with what proves them, what a faster decay costs, what a tuning found, and what the checks of a user's own say."""

from collections.abc import Iterable
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from rich.console import Console
from rich.text import Text

from pcbench.checking.targets import Finding
from pcbench.cli.render.tables import Column, printed, titled
from pcbench.statistics.number_format import UNPROVEN, estimate, marked
from pcbench.synthesis.certificate import Design, is_certified


def gains(design: Design, console: Console) -> None:
    """Print a certificate and the numbers worth showing."""
    c = design.certificate
    console.print(
        f"certificate: {c.inequality}\nmargin {c.margin:.6g}, solver {c.solver}, status {c.status}", markup=False
    )
    if is_certified(c._asdict()) is False:
        console.print(f"{UNPROVEN.removeprefix('* ')} these gains.", style="bold")
    if c.fallback:
        console.print(f"a fallback: {c.fallback}", markup=False)
    promise = f"at {c.rate:.6g} per second or faster" if np.isfinite(c.rate) else "at no rate that is promised"
    console.print(f"errors decay {promise}", markup=False)
    for name, value in c.numbers.items():
        body = np.array2string(np.asarray(value), precision=12, separator=", ", suppress_small=False)
        console.print(f"{name} =\n{body}" if "\n" in body else f"{name} = {body}", markup=False)


def trade_off(title: str, table: pd.DataFrame, console: Console) -> None:
    """Print a trade-off: the option, what is promised, and the other numbers that it changes."""
    fixed = [table.columns[0], "rate", "margin", "solver"]
    moving = [c for c in table.columns if c not in (*fixed, "fallback", "refused") and table[c].nunique() > 1]
    shown = titled(marked(title, table.certified))
    for head in (*fixed, *moving):
        shown.add_column(head + (" [1/s]" if head == "rate" else ""), justify="right")
    stands = table[table.refused == ""]
    for row in stands.to_dict("records"):
        shown.add_row(*(f"{row[c]:.4g}" if isinstance(row[c], float) else str(row[c]) for c in (*fixed, *moving)))
    console.print(shown)
    if len(stands) > 1 and not moving and stands.rate.nunique() <= 1:
        text = f"{fixed[0]} changes nothing here: the gains are not found from it; name a --gain that does."
        console.print(text, highlight=False)
    _say_what_is_unproven(table.certified, console)
    for row in table[table.refused != ""].to_dict("records"):
        console.print(f"{fixed[0]} = {row[fixed[0]]}: {row['refused']}", highlight=False, markup=False)
    for row in stands[stands.fallback != ""].to_dict("records"):
        console.print(f"{fixed[0]} = {row[fixed[0]]}, a fallback: {row['fallback']}", highlight=False, markup=False)


def arrow(table: pd.DataFrame) -> pa.Table:
    """Return a frame as it is put into a file."""
    return pa.Table.from_pandas(table, preserve_index=False)


def tuned(found: Any, observer: str, folder: str | None, console: Console) -> None:
    """Print what a tuning found: start against tuned on training and judging seeds, and the options."""
    aim = found.objective
    what = "mean square" if aim.metric != aim.base else aim.metric
    judged, of_runs = found.judged, not found.exact
    columns = [Column("seeds", [str(j.seeds) for j in judged], left=True)] if of_runs else []
    columns += [
        Column("", [j.what for j in judged], left=True),
        Column("start", [_mean(j.start, j.start_se) for j in judged]),
        Column("tuned", [_mean(j.tuned, j.tuned_se) for j in judged]),
        Column("tuned - start", [_mean(j.difference, j.difference_se, "+") for j in judged]),
    ]
    if of_runs:
        columns.append(Column("diverged", [f"{j.diverged[0]} -> {j.diverged[1]}" for j in judged], spare=1))
    name, what = marked(observer, [found.certified]), what if of_runs else f"expected {what}"
    printed(f"{name}: {what} of {aim.name}, {len(found.points)} points by {found.method}", columns, console)
    _say_what_is_unproven([found.certified], console)
    for name, value in found.found.items():
        console.print(f"{name} = {_short(value)}   (start: {_short(found.start[name])})", highlight=False, markup=False)
    if found.kept_start:
        console.print(f"The start is kept: {found.kept_start}.", highlight=False)
    if folder is not None:
        console.print(f"Now run it: pcbench run {folder}/tuned.toml", highlight=False, markup=False, soft_wrap=True)


def fair(table: pd.DataFrame, console: Console) -> None:
    """Print what gains as printed, by design and tuned are worth, on training runs and on others, and against the bound."""
    rows: list[dict[str, Any]] = table.to_dict("records")  # type: ignore[assignment]
    of_runs = bool(table.training_se.any())  # or expected values, which have no error
    title = "{scenario}: {metric} of {signal} [{unit}], ".format(**rows[0])
    title += "on training runs and on others" if of_runs else "as expected, and on runs"
    columns = [Column("cell", [str(r["cell"]) for r in rows])] if table.cell.nunique() > 1 else []
    columns += [
        Column("observer", [marked(r["observer"], [r["certified"]]) for r in rows], left=True),
        Column("gains", [r["tuning"] for r in rows], left=True),
    ]
    columns += [
        Column("held out", [_mean(r["held_out"], r["held_out_se"]) for r in rows]),
        Column("of the bound\n(tail)", [_share(r["rms_efficiency"]) for r in rows]),
        Column("training" if of_runs else "expected", [_mean(r["training"], r["training_se"]) for r in rows], spare=2),
        Column("gap", [_mean(r["gap"], r["gap_se"], "+") for r in rows], spare=1),
    ]
    if table.diverged.any():
        columns.append(Column("diverged", [str(r["diverged"]) for r in rows]))
    if left_out := printed(title, columns, console):
        console.print(f"Left out for want of room: {', '.join(left_out)}.", highlight=False)
    _say_what_is_unproven(table.certified, console)
    for label, note in dict.fromkeys((row["label"], row["note"]) for row in rows if row["note"]):
        console.print(f"{label}: the start is kept: {note}.", highlight=False)


def _say_what_is_unproven(certified: Iterable[Any], console: Console) -> None:
    """Say what the mark behind a name means, where one stands."""
    if marked("", certified):
        console.print(f"{UNPROVEN} its gains.", highlight=False)


def _mean(value: float, se: float, sign: str = "") -> str:
    """A mean with two standard errors."""
    return estimate(value, value - 2 * se, value + 2 * se, sign)


def _share(value: float) -> str:
    return f"{100 * value:.1f} %" if value == value else "-"


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "[" + ", ".join(map(_short, value)) + "]"


def checked(title: str, findings: list[Finding], console: Console) -> None:
    """Print every check with its verdict and why."""
    table = titled(title)
    for head in ("check", "verdict", "why"):
        table.add_column(head, overflow="fold", no_wrap=head != "why")
    for found in findings:
        colour = {"passes": "green", "fails": "red"}.get(found.verdict, "yellow")
        table.add_row(found.check, Text(found.verdict, colour), found.why)
    console.print(table)
