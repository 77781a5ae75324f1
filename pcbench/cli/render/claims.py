"""What a person reads of a reproduction: claims with their verdicts, paper by paper, and how many of each."""

from rich.console import Console
from rich.text import Text

from pcbench.cli.render.tables import titled
from pcbench.papers.claim import FINDING, VERDICTS, Claim, counts

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
