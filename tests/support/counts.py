"""Count lines, files and `Any` of the package and the tests: `python tests/support/counts.py` writes them to CONTRIBUTING.md.

Lines are all lines of Python files, blank ones and comments too. `Any` counts the word as a name in the code, imports included.
"""

import io
import re
import tokenize
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "CONTRIBUTING.md"
HEAD = "| folder | lines | files | `Any` per 1,000 lines |\n|---|---|---|---|\n"
ROW = re.compile(r"^\| `(pcbench|tests)` \| ([\d,]+) \| ([\d,]+) \| ([\d.]+) \|$", re.M)


class Counts(NamedTuple):
    """Of one folder."""

    lines: int
    files: int
    anys: float  # per 1,000 lines


def count_files(folder: Path) -> Counts:
    """Return the counts of all Python files below a folder."""
    texts = [path.read_text(encoding="utf-8") for path in sorted(folder.rglob("*.py"))]
    lines = sum(len(text.splitlines()) for text in texts)
    names = sum(
        token.string == "Any" for text in texts for token in tokenize.generate_tokens(io.StringIO(text).readline)
    )
    return Counts(lines, len(texts), round(1000 * names / lines, 1))


def table() -> str:
    """Return the table as CONTRIBUTING.md has it."""
    rows = {name: count_files(ROOT / name) for name in ("pcbench", "tests")}
    return HEAD + "".join(f"| `{name}` | {c.lines:,} | {c.files:,} | {c.anys} |\n" for name, c in rows.items())


def stated_counts(text: str) -> dict[str, Counts]:
    """Return the counts that a page states."""

    def number(digits: str) -> int:
        return int(digits.replace(",", ""))

    return {name: Counts(number(lines), number(files), float(anys)) for name, lines, files, anys in ROW.findall(text)}


if __name__ == "__main__":
    page = PAGE.read_text(encoding="utf-8")
    PAGE.write_text(re.sub(rf"{re.escape(HEAD)}(?:\| `.*\n)*", lambda _: table(), page), encoding="utf-8")
