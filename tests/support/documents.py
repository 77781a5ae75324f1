"""The README and the pages of the guide, and the blocks of code in them."""

import re
from pathlib import Path

import pcbench

ROOT = Path(__file__).parents[2]
GUIDE = Path(pcbench.__file__).parent / "guide"
README = (ROOT / "README.md").read_text()
PAGES = {path.relative_to(GUIDE).as_posix(): path.read_text() for path in sorted(GUIDE.rglob("*.md"))}
TEXTS = {"README.md": README, **PAGES}


def blocks(language, *names):
    """The blocks of a language, of the pages of these names, or of all and the README."""
    texts = [TEXTS[name] for name in names or TEXTS]
    return [block for text in texts for block in re.findall(rf"^```{language}\n(.*?)^```$", text, re.S | re.M)]


def prose(text):
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```$", "", text, flags=re.S | re.M)


def commands(name):
    """The command lines that a page shows, as one string each, without what is said beside them."""
    lines = [line for block in blocks("text", name) for line in re.sub(r"\\\n\s+", "", block).splitlines()]
    return [re.split(r"\s{2,}", line)[0] for line in lines if line.startswith("pcbench ")]
