"""Tables and sentences for `status`, `verify`, `compare` and `reproduce`."""

import numpy as np
import pandas as pd
from rich.text import Text

from pcbench.cli.render.tables import Column, Screen
from pcbench.dataset.compare import Comparison
from pcbench.dataset.validate_exact import KEY, ExactValidation
from pcbench.dataset.verify import Status, Verdict
from pcbench.papers.claim import FINDING, NOT_OBTAINED, VERDICTS, Claim, counts
from pcbench.statistics.number_format import mark_uncertified

MOST = 8  # largest number of lines of one kind
LONGEST = 40  # largest number of rows of a comparison; the rest is counted
STYLES = dict(zip((*VERDICTS, FINDING, NOT_OBTAINED), ("green", "yellow", "red", "dim", "white", "dim"), strict=True))


def status(content: Status, folder: str, screen: Screen) -> None:
    """Print the progress of a study."""
    shares = content.shares
    percentages = [f"{100 * min(s.seeds / s.wanted, 1):.3g} %" if s.wanted else "-" for s in shares]
    columns = [
        Column("scenario", [s.scenario for s in shares], is_text=True),
        Column("observer", [mark_uncertified(s.observer, [s.certified]) for s in shares], is_text=True),
        Column("grid\npoints", [str(s.cells) for s in shares]),
        Column("blocks", [str(s.blocks) for s in shares]),
        Column("runs", [f"{s.seeds:,}" for s in shares]),
        Column("of", [f"{s.wanted:,}" for s in shares]),
        Column("done", percentages),
    ]
    screen.fit(f"{content.study} in {folder}: {content.bytes / 1e6:,.1f} MB", columns)
    screen.say_unproven(s.certified for s in content.shares)
    screen.say(
        *(f"damaged: {name}" for name in content.damaged), *(f"seeds in two files: {name}" for name in content.doubled)
    )
    if n := len(content.unfinished):
        files = "1 unfinished file" if n == 1 else f"{n} unfinished files"
        screen.print(f"{files} of a run that was killed; the next run removes them.")
    is_incomplete = any(s.seeds < s.wanted for s in content.shares) or content.damaged or content.doubled
    screen.print(
        "All runs and their statistics are complete."
        if content.closed and not is_incomplete
        else "Run the study again to continue it."
    )


def verdict(result: Verdict, folder: str, screen: Screen) -> None:
    """Print the result of a verification."""
    screen.say(*result.wrong, *result.differing, *result.unlike)
    problems = f"{len(result.wrong)} problem" + ("s" if len(result.wrong) > 1 else "")
    files = f"{result.files} blocks, {problems}" if result.wrong else f"all {result.files} blocks are intact"
    n_blocks, exact = len(result.recomputed), len(result.exact)
    equal = (
        f"{n_blocks - len(result.differing)} of {n_blocks} recomputed blocks are equal bit for bit"
        if n_blocks
        else "none was recomputed"
    )
    if result.files or result.wrong or not exact:
        screen.print(f"{folder}: {files}; {equal}.")
    if exact:
        equal = f"{exact - len(result.unlike)} of {exact}"
        screen.print(f"{folder}: exact numbers of {equal} recomputed grid points are equal up to rounding.")


def against_exact(validation: ExactValidation, screen: Screen) -> None:
    """Print the verdict on simulated means, the significant deviations, and the reasons for means without an exact value."""
    worst = validation.wrong.assign(size=validation.wrong.z.abs()).sort_values("size", ascending=False)
    for row in worst.head(MOST).to_dict("records"):
        at = ", ".join(str(row[name]) for name in KEY)
        screen.say(f"{at}: {row['mean']:.6g} ± {row['se']:.2g}, exact {row['exact']:.6g}, z = {row['z']:.3g}")
    screen.say(*validation.refusals[:MOST])
    if len(validation.refusals) > MOST:
        screen.print(f"... and {len(validation.refusals) - MOST:,} more without an exact value.")
    screen.say(validation.verdict)


