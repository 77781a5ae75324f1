"""Extension of griffe, which reads the API for the site: the comment of a field documents it.

The comment is on a line of the field, or else on the lines above it.
"""

import re
from typing import Any

import griffe

COMMENT = re.compile(r"#\s+(?!type:)(?P<text>[^#]+)$")


class FieldComments(griffe.Extension):
    """Give each field without a docstring the text of its comment."""

    def on_attribute_instance(self, *, attr: griffe.Attribute, **_: Any) -> None:
        """Set the docstring of a field."""
        if attr.docstring or not attr.lineno or not attr.endlineno or not attr.parent or not attr.parent.is_class:
            return
        text = comment(attr.lines_collection[attr.filepath], attr.lineno, attr.endlineno)
        if text:
            attr.docstring = griffe.Docstring(text, lineno=attr.lineno, endlineno=attr.endlineno, parent=attr)


def comment(lines: list[str], first: int, last: int) -> str:
    """Return the comment of the field on these lines (the first line of a file is 1)."""
    for line in lines[first - 1 : last]:
        if beside := COMMENT.search(line):
            return markdown(beside["text"])
    above: list[str] = []
    for line in reversed(lines[: first - 1]):
        if not line.strip().startswith("# "):
            break
        above.insert(0, line.strip().removeprefix("# "))
    return markdown(" ".join(above))


def markdown(text: str) -> str:
    """Return a comment with its units and shapes as code, which Markdown would read as links."""
    return re.sub(r"\[[^\]]*\]", lambda match: f"`{match[0]}`", text.strip())
