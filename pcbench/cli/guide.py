"""The command that shows the guide: pages of Markdown that come with the package."""

from pathlib import Path
from typing import Annotated

import typer

from pcbench.errors import unknown

FOLDER = Path(__file__).parents[1] / "guide"
ORDER = (  # of a reader's questions; what is not here follows by the alphabet
    *(
        "first-study",
        "reading-results",
        "who-knows",
        "exact-answers",
        "which-observer",
        "axes-and-schedules",
        "what-suffices",
        "outliers",
        "nonlinear",
        "unknown-delay",
        "logs",
    ),
    *("your-own-plant", "your-own-observer", "loops", "a-loop-of-your-own", "unknown-inputs", "gains-and-tuning"),
    "code-and-guests",
    "from-a-bag-to-c",
    *("large-studies", "five-papers", "not-claimed", "how-it-works", "how-it-differs", "versions", "tables"),
    "decisions",
)


def pages() -> dict[str, Path]:
    """Return the guide's pages by topic, in order."""
    found = {_topic(path): path for path in FOLDER.rglob("*.md")}
    first = [topic for topic in ORDER if topic in found]
    return {topic: found[topic] for topic in [*first, *sorted(found.keys() - set(first))]}


def title(page: str) -> str:
    """Return a page's title: what follows its first #."""
    return next(line for line in page.splitlines() if line.startswith("# ")).removeprefix("# ")


def guide(
    topic: Annotated[str | None, typer.Argument(help="a page's name; left out: the list of pages")] = None,
) -> None:
    """Show a page of the guide, or which there are.

    Example: pcbench guide which-observer
    """
    known = pages()
    if topic is None:
        wide = max(map(len, known))
        print("The guide, a page a question:\n")
        print("\n".join(f"  {name:<{wide}}  {title(path.read_text('utf-8'))}" for name, path in known.items()))
        print("\nOne of them: pcbench guide which-observer")
        return
    path = known.get(topic.strip().lower().removesuffix(".md").replace("_", "-"))
    if path is None:
        raise unknown("guide", "page", topic, known)
    from rich.markdown import Markdown

    from pcbench.cli.shared import console

    console().print(Markdown(path.read_text("utf-8"), hyperlinks=False))


def _topic(path: Path) -> str:
    return (path.parent.name if path.stem == "README" else path.stem).replace("_", "-")
