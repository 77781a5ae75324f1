"""Tables and sentences for `find-limit`: one row per observer, and sentences for special cases."""

from collections.abc import Hashable, Mapping

import pandas as pd

from pcbench.cli.render.tables import Column, Screen, format_number
from pcbench.statistics.number_format import estimate

PLAIN = "up to"  # an answer that needs no sentence


def answers(table: pd.DataFrame, screen: Screen) -> None:
    """Print the largest sufficient value for each observer."""
    summary, rows = table.attrs, table.to_dict("records")
    unit, axis_unit = (f" [{summary[k]}]" if summary[k] not in ("", "1") else "" for k in ("unit", "over_unit"))
    metric = f"at this value\n{summary['metric']}{unit}"
    means, means_beyond = (
        [estimate(r[f"{at}mean"], r[f"{at}ci_low"], r[f"{at}ci_high"]) for r in rows] for at in ("", "exceeds_")
    )
    columns = [
        Column("observer", [row["observer"] for row in rows], is_text=True),
        Column(f"suffices\nup to{axis_unit}", [_largest(row) for row in rows]),
        Column(metric, means, spare=1),
        Column(f"exceeds\nfrom{axis_unit}", [format_number(row["exceeds"], "g") for row in rows]),
        Column(metric, means_beyond, spare=1),
    ]
    limit = f"{summary['below']:g} {summary['unit']}" if unit else f"{summary['below']:g}"
    title = f"{summary['title']}: {summary['metric']} of {summary['signal']} below {limit}, over {summary['over']}"
    low, high = summary["between"]
    screen.fit(f"{title} from {low:g} to {high:g}", columns)
    special_rows = [row for row in rows if row["answer"] != PLAIN or row["sentence"].count("; ") > 1]
    screen.say(*(f"{row['observer']}: {row['sentence']}" for row in special_rows), *summary["notes"])
    screen.explain_acronyms(table.observer)


def frontier(table: pd.DataFrame, screen: Screen) -> None:
    """Print for each value of the first axis the largest value of the second, one column for each observer."""
    summary, (first, second) = table.attrs, table.attrs["over"]
    units = [f" [{unit}]" if unit else "" for unit in summary["over_unit"]]
    values = list(dict.fromkeys(table[first]))
    columns = [Column(f"{first}{units[0]}", [f"{value:g}" for value in values])]
    for observer, part in table.groupby("observer", sort=False):
        rows = {row[first]: _largest(row) for row in part.to_dict("records")}
        columns.append(Column(f"{observer}\nup to{units[1]}", [rows.get(value, "-") for value in values]))
    limit = f"{summary['below']:g} {summary['unit']}".removesuffix(" 1").strip()
    metric = f"{summary['metric']} of {summary['signal']}"
    screen.fit(f"{summary['title']}: largest {second} with {metric} below {limit}", columns)
    special_rows = [row for row in table.to_dict("records") if row["answer"] not in (PLAIN, "every value", "no value")]
    screen.say(
        *(f"{first} = {row[first]:g}, {row['observer']}: {row['sentence']}" for row in special_rows), *summary["notes"]
    )
    screen.explain_acronyms(table.observer)


def _largest(row: Mapping[Hashable, object]) -> str:
    value = f"{row['largest']:g}"
    return {"no value": "none", "every value": f"{value} (all)", PLAIN: value}.get(str(row["answer"]), "?")
