"""What a picture is drawn on: a column's width, font and size, and how much room words take there."""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from functools import lru_cache
from typing import NamedTuple

import matplotlib as mpl
from matplotlib.font_manager import FontProperties, findfont
from matplotlib.ft2font import FT2Font

from pcbench.errors import UserError


class Paper(NamedTuple):
    """What a picture is made for: a column of a page."""

    width: float = 3.75  # inches, of one column; maps of many observers take two
    size: float = 9.0  # points, of text
    font: str = "DejaVu Sans"  # family; where it is not installed, its metrics are guessed by DejaVu Sans

    @property
    def em(self) -> float:
        """Return the height of a letter in inches."""
        return self.size / 72

    def checked(self) -> "Paper":
        """Return the paper; raise UserError for a width or a size on which nothing can be read."""
        if not 2.0 <= self.width <= 20.0:
            raise UserError(f"--width: got {self.width:g}, expected inches of a column, 2 to 20; give one.")
        if not 4.0 <= self.size <= 24.0:
            raise UserError(f"--size: got {self.size:g}, expected points of text, 4 to 24; give one.")
        return self


PAPER = Paper()


@lru_cache(4096)
def width_of(text: str, size: float, font: str = PAPER.font) -> float:
    """Return how wide a text is in inches; of several lines, the widest."""
    face = _face(font)
    face.set_size(size, 72)
    widest = 0.0
    for line in text.split("\n"):
        face.set_text(line, 0.0)
        widest = max(widest, face.get_width_height()[0] / 64)
    return widest / 72


@lru_cache(16)
def _face(font: str) -> FT2Font:
    return FT2Font(findfont(FontProperties(family=[font, "DejaVu Sans"])))


@contextmanager
def drawn_on(paper: Paper) -> Iterator[None]:
    """Let what is drawn within have the paper's font and size, and its text be text, never mathematics."""
    with mpl.rc_context(
        {"font.family": [paper.font, "DejaVu Sans"], "font.size": paper.size, "text.parse_math": False}
    ):
        yield


def folded(text: str, wide: float, size: float, font: str) -> list[str]:
    """Return a text in lines that are at most so many inches wide; a word is never cut, nor a unit in brackets."""
    out: list[str] = []
    text = re.sub(r"\[.*?\]", lambda unit: unit.group().replace(" ", "\u00a0"), text)
    for line in text.split("\n"):
        words = line.split(" ")
        out.append(words[0])
        for word in words[1:]:
            longer = f"{out[-1]} {word}"
            if width_of(longer, size, font) <= wide:
                out[-1] = longer
            else:
                out.append(word)
    return out
