"""What there is, on the screen: a line each, or one thing in full.

What a run took, in a sentence or line by line.

What a person reads of an answer to what suffices: a row an observer, and in words what a row cannot say.
"""

from collections.abc import Mapping
from typing import Any

import pandas as pd
from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from pcbench.cli.render.tables import Column, printed, titled
from pcbench.dataset.result import Result
from pcbench.errors import printable
from pcbench.statistics.number_format import estimate

OWN = ("summary", "options", "table", "signals", "unknown", "parameters")  # not said in a line


def lines(title: str, rows: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    """Print named things with what is said of them in a line."""
    table = titled(title)
    table.add_column("name", no_wrap=True)
    table.add_column("what", overflow="fold")
    for name, said in rows.items():
        table.add_row(name, said["summary"])
    console.print(table)


def whole(name: str, said: Mapping[str, Any], console: Console) -> None:
    """Print all that is said of one thing."""
    console.print(Text.assemble((printable(name), "bold"), printable(f": {said['summary']}")))
    for key, value in said.items():
        if key not in OWN and value not in (None, [], {}, ""):
            console.print(f"  {key.replace('_', ' ')}: {words(value)}", highlight=False, markup=False, soft_wrap=False)
    for key in ("signals", "unknown"):
        there = said.get(key)
        for each in there if isinstance(there, list) else []:
            rest = [f"{k.replace('_', ' ')} {v:g}" for k, v in each.items() if k not in ("name", "unit")]
            text = f"  {'signal' if key == 'signals' else 'unknown'} {each['name']} [{each['unit']}]"
            console.print(text + (f": {', '.join(rest)}" if rest else ""), highlight=False, markup=False)
    for key, value in said.get("parameters", {}).items():
        console.print(f"  parameter plant.{key} = {value:g}", highlight=False, markup=False)
    if said.get("options"):
        below = said.get("table", "[options.NAME]")
        console.print(f"  options, which a study sets below {below}:", highlight=False, markup=False)
        _options(said["options"], console)


def _options(options: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    """Print each option with its type, range and default, and below it what it is."""
    for name, o in options.items():
        choices = " | ".join(map(str, o.get("choices", ())))
        kind = choices or " ".join(filter(None, (o["type"], o["range"])))
        can = ", can be tuned" if o["tunable"] else ""
        console.print(
            f"  {name}: {kind}, default {words(o['default'])}{can}", style="bold", highlight=False, markup=False
        )
        console.print(Padding(o["description"], (0, 0, 0, 6)), highlight=False)


def words(value: Any) -> str:
    """Return a value as a person writes it."""
    if value is None or value == {}:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{k} {words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        each = [f"[{words(v)}]" if isinstance(v, list) else words(v) for v in value]
        return each[0] if len(set(each)) == 1 and len(each) > 1 and not isinstance(value[0], str) else ", ".join(each)
    return str(value)


def sentence(result: Result, folder: str) -> str:
    """Return what a run took, in a sentence."""
    p = result.provenance
    if not result.cost.runs and result.exact and not p["blocks"]:
        cells = result.stats.groupby(["scenario", "cell"]).ngroups
        return f"Exact numbers of {'one cell' if cells == 1 else f'{cells:,} cells'} are in {folder}."
    if result.study.evaluation == "exact" and not result.exact and p["blocks"] and result.stats.reason.isna().any():
        return (
            f"The tables in {folder} are of its runs, which stay; exact moments stand beside them: hold them together with "
            f"pcbench verify {folder} --exact, or give another folder with --out for tables of exact numbers."
        )
    if result.study.evaluation == "exact" and not result.exact:
        return f"No number in {folder} is exact: its tables say why, in the column reason of stats."
    if not result.cost.runs:
        return f"Nothing was left to do: {p['blocks']} blocks in {folder}."
    spent = f"{p['wall_seconds']:.1f} s ({p['compile_seconds']:.1f} s compiling, {p['writing_seconds']:.1f} s writing)"
    return f"{p['runs_added']:,} runs added; {p['blocks']} blocks and their statistics in {folder} after {spent}."


def timings(result: Result, seconds: float) -> list[str]:
    """Return where the time of a run went, a line each; `seconds` since the command began."""
    p = result.provenance
    if not result.cost.runs and not result.cost.exact_seconds:
        return []
    before = max(seconds - p["wall_seconds"], 0.0), "imports, reading, designs that are tuned"
    rows = {"from the command to the study": before}
    if result.cost.exact_seconds:
        rows["exact numbers"] = result.cost.exact_seconds, "planning, solving and writing them"
    if not result.cost.runs:
        rows["the study in all"] = p["wall_seconds"], ""
        return _took(rows)
    rows |= {
        "planning": (p["planning_seconds"], "designs, schedules, bounds"),
        "computing": (p["computing_seconds"], f"on all threads, {p['compile_seconds']:.1f} s of it making programs"),
        "writing": (p["writing_seconds"], "on all threads"),
        "closing tables, beside": (p["closing_seconds"], "while others compute"),
        "the study in all": (p["wall_seconds"], f"{p['runs_added']:,} runs"),
    }
    return _took(rows)


def _took(rows: dict[str, tuple[float, str]]) -> list[str]:
    return [f"{what:<30}{took:9.2f} s   {how}".rstrip() for what, (took, how) in rows.items()]


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
