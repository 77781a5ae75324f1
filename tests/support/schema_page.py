"""The guide's page of the tables' columns, made from what the tables are made from.

python tests/support/schema_page.py     writes it anew
"""

from pathlib import Path

import pcbench
from pcbench.dataset import columns
from pcbench.statistics import RUN_METRICS
from pcbench.study.axes import AXES, CHANNELS, COMMANDS, OUTPUTS, STATES

PAGE = Path(pcbench.__file__).parent / "guide" / "tables.md"
AXIS = [*(a for a in AXES if a not in STATES), *STATES, *COMMANDS]
ALWAYS = {"diverged": "bool in runs, int64 in stats", "seed": "int64"}
HEAD = f"""# The columns of the tables

Each Parquet file has its schema's number in its metadata (`pcbench.schema`: here {columns.SCHEMA}), and with each column its
meaning and unit. A column that is added, goes or means something else makes a new number. `tests/support/schema_page.py` makes
this page from the code. `<axes>` are the columns of the last table: those that a scenario has, in that order. `scenario` and
`observer` of `runs` are in the folders' names.
"""


def row(name: str) -> str:
    """A line of a table."""
    (field,) = columns.table({name: [None]}).schema
    said = {key.decode(): text.decode() for key, text in field.metadata.items()}
    kind = ALWAYS.get(
        name,
        "double or list of double"
        if name in (*CHANNELS, *STATES, *OUTPUTS, "delay_self_transition")
        else str(field.type),
    )
    return f"| `{name}` | {kind} | {said.get('unit', '')} | {in_table(said['meaning'])} |"


def in_table(text: str) -> str:
    """A text that may stand in a cell of a table."""
    return text.replace("|", "\\|")


def table(title: str, names: list[str]) -> str:
    """A table of columns."""
    return (
        "\n".join([f"## {title}\n", "| column | type | unit | meaning |", "|---|---|---|---|", *map(row, names)]) + "\n"
    )


def orders() -> dict[str, list[str]]:
    """The columns of each table but the axes, in order."""
    runs = ["study", "scenario", "observer", "cell", "seed", "signal", "unit", "predicts_unknown_input"]
    return {
        "runs/": [*runs, *RUN_METRICS, "status", "diverged", "divergence_time"],
        "stats.parquet": columns.stats_order([]),
        "pairs.parquet": columns.pairs_order([]),
    }


def page() -> str:
    """The whole page."""
    known, parts = set(), [HEAD]
    for title, names in orders().items():
        new = [name for name in names if name not in known]
        again = ", ".join(f"`{name}`" for name in names if name in known)
        said = f"As above: {again}; and `<axes>` after `cell`.\n\n" if again else "With `<axes>` after `cell`.\n\n"
        head, rest = table(title, new).split("\n\n", 1)
        parts.append(f"{head}\n\n{said}{rest}")
        known |= set(names)
    return "\n".join([*parts, table("Axes", AXIS), PARAMETER])


PARAMETER = "`plant.<parameter>` is a double: the plant's parameter in this cell, where the study varies it.\n"


if __name__ == "__main__":
    PAGE.write_text(page())
