"""What a person reads of an answer to what suffices: a row an observer, and in words what a row cannot say."""

from typing import Any

import pandas as pd
from rich.console import Console

from pcbench.cli.render.tables import Column, printed
from pcbench.statistics.number_format import estimate

PLAIN = "up to"  # an answer that its row says whole


def answers(table: pd.DataFrame, console: Console) -> None:
    """Print what suffices for each observer."""
    said, rows = table.attrs, table.to_dict("records")
    unit, axis_unit = (f" [{said[k]}]" if said[k] not in ("", "1") else "" for k in ("unit", "over_unit"))
    there = f"{said['metric']}{unit}"
    columns = [
        Column("observer", [row["observer"] for row in rows], left=True),
        Column(f"suffices\nup to{axis_unit}", [_value(row["largest"], row) for row in rows]),
        Column(f"there\n{there}", [_mean(row, "") for row in rows], spare=1),
        Column(f"surely not\nfrom{axis_unit}", [_plain(row["exceeds"]) for row in rows]),
        Column(f"there\n{there}", [_mean(row, "exceeds_") for row in rows], spare=1),
    ]
    limit = f"{said['below']:g} {said['unit']}" if unit else f"{said['below']:g}"
    title = f"{said['scenario']}: {said['metric']} of {said['signal']} below {limit}, over {said['over']}"
    low, high = said["between"]
    printed(f"{title} from {low:g} to {high:g}", columns, console)
    for row in rows:
        if row["answer"] != PLAIN or row["said"].count("; ") > 1:
            _print(f"{row['observer']}: {row['said']}", console)
    for note in said["notes"]:
        _print(note, console)


def frontier(table: pd.DataFrame, console: Console) -> None:
    """Print for each value of the first axis the largest value of the second, one column for each observer."""
    said, (first, second) = table.attrs, table.attrs["over"]
    units = [f" [{unit}]" if unit else "" for unit in said["over_unit"]]
    values = list(dict.fromkeys(table[first]))
    columns = [Column(f"{first}{units[0]}", [f"{value:g}" for value in values])]
    for observer in dict.fromkeys(table.observer):
        rows = {row[first]: row for row in table[table.observer == observer].to_dict("records")}
        cells = [_value(rows[value]["largest"], rows[value]) if value in rows else "-" for value in values]
        columns.append(Column(f"{observer}\nup to{units[1]}", cells))
    limit = f"{said['below']:g} {said['unit']}".removesuffix(" 1").strip()
    printed(
        f"{said['scenario']}: largest {second} with {said['metric']} of {said['signal']} below {limit}",
        columns,
        console,
    )
    for row in table.to_dict("records"):
        if row["answer"] not in (PLAIN, "every value", "no value"):
            _print(f"{first} = {row[first]:g}, {row['observer']}: {row['said']}", console)
    for note in said["notes"]:
        _print(note, console)


def _value(value: float, row: Any) -> str:
    words = {"no value": "none", "every value": f"{value:g} (all)", PLAIN: f"{value:g}"}
    return words.get(row["answer"], "?")


def _plain(value: float) -> str:
    return "-" if value != value else f"{value:g}"


def _mean(row: Any, prefix: str) -> str:
    return estimate(row[f"{prefix}mean"], row[f"{prefix}ci_low"], row[f"{prefix}ci_high"])


def _print(text: str, console: Console) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
