"""Text of TOML as values, from whoever wrote it: whatever is wrong with it is a ValueError with one sentence."""

import re
import tomllib
from typing import Any

TomlTable = dict[str, Any]  # a table: texts, numbers, dates, lists and tables by key
# tables and lists inside one another: no study has so many, and Python runs out of its stack at some thousand
DEEPEST = 64
LARGEST = 64 * 2**20  # characters
PART = r"""(?:[\w-]++|"[^"\n]*+"|'[^'\n]*+')"""
# a key of so many parts nests as many tables, and the parser takes memory as the square of their number
DOTTED = re.compile(rf"(?<![\w.-]){PART}(?:[ \t]*+\.[ \t]*+{PART}){{{DEEPEST}}}")


def parse(text: str | bytes) -> TomlTable:
    """Return what a TOML text holds, with or without a byte-order mark; raise ValueError for what is not valid, or too deep."""
    words = text.decode("utf-8-sig") if isinstance(text, bytes) else text
    if len(words) > LARGEST:
        raise ValueError(f"it has more than {LARGEST:,} characters")
    if DOTTED.search(words):
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}")
    try:
        found = tomllib.loads(words)
    except RecursionError:
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}") from None
    level: list[Any] = [found]
    for _ in range(DEEPEST):
        level = [inner for each in level for inner in (each.values() if isinstance(each, dict) else each)]
        level = [each for each in level if isinstance(each, dict | list)]
    if level:
        raise ValueError(f"tables and lists are nested deeper than {DEEPEST}")
    return found