def comparison(result: Comparison, a: str, b: str, screen: Screen) -> None:
    """Print the differences between two results: how they were made, what changed beyond its interval, and a summary."""
    for phrase in result.made_by:
        screen.print(phrase)
    changed_rows = result.rows[result.rows.changed]
    if len(changed_rows):
        _changes(changed_rows.head(LONGEST), f"changed beyond its interval: {a} (there), {b} (here)", screen)
    if len(changed_rows) > LONGEST:
        screen.print(f"... and {len(changed_rows) - LONGEST:,} more rows that changed.")
    for side, n in zip((a, b), result.only, strict=True):
        if n:
            screen.print(f"{n:,} rows are only in {side}.")
    n_rows, n_same = len(result.rows), int(result.rows.same_draws.sum())
    if n_same:
        equal = "bit for bit equal" if result.identical else f"relative differences of at most {result.largest:.1e}"
        n_narrowed = int(result.rows.narrowed.sum()) if result.rows.narrowed.any() else 0
        equal += f", {n_narrowed:,} of them over the common seeds" if n_narrowed else ""
        suffix = (
            f"; {n_rows - n_same:,} rows have different seeds and are compared by Welch's t-test"
            if n_same < n_rows
            else ""
        )
        screen.print(f"{n_same:,} rows have the same seeds: {equal}{suffix}.")
    else:
        screen.print(f"All {n_rows:,} rows have different seeds: compared by Welch's t-test (Holm over all rows, 5 %).")
    screen.print(f"{result.changed:,} of {n_rows:,} rows changed beyond their interval.")


def _changes(rows: pd.DataFrame, title: str, screen: Screen) -> None:
    def mean(value: float, se: float, unit: str) -> str:
        if np.isnan(value):
            return "-"
        return f"{value:.5g}" + (f" ± {2 * se:.1g}" if se > 0 else "") + (f" {unit}" if unit else "")

    records = rows.to_dict("records")
    old, new = ([mean(r[f"mean_{side}"], r[f"se_{side}"], r["unit"]) for r in records] for side in "ab")
    observers = [mark_uncertified(r["observer"], [r["certified_a"], r["certified_b"]]) for r in records]
    names = {
        "scenario": [r["scenario"] for r in records],
        "grid point": [r["where"] for r in records],
        "observer": observers,
    }
    names |= {name: [r[name] for r in records] for name in ("signal", "metric")}
    numbers = {"there": old, "here": new, "difference": [f"{r['difference']:+.3g}" for r in records]}
    numbers["p (Holm)"] = ["no variance" if np.isnan(r["p_holm"]) else f"{r['p_holm']:.1e}" for r in records]
    columns = [Column(name, cells, is_text=True) for name, cells in names.items() if any(cells)]
    screen.fit(title, columns + [Column(name, cells) for name, cells in numbers.items()])
    screen.say_unproven(rows[["certified_a", "certified_b"]].to_numpy().ravel())


def claims(title: str, rows: list[Claim], screen: Screen) -> None:
    """Print the claims of a paper with printed and reproduced numbers."""
    names = {"claim": "claim", "printed": "printed", "reproduced": "reproduced"}
    if any(row.source for row in rows):
        names = {"claim": "claim", "reference": "printed", "source": "source", "reproduced": "reproduced"}
    columns = [Column(name, [getattr(row, key) for row in rows], prose=True) for name, key in names.items()]
    verdicts = [Text(row.verdict, STYLES[row.verdict]) for row in rows]
    screen.fit(title, [*columns, Column("verdict", verdicts, is_text=True)])
    screen.print(summary(rows))


def all_claims(by_paper: dict[str, list[Claim]], titles: dict[str, str], screen: Screen) -> None:
    """Print the claims of all papers, and the total of each verdict."""
    for name, rows in by_paper.items():
        claims(titles[name], rows, screen)
    total = summary([row for rows in by_paper.values() for row in rows])
    screen.print(f"All together: {total}", style="bold")


def summary(rows: list[Claim]) -> str:
    """Return the number of each verdict, in a sentence."""
    numbers = counts(rows)
    parts = ", ".join(f"{numbers[name]} {name}" for name in VERDICTS)
    text = (
        f"{sum(numbers[name] for name in VERDICTS)} claims: {parts}; {numbers[FINDING]} findings that are in no paper."
    )
    return text + (f" {numbers[NOT_OBTAINED]} sources or numbers were not obtained." if numbers[NOT_OBTAINED] else "")
