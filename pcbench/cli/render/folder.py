"""What a study's folder holds, what came of checking it and of comparing it with another, and claims with their verdicts."""

import numpy as np
import pandas as pd
from rich.text import Text

from pcbench.cli.render.tables import Screen
from pcbench.dataset.compare import Comparison
from pcbench.dataset.validate_exact import KEY, ExactValidation
from pcbench.dataset.verify import Status, Verdict
from pcbench.papers.claim import FINDING, VERDICTS, Claim, counts
from pcbench.statistics.number_format import mark_uncertified

MOST = 8  # lines of a kind
LONGEST = 40  # rows of a comparison; the rest is counted
STYLES = dict(zip((*VERDICTS, FINDING), ("green", "yellow", "red", "dim", "white"), strict=True))


def status(found: Status, folder: str, screen: Screen) -> None:
    """Print how far a study is."""
    numbers = ("cells", "blocks", "runs", "of", "done")
    rows = []
    for s in found.shares:
        share = f"{100 * min(s.seeds / s.wanted, 1):.3g} %" if s.wanted else "-"
        name = mark_uncertified(s.observer, [s.certified])
        rows.append((s.scenario, name, str(s.cells), str(s.blocks), f"{s.seeds:,}", f"{s.wanted:,}", share))
    title = f"{found.study} in {folder}: {found.bytes / 1e6:,.1f} MB"
    screen.fold(title, ("scenario", "observer", *numbers), rows, right=numbers)
    screen.say_unproven(s.certified for s in found.shares)
    screen.say(*(f"damaged: {name}" for name in found.damaged), *(f"doubled: {name}" for name in found.doubled))
    if many := len(found.unfinished):
        files = "1 unfinished file" if many == 1 else f"{many} unfinished files"
        screen.print(f"{files} of a run that was killed; the next run clears that away.")
    behind = any(s.seeds < s.wanted for s in found.shares) or found.damaged or found.doubled
    screen.print(
        "Every run is there, with its statistics." if found.closed and not behind else "Run the study again to go on."
    )


def verdict(found: Verdict, folder: str, screen: Screen) -> None:
    """Print what a verification found."""
    screen.say(*found.wrong, *found.differing, *found.unlike)
    wrong = f"{len(found.wrong)} complaint" + ("s" if len(found.wrong) > 1 else "")
    files = f"{found.files} blocks, {wrong}" if found.wrong else f"all {found.files} blocks are whole"
    many, exact = len(found.recomputed), len(found.exact)
    equal = (
        f"{many - len(found.differing)} of {many} came out again, bit for bit" if many else "none was computed again"
    )
    if found.files or found.wrong or not exact:
        screen.print(f"{folder}: {files}; {equal}.")
    if exact:
        equal = f"{exact - len(found.unlike)} of {exact}"
        screen.print(f"{folder}: exact numbers of {equal} cells came out again, to rounding.")


def against_exact(found: ExactValidation, screen: Screen) -> None:
    """Print the verdict on simulated means, those that are off, and why others could not be compared."""
    worst = found.wrong.assign(size=found.wrong.z.abs()).sort_values("size", ascending=False)
    for row in worst.head(MOST).to_dict("records"):
        at = ", ".join(str(row[name]) for name in KEY)
        screen.say(f"{at}: {row['mean']:.6g} ± {row['se']:.2g}, exact {row['exact']:.6g}, z = {row['z']:.3g}")
    screen.say(*found.refused[:MOST])
    if len(found.refused) > MOST:
        screen.print(f"... and {len(found.refused) - MOST:,} more that have no exact value.")
    screen.say(found.verdict)


def comparison(found: Comparison, a: str, b: str, screen: Screen) -> None:
    """Print what differs in how two results were made, what changed beyond its interval, and what to make of the rest."""
    for phrase in found.made_by:
        screen.print(phrase)
    changed = found.rows[found.rows.changed]
    if len(changed):
        _changes(changed.head(LONGEST), f"changed beyond its interval: {a} there, {b} here", screen)
    if len(changed) > LONGEST:
        screen.print(f"... and {len(changed) - LONGEST:,} rows more that changed.")
    for side, many in zip((a, b), found.only, strict=True):
        if many:
            screen.print(f"{many:,} rows stand in {side} alone.")
    every, same = len(found.rows), int(found.rows.same_draws.sum())
    if same:
        equal = "bit for bit equal" if found.identical else f"apart by at most {found.largest:.1e} of themselves"
        narrowed = int(found.rows.narrowed.sum()) if found.rows.narrowed.any() else 0
        equal += f", {narrowed:,} of them over the seeds that both hold" if narrowed else ""
        rest = f"; {every - same:,} on other draws, compared by Welch's t" if same < every else ""
        screen.print(f"{same:,} rows stand on the same draws: {equal}{rest}.")
    else:
        screen.print(f"All {every:,} rows stand on other draws: compared by Welch's t, Holm over all of them, 5 %.")
    screen.print(f"{found.changed:,} of {every:,} rows changed beyond their interval.")


def _changes(rows: pd.DataFrame, title: str, screen: Screen) -> None:
    def mean(value: float, se: float, unit: str) -> str:
        if np.isnan(value):
            return "-"
        return f"{value:.5g}" + (f" ± {2 * se:.1g}" if se > 0 else "") + (f" {unit}" if unit else "")

    texts = []
    for r in rows.to_dict("records"):
        sides = [mean(r[f"mean_{side}"], r[f"se_{side}"], r["unit"]) for side in "ab"]
        p = "no spread" if np.isnan(r["p_holm"]) else f"{r['p_holm']:.1e}"
        observer = mark_uncertified(r["observer"], [r["certified_a"], r["certified_b"]])
        names = (r["scenario"], r["where"], observer, r["signal"], r["metric"])
        texts.append((*names, *sides, f"{r['difference']:+.3g}", p))
    numbers = ("there", "here", "difference", "p (Holm)")
    screen.fold(title, ("scenario", "cell", "observer", "signal", "metric", *numbers), texts, right=numbers)
    screen.say_unproven(rows[["certified_a", "certified_b"]].to_numpy().ravel())


def claims(title: str, rows: list[Claim], screen: Screen) -> None:
    """Print printed against reproduced, line by line."""
    texts = [(row.claim, row.printed, row.reproduced, Text(row.verdict, STYLES[row.verdict])) for row in rows]
    screen.fold(title, ("claim", "printed", "reproduced", "verdict"), texts)
    screen.print(summary(rows))


def every(found: dict[str, list[Claim]], titles: dict[str, str], screen: Screen) -> None:
    """Print the claims of all papers, and how many of each verdict over all."""
    for name, rows in found.items():
        claims(titles[name], rows, screen)
    total = summary([row for rows in found.values() for row in rows])
    screen.print(f"All {len(found)} papers: {total}", style="bold")


def summary(rows: list[Claim]) -> str:
    """Return how many of each verdict, in a sentence."""
    many = counts(rows)
    each = ", ".join(f"{many[name]} {name}" for name in VERDICTS)
    return f"{sum(many[name] for name in VERDICTS)} claims: {each}; {many[FINDING]} findings that stand in no paper."
