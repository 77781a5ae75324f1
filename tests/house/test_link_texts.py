"""The text of a link contains the title of the page, the notebook or the section to which it leads."""

import json
import re

import pytest
from documents import GUIDE, ROOT, prose

LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(([^)\s#:]*)(?:#([^)\s]*))?\)")
PATHS = [*ROOT.glob("*.md"), *sorted(GUIDE.rglob("*.md")), *sorted(ROOT.glob("notebooks/*.ipynb"))]


def read(path):
    """The text of a page, or of a notebook without its code."""
    if path.suffix == ".md":
        return prose(path.read_text())
    return "\n\n".join(
        "".join(c["source"]) for c in json.loads(path.read_text())["cells"] if c["cell_type"] == "markdown"
    )


def plain(text):
    return " ".join(re.sub(r"[`*]", "", text).split())


def other_texts(page, text):
    """The links whose text contains no title of their target, each with the titles."""
    for label, path, anchor in LINK.findall(text):
        target = page.parent / path if path else page
        if target.suffix in (".md", ".ipynb") and target.exists():
            heads = [plain(head) for head in re.findall(r"^#+ (.*)$", text if target == page else read(target), re.M)]
            titles = [h for h in heads if anchor and re.sub(r"[^\w\- ]", "", h).lower().replace(" ", "-") == anchor]
            titles += [] if target == page else heads[:1]
            if not any(title in plain(label) for title in titles):
                yield label, titles


@pytest.mark.parametrize("page", PATHS, ids=lambda path: str(path.relative_to(ROOT)))
def test_link_text_contains_title_of_target(page):
    assert list(other_texts(page, read(page))) == []
    assert list(other_texts(page, "see [this page](axes.md#the-axes)")) or page.parent != GUIDE
