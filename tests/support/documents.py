"""The README, CONTRIBUTING and the pages of the guide, and the blocks of code in them."""

import re
from pathlib import Path
from typing import NamedTuple

import pcbench

ROOT = Path(__file__).parents[2]
GUIDE = Path(pcbench.__file__).parent / "guide"
README = (ROOT / "README.md").read_text()
PAGES = {path.relative_to(GUIDE).as_posix(): path.read_text() for path in sorted(GUIDE.rglob("*.md"))}
TEXTS = {"README.md": README, **PAGES}
RUN = {name: text for name, text in TEXTS.items() if "/" not in name}  # decision records only record
RUN["CONTRIBUTING.md"] = (ROOT / "CONTRIBUTING.md").read_text()
BLOCK = re.compile(
    r'^(?:<!-- not run: (?P<reason>.*?) -->\n)?```(?P<language>\w+)(?: title="(?P<title>[^"]*)")?\n(?P<text>.*?)^```$',
    re.S | re.M,
)


class Block(NamedTuple):
    """A fenced block: why it is not run, what it is written in, and the name under which the reader saves it."""

    reason: str | None
    language: str
    title: str | None
    text: str


def code_blocks(name):
    """The blocks of a page in their order."""
    return [Block(*found.group("reason", "language", "title", "text")) for found in BLOCK.finditer(RUN[name])]


def blocks(language, *names):
    """The blocks of a language, of the pages of these names, or of all and the README."""
    return [b.text for name in names or TEXTS if name in RUN for b in code_blocks(name) if b.language == language]


def tables(text, head):
    """The rows of all tables of a page whose first head is this one, as texts without code marks."""
    found, inside = [], False
    for line in text.splitlines():
        inside = line.startswith("|") and (inside or line.startswith(f"| {head} |"))
        if inside and not line.startswith((f"| {head} |", "|---")):
            found.append([cell.replace("`", "").strip() for cell in line.strip("|").split("|")])
    return found


def is_printed(value, text):
    """Whether a number is the one that is printed, to its last digit."""
    return abs(value - float(text)) <= 0.51 * 10 ** -len(text.partition(".")[2])


def prose(text):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)


def lines(text):
    """The command lines of a block of shell, as one string each, without the remarks beside them."""
    joined = re.sub(r"\\\n\s+", "", text)
    return [line for raw in joined.splitlines() if (line := re.sub(r"(^|\s+)#.*", "", raw))]


def commands(name):
    """The command lines of pcbench that a page shows."""
    shown = (
        [block.text for block in code_blocks(name) if block.language == "sh" and not block.title] if name in RUN else []
    )
    return [line for text in shown for line in lines(text) if line.startswith("pcbench ")]
