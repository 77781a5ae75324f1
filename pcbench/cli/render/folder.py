"""What stands in a study's folder, and what came of checking it.

What a closing table says besides its numbers, in a sentence each.

What a person reads of a reproduction: claims with their verdicts, paper by paper, and how many of each.
"""

import pandas as pd
from rich.console import Console
from rich.text import Text

from pcbench.cli.render.tables import titled
from pcbench.dataset.validate_exact import KEY, Checked
from pcbench.dataset.verify import Status, Verdict
from pcbench.papers.claim import FINDING, VERDICTS, Claim, counts
from pcbench.plants import settles_alone
from pcbench.scenarios import Scenario
from pcbench.statistics.number_format import UNPROVEN, marked

MOST = 8  # lines of a kind


def status(found: Status, folder: str, console: Console) -> None:
    """Print how far a study is."""
    table = titled(f"{found.study} in {folder}: {found.bytes / 1e6:,.1f} MB")
    for head in ("scenario", "observer", "cells", "blocks", "runs", "of", "done"):
        table.add_column(head, justify="left" if head in ("scenario", "observer") else "right")
    for s in found.shares:
        share = f"{100 * min(s.seeds / s.wanted, 1):.3g} %" if s.wanted else "-"
        name = marked(s.observer, [s.certified])
        table.add_row(s.scenario, name, str(s.cells), str(s.blocks), f"{s.seeds:,}", f"{s.wanted:,}", share)
    console.print(table)
    if any(s.certified is False for s in found.shares):
        console.print(f"{UNPROVEN} its gains.", highlight=False)
    for what, names in (("damaged", found.damaged), ("doubled", found.doubled)):
        for name in names:
            console.print(f"{what}: {name}", highlight=False, markup=False, soft_wrap=True)
    if many := len(found.unfinished):
        said = "1 unfinished file" if many == 1 else f"{many} unfinished files"
        console.print(f"{said} of a run that was killed; the next run clears that away.", highlight=False)
    behind = any(s.seeds < s.wanted for s in found.shares) or found.damaged or found.doubled
    end = "Every run is there, with its statistics." if found.closed and not behind else "Run the study again to go on."
    console.print(end, highlight=False)


def verdict(found: Verdict, folder: str, console: Console) -> None:
    """Print what a verification found."""
    for sentence in [*found.wrong, *found.differing, *found.unlike]:
        console.print(sentence, highlight=False, markup=False, soft_wrap=True)
    wrong = f"{len(found.wrong)} complaint" + ("s" if len(found.wrong) > 1 else "")
    files = f"{found.files} blocks, {wrong}" if found.wrong else f"all {found.files} blocks are whole"
    many = len(found.recomputed)
    again = (
        f"{many - len(found.differing)} of {many} came out again, bit for bit" if many else "none was computed again"
    )
    if found.files or found.wrong or not found.exact:
        console.print(f"{folder}: {files}; {again}.", highlight=False)
    if many := len(found.exact):
        said = f"exact numbers of {many - len(found.unlike)} of {many} cells came out again, to rounding"
        console.print(f"{folder}: {said}.", highlight=False)


def against_exact(found: Checked, console: Console) -> None:
    """Print the verdict on simulated means, those that are off, and why others could not be compared."""
    worst = found.wrong.assign(size=found.wrong.z.abs()).sort_values("size", ascending=False)
    for row in worst.head(MOST).to_dict("records"):
        where = ", ".join(str(row[name]) for name in KEY)
        line = f"{where}: {row['mean']:.6g} ± {row['se']:.2g}, exact {row['exact']:.6g}, z = {row['z']:.3g}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    for sentence in found.refused[:MOST]:
        console.print(sentence, highlight=False, markup=False, soft_wrap=True)
    if len(found.refused) > MOST:
        console.print(f"... and {len(found.refused) - MOST:,} more that have no exact value.", highlight=False)
    console.print(found.verdict, highlight=False, markup=False, soft_wrap=True)


def carried(stats: pd.DataFrame, console: Console) -> None:
    """Say which predictions to the present carry the unknown input that was found."""
    said = stats[["observer", "predicts_unknown_input"]].dropna().drop_duplicates()
    for carries, text in ((True, "carries"), (False, "does not carry")):
        names = ", ".join(dict.fromkeys(said.observer[said.predicts_unknown_input == carries]))
        if names:
            console.print(f"The prediction to now {text} the unknown input found: {names}.", highlight=False)


def settles(scenario: Scenario, axes: list[str], console: Console) -> None:
    """Say where no observer is needed: on a plant that is known exactly and forgets its start."""
    pushed = any(axis in ("parameter_drift", "process_std") or axis.startswith("plant.") for axis in axes)
    if not pushed and settles_alone(scenario):
        console.print(
            f"{scenario.name}: the plant decays by itself, is what its model says, and has no process noise. There the model "
            "alone wins in the end, and no answer about periods or delays follows; say what pushes it (process_std).",
            highlight=False,
        )


STYLES = dict(zip((*VERDICTS, FINDING), ("green", "yellow", "red", "dim", "white"), strict=True))


def claims(title: str, rows: list[Claim], console: Console) -> None:
    """Print printed against reproduced, line by line."""
    table = titled(title)
    for head in ("claim", "printed", "reproduced", "verdict"):
        table.add_column(head, overflow="fold")
    for row in rows:
        table.add_row(row.claim, row.printed, row.reproduced, Text(row.verdict, STYLES[row.verdict]))
    console.print(table)
    console.print(summary(rows), highlight=False)


def every(found: dict[str, list[Claim]], titles: dict[str, str], console: Console) -> None:
    """Print the claims of all papers, and how many of each verdict over all."""
    for name, rows in found.items():
        claims(titles[name], rows, console)
    whole = [row for rows in found.values() for row in rows]
    console.print(f"All {len(found)} papers: {summary(whole)}", style="bold", highlight=False)


def summary(rows: list[Claim]) -> str:
    """Return how many of each verdict, in a sentence."""
    many = counts(rows)
    said = ", ".join(f"{many[name]} {name}" for name in VERDICTS)
    return f"{sum(many[name] for name in VERDICTS)} claims: {said}; {many[FINDING]} findings that stand in no paper."
