"""Parse TOML text; every error is a ValueError with one sentence."""

import re
import tomllib
from typing import Any

TomlTable = dict[str, Any]  # a table: texts, numbers, dates, lists and tables by key
# nesting limit of tables and lists: Python's stack overflows at some thousand
DEEPEST = 64
LARGEST = 64 * 2**20  # characters
PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
# a dotted key nests one table per part, and the parser needs memory quadratic in their number
DOTTED = re.compile(rf"(?<![\w.-]){PART}(?:[ \t]*+\.[ \t]*+{PART}){{{DEEPEST}}}")


def parse(text: str | bytes) -> TomlTable:
    """Return the content of a TOML text (a byte-order mark is ignored); raise ValueError if invalid or nested too deep."""
    content = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    if len(content) > LARGEST:
        raise ValueError(f"it has more than {LARGEST:,} characters")
    if DOTTED.search(content):
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}")
    try:
        table = tomllib.loads(content)
    except RecursionError:
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}") from None
    level: list[Any] = [table]
    for _ in range(DEEPEST):
        level = [inner for node in level for inner in (node.values() if isinstance(node, dict) else node)]
        level = [node for node in level if isinstance(node, dict | list)]
    if level:
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}")
    return table
