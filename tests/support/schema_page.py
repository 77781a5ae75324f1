"""The guide's page of the tables' columns, made from what the tables are made from.

python tests/support/schema_page.py     writes it anew
"""

from pathlib import Path

import pcbench
from pcbench.dataset import columns
from pcbench.statistics import RUN_METRICS
from pcbench.study.axes import AXES, CHANNELS, COMMANDS, OUTPUTS, STATES

PAGE = Path(pcbench.__file__).parent / "guide" / "columns.md"
AXIS = [*(a for a in AXES if a not in STATES), *STATES, *COMMANDS]
ALWAYS = {"diverged": "bool in runs, int64 in stats", "seed": "int64"}
HEAD = f"""# Columns of the tables

Look up the columns of a study's Parquet files here, with their types, units and meanings. The script
`tests/support/schema_page.py` generates this page from the code.

Each file's metadata contains the number of its schema (`pcbench.schema`, {columns.SCHEMA} in this release), and the meaning and
unit of each column. The number changes if a column is added or removed, or changes its meaning. The columns `<axes>` are those
of the last table that a scenario has, in that order. In `runs`, the names of the folders contain `scenario` and `observer`.
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
        said = f"Columns as above: {again}, and `<axes>` after `cell`.\n\n" if again else "`<axes>` follow `cell`.\n\n"
        head, rest = table(title, new).split("\n\n", 1)
        parts.append(f"{head}\n\n{said}{rest}")
        known |= set(names)
    return "\n".join([*parts, table("Axes", AXIS), PARAMETER])


PARAMETER = "`plant.<parameter>` is a double: the plant's parameter at this grid point, if the study varies it.\n"


if __name__ == "__main__":
    PAGE.write_text(page())
