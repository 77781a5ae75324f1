"""Count, in all texts that users read, private words and long sentences: `python tests/support/plain_words.py [FILE ...]`.

Texts are the Markdown pages, the notebooks' text, the docstrings of public functions, and every other string of the package
that is a phrase (messages, help, captions, legends). Code and addresses of links are no text. A sentence above 30 words
is long; only prose has sentences: pages, notebooks and docstrings.
"""

import ast
import importlib
import inspect
import io
import json
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
LONG = 30  # words
PAGES = ("*.md", "pcbench/guide/**/*.md", "notebooks/*.ipynb")


class Text(NamedTuple):
    """A text and where it is."""

    place: str
    words: str
    prose: bool  # whether it has sentences


def private_words() -> re.Pattern[str]:
    """Return what finds the words of `tests/private_words.txt`."""
    lines = (ROOT / "tests" / "private_words.txt").read_text(encoding="utf-8").splitlines()
    return re.compile(rf"\b({'|'.join(line for line in lines if line and not line.startswith('#'))})\b", re.IGNORECASE)


def texts() -> Iterator[Text]:
    """Yield all texts that users read."""
    for pattern in PAGES:
        for page in sorted(ROOT.glob(pattern)):
            place, raw = str(page.relative_to(ROOT)), page.read_text(encoding="utf-8")
            if page.suffix == ".ipynb":
                cells = [c for c in json.loads(raw)["cells"] if c["cell_type"] == "markdown"]
                raw = "\n\n".join("".join(c["source"]) for c in cells)
            yield Text(place, without_code(raw), True)
    pcbench = importlib.import_module("pcbench")
    for name in sorted(pcbench.__all__):
        thing = getattr(pcbench, name)
        if (callable(thing) or inspect.ismodule(thing)) and thing.__doc__:
            yield Text(f"pcbench.{name}", without_code(inspect.cleandoc(thing.__doc__)), True)
    for file in sorted((ROOT / "pcbench").rglob("*.py")):
        for line, phrase in phrases(ast.parse(file.read_text(encoding="utf-8"))):
            yield Text(f"{file.relative_to(ROOT)}:{line}", phrase, False)


def remarks() -> Iterator[Text]:
    """Yield all docstrings and comments of the package."""
    for file in sorted((ROOT / "pcbench").rglob("*.py")):
        place, code = file.relative_to(ROOT), file.read_text(encoding="utf-8")
        for token in tokenize.generate_tokens(io.StringIO(code).readline):
            if token.type == tokenize.COMMENT:
                yield Text(f"{place}:{token.start[0]}", without_code(token.string), False)
        for node in ast.walk(ast.parse(code)):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and (words := ast.get_docstring(node)):
                yield Text(f"{place}:{getattr(node, 'lineno', 1)}", without_code(words), False)


def phrases(tree: ast.Module) -> Iterator[tuple[int, str]]:
    """Yield the strings of a module that are phrases, and no docstrings."""
    docstrings = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and node.body
        and isinstance(node.body[0], ast.Expr)
    }
    for node in ast.walk(tree):
        is_string = isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docstrings
        if is_string and " " in node.value and len(re.findall(r"[A-Za-z]{2,}", node.value)) >= 3:
            yield node.lineno, node.value


def without_code(text: str) -> str:
    """Return Markdown without blocks of code, comments, addresses and names in backticks (one word each)."""
    for pattern, new in (
        (r"```.*?```", "\n\n"),
        (r"<!--.*?-->", ""),
        (r"\$\$.*?\$\$|\$[^$\n]+\$", "x"),
        (r"`[^`\n]+`", "code"),
        (r"\]\([^)]*\)", "]"),
        (r"https?://\S+", "address"),
    ):
        text = re.sub(pattern, new, text, flags=re.DOTALL)
    return text


def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of a page: each item of a list and each cell of a table begins one."""
    for block in re.split(r"\n\s*\n|\n\s*(?:[-*]|\d+\.)\s|\n#+ |\|", text):
        for sentence in re.split(r"(?<=[.!?:])\s+(?=[A-Z\[*\"(])", " ".join(block.split())):
            if len(sentence.split()) > 2:
                yield sentence


class Count(NamedTuple):
    """What some texts have of private words and long sentences, each with its place."""

    private: list[str]
    long: list[str]
    sentences: int


def count(some: Iterable[Text]) -> Count:
    """Return the private words and the long sentences of texts."""
    words, private, long, many = private_words(), [], [], 0
    for text in some:
        for match in words.finditer(text.words):
            around = " ".join(text.words[max(match.start() - 40, 0) : match.end() + 40].split())
            private.append(f"{text.place}: {match.group()}: {around}")
        for sentence in sentences(text.words) if text.prose else ():
            many += 1
            if (size := len(sentence.split())) > LONG:
                long.append(f"{text.place}: {size} words: {sentence}")
    return Count(private, long, many)


def main() -> None:
    """Print each private word and each long sentence with its place, and the counts last."""
    places = tuple(sys.argv[1:]) or ("",)
    private, long, many = count(text for text in texts() if text.place.startswith(places))
    print(*private, *long, sep="\n")
    print(f"{len(private)} private words; {len(long)} of {many} sentences have more than {LONG} words")


if __name__ == "__main__":
    main()
