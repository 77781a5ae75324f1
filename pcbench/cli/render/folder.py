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


def status(found: Status, folder: str, screen: Screen) -> None:
    """Print the progress of a study."""
    shares = found.shares
    done = [f"{100 * min(s.seeds / s.wanted, 1):.3g} %" if s.wanted else "-" for s in shares]
    columns = [
        Column("scenario", [s.scenario for s in shares], left=True),
        Column("observer", [mark_uncertified(s.observer, [s.certified]) for s in shares], left=True),
        Column("grid\npoints", [str(s.cells) for s in shares]),
        Column("blocks", [str(s.blocks) for s in shares]),
        Column("runs", [f"{s.seeds:,}" for s in shares]),
        Column("of", [f"{s.wanted:,}" for s in shares]),
        Column("done", done),
    ]
    screen.fit(f"{found.study} in {folder}: {found.bytes / 1e6:,.1f} MB", columns)
    screen.say_unproven(s.certified for s in found.shares)
    screen.say(
        *(f"damaged: {name}" for name in found.damaged), *(f"seeds in two files: {name}" for name in found.doubled)
    )
    if many := len(found.unfinished):
        files = "1 unfinished file" if many == 1 else f"{many} unfinished files"
        screen.print(f"{files} of a run that was killed; the next run removes them.")
    behind = any(s.seeds < s.wanted for s in found.shares) or found.damaged or found.doubled
    screen.print(
        "All runs and their statistics are complete."
        if found.closed and not behind
        else "Run the study again to continue it."
    )


def verdict(found: Verdict, folder: str, screen: Screen) -> None:
    """Print the result of a verification."""
    screen.say(*found.wrong, *found.differing, *found.unlike)
    wrong = f"{len(found.wrong)} problem" + ("s" if len(found.wrong) > 1 else "")
    files = f"{found.files} blocks, {wrong}" if found.wrong else f"all {found.files} blocks are intact"
    many, exact = len(found.recomputed), len(found.exact)
    equal = (
        f"{many - len(found.differing)} of {many} recomputed blocks are equal bit for bit"
        if many
        else "none was recomputed"
    )
    if found.files or found.wrong or not exact:
        screen.print(f"{folder}: {files}; {equal}.")
    if exact:
        equal = f"{exact - len(found.unlike)} of {exact}"
        screen.print(f"{folder}: exact numbers of {equal} recomputed grid points are equal up to rounding.")


def against_exact(found: ExactValidation, screen: Screen) -> None:
    """Print the verdict on simulated means, the significant deviations, and the reasons for means without an exact value."""
    worst = found.wrong.assign(size=found.wrong.z.abs()).sort_values("size", ascending=False)
    for row in worst.head(MOST).to_dict("records"):
        at = ", ".join(str(row[name]) for name in KEY)
        screen.say(f"{at}: {row['mean']:.6g} ± {row['se']:.2g}, exact {row['exact']:.6g}, z = {row['z']:.3g}")
    screen.say(*found.refused[:MOST])
    if len(found.refused) > MOST:
        screen.print(f"... and {len(found.refused) - MOST:,} more without an exact value.")
    screen.say(found.verdict)


def comparison(found: Comparison, a: str, b: str, screen: Screen) -> None:
    """Print the differences between two results: how they were made, what changed beyond its interval, and a summary."""
    for phrase in found.made_by:
        screen.print(phrase)
    changed = found.rows[found.rows.changed]
    if len(changed):
        _changes(changed.head(LONGEST), f"changed beyond its interval: {a} (there), {b} (here)", screen)
    if len(changed) > LONGEST:
        screen.print(f"... and {len(changed) - LONGEST:,} more rows that changed.")
    for side, many in zip((a, b), found.only, strict=True):
        if many:
            screen.print(f"{many:,} rows are only in {side}.")
    every, same = len(found.rows), int(found.rows.same_draws.sum())
    if same:
        equal = "bit for bit equal" if found.identical else f"relative differences of at most {found.largest:.1e}"
        narrowed = int(found.rows.narrowed.sum()) if found.rows.narrowed.any() else 0
        equal += f", {narrowed:,} of them over the common seeds" if narrowed else ""
        rest = (
            f"; {every - same:,} rows have different seeds and are compared by Welch's t-test" if same < every else ""
        )
        screen.print(f"{same:,} rows have the same seeds: {equal}{rest}.")
    else:
        screen.print(f"All {every:,} rows have different seeds: compared by Welch's t-test (Holm over all rows, 5 %).")
    screen.print(f"{found.changed:,} of {every:,} rows changed beyond their interval.")


def _changes(rows: pd.DataFrame, title: str, screen: Screen) -> None:
    def mean(value: float, se: float, unit: str) -> str:
        if np.isnan(value):
            return "-"
        return f"{value:.5g}" + (f" ± {2 * se:.1g}" if se > 0 else "") + (f" {unit}" if unit else "")

    every = rows.to_dict("records")
    there, here = ([mean(r[f"mean_{side}"], r[f"se_{side}"], r["unit"]) for r in every] for side in "ab")
    observers = [mark_uncertified(r["observer"], [r["certified_a"], r["certified_b"]]) for r in every]
    names = {
        "scenario": [r["scenario"] for r in every],
        "grid point": [r["where"] for r in every],
        "observer": observers,
    }
    names |= {name: [r[name] for r in every] for name in ("signal", "metric")}
    numbers = {"there": there, "here": here, "difference": [f"{r['difference']:+.3g}" for r in every]}
    numbers["p (Holm)"] = ["no variance" if np.isnan(r["p_holm"]) else f"{r['p_holm']:.1e}" for r in every]
    columns = [Column(name, cells, left=True) for name, cells in names.items() if any(cells)]
    screen.fit(title, columns + [Column(name, cells) for name, cells in numbers.items()])
    screen.say_unproven(rows[["certified_a", "certified_b"]].to_numpy().ravel())


def claims(title: str, rows: list[Claim], screen: Screen) -> None:
    """Print the claims of a paper with printed and reproduced numbers."""
    names = {"claim": "claim", "printed": "printed", "reproduced": "reproduced"}
    if any(row.source for row in rows):
        names = {"claim": "claim", "reference": "printed", "source": "source", "reproduced": "reproduced"}
    columns = [Column(name, [getattr(row, key) for row in rows], prose=True) for name, key in names.items()]
    verdicts = [Text(row.verdict, STYLES[row.verdict]) for row in rows]
    screen.fit(title, [*columns, Column("verdict", verdicts, left=True)])
    screen.print(summary(rows))


def every(found: dict[str, list[Claim]], titles: dict[str, str], screen: Screen) -> None:
    """Print the claims of all papers, and the total of each verdict."""
    for name, rows in found.items():
        claims(titles[name], rows, screen)
    total = summary([row for rows in found.values() for row in rows])
    screen.print(f"All together: {total}", style="bold")


def summary(rows: list[Claim]) -> str:
    """Return the number of each verdict, in a sentence."""
    many = counts(rows)
    each = ", ".join(f"{many[name]} {name}" for name in VERDICTS)
    text = f"{sum(many[name] for name in VERDICTS)} claims: {each}; {many[FINDING]} findings that are in no paper."
    return text + (f" {many[NOT_OBTAINED]} sources or numbers were not obtained." if many[NOT_OBTAINED] else "")
