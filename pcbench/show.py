"""What a person reads in the terminal: tables of results, gains and claims, and the progress of long work."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.table import Table
from rich.text import Text

from pcbench.scenarios import Scenario
from pcbench.study import scenarios_of

ROUNDING = 1e-11
LONGEST = 48  # rows of a closing table; beyond, who wins is counted instead


class Rate(ProgressColumn):
    """Runs a second."""

    def render(self, task: Any) -> Text:
        """Show the task's speed in runs a second."""
        return Text(f"{task.speed:,.0f} runs/s" if task.speed else "", style="progress.data.speed")


@contextmanager
def progress(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` for `bench.run` that draws a bar with rate and time left on standard error."""
    if quiet:
        yield lambda event, value: None
        return
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("designing gains", total=None)

        def tell(event: str, value: float) -> None:
            if event == "planned":
                bar.update(task, total=(bar.tasks[0].total or 0) + value, description="compiling")
            elif event == "runs":
                bar.update(task, advance=value, description="simulating")
            elif event == "closing":
                bar.update(task, description="statistics")
            elif event.startswith(("tuning", "comparing")):
                bar.update(task, description=event)

        yield tell


@contextmanager
def counting(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` that draws a bar for files and blocks: an event with its number begins one, `...ed` goes on."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        current: list[Any] = []

        def tell(event: str, value: float) -> None:
            if event in ("checked", "compared", "merged", "reproduced"):
                bar.advance(current[-1], value)
            else:
                current.append(bar.add_task(event, total=value or None))

        yield tell


@contextmanager
def tuning(quiet: bool) -> Iterator[Any]:
    """Yield a `tell` for a tuning: a bar over its budget with the least objective so far, on standard error."""
    columns = [TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn()]
    console = Console(stderr=True)
    with Progress(*columns, console=console, transient=True, disable=quiet or not console.is_terminal) as bar:
        task = bar.add_task("designing gains", total=None)

        def tell(event: str, value: float) -> None:
            if event == "begin":
                bar.update(task, total=value, description="compiling")
            elif event == "point":
                bar.update(task, advance=1, description=f"least so far {value:.5g}")
            elif event == "judging":
                bar.update(task, description="judging on other seeds")

        yield tell


def tuned(found: Any, observer: str, folder: str | None, console: Console) -> None:
    """Print what a tuning found: start against tuned on training and judging seeds, and the options."""
    aim = found.goal
    what = "mean square" if aim.metric != aim.base else aim.metric
    table = titled(f"{observer}: {what} of {aim.name}, {len(found.points)} points by {found.method}")
    for head in ("seeds", "", "start", "tuned", "tuned - start", "diverged"):
        table.add_column(head, justify="left" if head in ("seeds", "") else "right")
    for j in found.judged:
        each = [f"{m:.4g} ± {2 * se:.2g}" for m, se in ((j.start, j.start_se), (j.tuned, j.tuned_se))]
        gap = f"{j.difference:+.3g} ± {2 * j.difference_se:.2g}"
        table.add_row(f"{j.first}:{j.first + j.seeds}", j.what, *each, gap, f"{j.diverged[0]} -> {j.diverged[1]}")
    console.print(table)
    for name, value in found.found.items():
        console.print(f"{name} = {_short(value)}   (start: {_short(found.start[name])})", highlight=False, markup=False)
    if found.kept_start:
        console.print(f"The start is kept: {found.kept_start}.", highlight=False)
    if folder is not None:
        console.print(f"{folder}/tuned.toml can be run: pcbench run {folder}/tuned.toml", highlight=False)


def fair(table: pd.DataFrame, console: Console) -> None:
    """Print what gains as printed, by design and tuned are worth, on training runs and on others, and against the bound."""
    rows: list[dict[str, Any]] = table.to_dict("records")  # type: ignore[assignment]
    title = "{scenario}: {metric} of {signal} [{unit}], on training runs and on others".format(**rows[0])
    cells = ["cell"] if table.cell.nunique() > 1 else []
    shown = titled(title)
    for head in (*cells, "observer", "gains", "training", "held out", "gap", "diverged", "tail rms: of the bound"):
        shown.add_column(head, justify="left" if head in ("observer", "gains") else "right")
    for row in rows:
        means = [f"{row[m]:.4g} ± {2 * row[m + '_se']:.2g}" for m in ("training", "held_out")]
        share = f"{100 * row['efficiency']:.1f} %" if row["efficiency"] == row["efficiency"] else "-"
        gap = f"{row['gap']:+.2g} ± {2 * row['gap_se']:.1g}"
        shown.add_row(*(str(row[c]) for c in (*cells, "observer", "tuning")), *means, gap, str(row["diverged"]), share)
    console.print(shown)
    for label, note in dict.fromkeys((row["label"], row["note"]) for row in rows if row["note"]):
        console.print(f"{label}: the start is kept: {note}.", highlight=False)


def _short(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "[" + ", ".join(map(_short, value)) + "]"


def effort(result: Any, folder: str) -> str:
    """Return what a run took, in a sentence."""
    p = result.provenance
    if not result.effort.runs:
        return f"Nothing was left to do: {p['blocks']} blocks in {folder}."
    took = f"{p['wall_seconds']:.1f} s ({p['compile_seconds']:.1f} s compiling, {p['writing_seconds']:.1f} s writing)"
    return f"{p['runs_added']:,} runs added; {p['blocks']} blocks and their statistics in {folder} after {took}."


def status(found: Any, folder: str, console: Console) -> None:
    """Print how far a study is."""
    table = titled(f"{found.study} in {folder}: {found.bytes / 1e6:,.1f} MB")
    for head in ("scenario", "observer", "cells", "blocks", "runs", "of", "done"):
        table.add_column(head, justify="left" if head in ("scenario", "observer") else "right")
    for s in found.shares:
        share = f"{100 * min(s.seeds / s.wanted, 1):.3g} %" if s.wanted else "-"
        table.add_row(s.scenario, s.observer, str(s.cells), str(s.blocks), f"{s.seeds:,}", f"{s.wanted:,}", share)
    console.print(table)
    for what, names in (("damaged", found.damaged), ("doubled", found.doubled), ("unfinished", found.unfinished)):
        for name in names:
            console.print(f"{what}: {name}", highlight=False, markup=False)
    behind = any(s.seeds < s.wanted for s in found.shares) or found.damaged or found.doubled
    end = "Every run is there, with its statistics." if found.closed and not behind else "Run the study again to go on."
    console.print(end, highlight=False)


def verdict(found: Any, folder: str, console: Console) -> None:
    """Print what a verification found."""
    for sentence in [*found.wrong, *found.differing]:
        console.print(sentence, highlight=False, markup=False)
    whole = f"all {found.files} blocks are whole"
    files = f"{found.files} blocks, {len(found.wrong)} complaints" if found.wrong else whole
    many = len(found.recomputed)
    again = (
        f"{many - len(found.differing)} of {many} came out again, bit for bit" if many else "none was computed again"
    )
    console.print(f"{folder}: {files}; {again}.", highlight=False)


def closing(result: Any, console: Console, metric: str = "mae") -> None:
    """Print who was better and how surely: the headline signals of every scenario, the least mean `metric` first."""
    stats, pairs, known = result.stats, result.pairs, scenarios_of(result.study)
    for scenario, whole in stats.groupby("scenario", sort=False):
        for signal in known[scenario].headline or whole.signal.iloc[:1]:
            part = whole[whole.signal == signal]
            if part.empty:
                continue  # no observer of this study estimates it
            mine = pairs[(pairs.scenario == scenario) & (pairs.signal == signal) & (pairs.metric == metric)]
            if part.cell.nunique() * part.observer.nunique() > LONGEST:
                _count_wins(scenario, part[part.metric == metric], metric, console)
            else:
                _scenario(known[scenario], part, mine, _varying(part), metric, console)
        _say_what_is_carried(whole, console)


def _say_what_is_carried(stats: pd.DataFrame, console: Console) -> None:
    """Say which predictions to the present carry the unknown input that was found."""
    said = stats[["observer", "carries_input"]].dropna().drop_duplicates()
    for carries, text in ((True, "carries"), (False, "does not carry")):
        names = ", ".join(dict.fromkeys(said.observer[said.carries_input == carries]))
        if names:
            console.print(f"The prediction to now {text} the unknown input found: {names}.", highlight=False)


def _varying(part: pd.DataFrame) -> list[str]:
    first = list(part.columns).index("cell") + 1
    axes = list(part.columns)[first : list(part.columns).index("signal")]
    return [a for a in axes if part[a].astype(str).nunique() > 1]


def _scenario(
    scenario: Scenario, part: pd.DataFrame, pairs: pd.DataFrame, axes: list[str], metric: str, console: Console
) -> None:
    ranked = part[part.metric == metric]
    unit, n, title = part.unit.iloc[0], int((ranked.n + ranked.diverged).max()), "MAE" if metric == "mae" else metric
    heads = [title, f"{title} - best", "RMSE", "tail RMSE"]
    bounded, lost = (part.metric == "efficiency").any(), part.diverged.any()
    jumps = (part.metric == "recovery_time").any()
    heads += [*(["efficiency"] if bounded else []), "settled [s]", *(["recovery [s]"] if jumps else [])]
    aimed = (part.metric == "tracking_rmse").any()
    heads += ["tail tracking RMSE"] if aimed else []
    heads += ["diverged"] if lost else []
    table = titled(f"{scenario.name}: error of {part.signal.iloc[0]} [{unit}], {n} seeds, 95 % intervals")
    for axis in axes:
        table.add_column(axis, justify="right")
    table.add_column("observer", no_wrap=True)
    for head in heads:
        table.add_column(escape(head), justify="right")
    for number, cell in part.groupby("cell", sort=True):
        wide = cell.set_index(["observer", "metric"])
        ranked = cell[cell.metric == metric].sort_values(["diverged", "mean"], kind="stable", na_position="last")
        order = list(ranked.observer)
        for observer in order:
            row, best = wide.loc[observer], observer == order[0]
            shown = [interval(row.loc[metric])]
            shown += ["" if best else difference(pairs[pairs.cell == number], observer, order[0])]
            shown += [interval(row.loc["pooled_rmse"]), interval(row.loc["tail_pooled_rmse"])]
            if bounded:
                shown += [interval(row.loc["efficiency"]) if "efficiency" in row.index else ""]
            shown += [settled(row.loc["settling_time"], scenario.horizon)]
            if jumps:
                shown += [interval(row.loc["recovery_time"])]
            if aimed:
                shown += [interval(row.loc["tail_tracking_rmse"])]
            if lost:
                shown += [fraction(row.loc["divergence"])]
            place = [_axis(cell[a].iloc[0]) if best else "" for a in axes]
            table.add_row(*place, f"[bold]{observer}[/bold]" if best else observer, *shown)
        table.add_section()
    console.print(table)


def _axis(value: Any) -> str:
    """A value of an axis; one for each channel with commas."""
    return ", ".join(f"{v:g}" for v in value) if isinstance(value, np.ndarray) else str(value)


def titled(title: str) -> Table:
    """Return an empty table as all of pcbench's look."""
    return Table(title=escape(title), title_justify="left", box=SIMPLE_HEAD, pad_edge=False)


def interval(row: Any) -> str:
    """An estimate with half its interval; without one where the runs are all alike; rounding of zero as 0."""
    half = (row["ci_high"] - row["ci_low"]) / 2
    if abs(row["mean"]) < ROUNDING:
        return "0"
    if not np.isfinite(half):  # one run, or an interval open to one side
        return "-" if np.isnan(row["mean"]) else f"{row['mean']:.4g} ± ?"
    return f"{row['mean']:.4g}" if not half > 1e-9 * abs(row["mean"]) else f"{row['mean']:.4g} ± {half:.2g}"


def fraction(row: Any) -> str:
    """A fraction of runs with its interval, in per cent."""
    return f"{100 * row['mean']:.3g} % ({100 * row['ci_low']:.3g} .. {100 * row['ci_high']:.3g})"


def settled(row: Any, horizon: float) -> str:
    """The median settling time; 'never' where most runs were outside their band at the end."""
    return "-" if np.isnan(row["p50"]) else "never" if row["p50"] >= horizon else f"{row['p50']:.3g}"


def difference(pairs: pd.DataFrame, observer: str, best: str) -> str:
    """The difference to the best with its interval, and '=' where it is not distinguishable."""
    forward = pairs[(pairs.observer_a == observer) & (pairs.observer_b == best)]
    backward = pairs[(pairs.observer_a == best) & (pairs.observer_b == observer)]
    if forward.empty and backward.empty:
        return "-"
    row, sign = (forward.iloc[0], 1) if len(forward) else (backward.iloc[0], -1)
    half = (row.ci_high - row.ci_low) / 2
    if np.isnan(row.mean_diff):
        return "-"
    if row.n < 2:  # one run says nothing of others
        return f"{sign * row.mean_diff:+.3g} ± ?"
    alike = row.p_holm > 0.05 or row.prob_a_better == 0.5
    text = f"{sign * row.mean_diff:+.3g}" + (f" ± {half:.2g}" if half > 1e-9 * abs(row.mean_diff) else "")
    return "=" if alike else text


def _count_wins(scenario: str, part: pd.DataFrame, metric: str, console: Console) -> None:
    fewest = part.diverged == part.groupby("cell").diverged.transform("min")
    wide = part.pivot(index="cell", columns="observer", values="mean")
    winners = part[fewest & part["mean"].notna()].sort_values("mean", kind="stable").groupby("cell").observer.first()
    rule = f"least {metric} among those with fewest diverged runs," if part.diverged.any() else f"least {metric}"
    title = f"{scenario}: {rule} of {part.signal.iloc[0]} over {len(wide)} cells"
    table = titled(title)
    table.add_column("observer")
    table.add_column("cells won", justify="right")
    table.add_column(f"median {metric}", justify="right")
    if part.diverged.any():
        table.add_column("diverged runs", justify="right")
    for observer, wins in winners.value_counts().reindex(wide.columns, fill_value=0).items():
        mine = part[part.observer == observer]
        lost = [f"{mine.diverged.sum() / (mine.n + mine.diverged).sum():.3g} of all"] if part.diverged.any() else []
        table.add_row(str(observer), str(wins), f"{wide[observer].median():.4g}", *lost)
    console.print(table)


def listing(title: str, rows: dict[str, tuple[str, ...]], heads: tuple[str, ...], console: Console) -> None:
    """Print named things with what is said of them."""
    table = titled(title)
    for head in heads:
        table.add_column(head, overflow="fold")
    for name, cells in rows.items():
        table.add_row(name, *map(escape, cells))
    console.print(table)


def gains(design: Any, console: Console) -> None:
    """Print a certificate and the numbers worth showing."""
    c = design.certificate
    console.print(
        f"certificate: {c.inequality}\nmargin {c.margin:.6g}, solver {c.solver}, status {c.status}", markup=False
    )
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
    shown = titled(title)
    for head in (*fixed, *moving):
        shown.add_column(head + (" [1/s]" if head == "rate" else ""), justify="right")
    stands = table[table.refused == ""]
    for row in stands.to_dict("records"):
        shown.add_row(*(f"{row[c]:.4g}" if isinstance(row[c], float) else str(row[c]) for c in (*fixed, *moving)))
    console.print(shown)
    if len(stands) > 1 and not moving and stands.rate.nunique() <= 1:
        text = f"{fixed[0]} changes nothing here: the gains are not found from it; name a --method that does."
        console.print(text, highlight=False)
    for row in table[table.refused != ""].to_dict("records"):
        console.print(f"{fixed[0]} = {row[fixed[0]]}: {row['refused']}", highlight=False, markup=False)
    for row in stands[stands.fallback != ""].to_dict("records"):
        console.print(f"{fixed[0]} = {row[fixed[0]]}, a fallback: {row['fallback']}", highlight=False, markup=False)


def arrow(table: pd.DataFrame) -> pa.Table:
    """Return a frame as it is put into a Parquet file."""
    return pa.Table.from_pandas(table, preserve_index=False)


def checked(title: str, findings: list[Any], console: Console) -> None:
    """Print every check of an observer with its verdict and why."""
    table = titled(title)
    for head in ("check", "verdict", "why"):
        table.add_column(head, overflow="fold", no_wrap=head != "why")
    for found in findings:
        colour = {"passes": "green", "fails": "red"}.get(found.verdict, "yellow")
        table.add_row(found.check, f"[{colour}]{found.verdict}[/]", escape(found.why))
    console.print(table)
