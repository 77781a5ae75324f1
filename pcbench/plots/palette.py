"""One colour for each observer, the same in every picture, and safe for colour-blind readers.

Taken from Wong's and Tol's palettes, so that no two observers of one scenario differ by red against green alone. Observers run
with other options (dkf-bias, pccebo-tuned) have the colour of their base in another shade, and a dash pattern and a marker of
their own: no picture needs colour to be read.
Source: Wong, Nature Methods 8 (2011), 441; Tol, Colour schemes, SRON technical note 09-002.
"""

import colorsys
from collections.abc import Iterable
from typing import NamedTuple

from pcbench.observers import base_of

COLOURS = {
    "pccebo": "#0072B2",
    "kfbo": "#E69F00",
    "dkf": "#1A1A1A",
    "open-loop": "#8C8C8C",
    "pco": "#117733",
    "pi-pco": "#56B4E9",
    "chain": "#332288",
    "equal-delay": "#B8A33D",
    "no-delay": "#CC6677",
    "smo": "#AA4499",
    "pio": "#44AA99",
    "high-gain": "#882255",
    "ekf": "#D55E00",
}
PLANT, MEASURED = "#E3BE8B", "#9BB7D4"  # that no observer has
OWN = ("#009E73", "#CC79A7", "#6699CC", "#997700", "#661100")  # of a user's own observers, by name
DASHES: tuple[tuple[int, ...], ...] = ((), (6, 2), (2, 2), (8, 2, 2, 2), (4, 2, 1, 2, 1, 2))
MARKERS = ("o", "s", "^", "D", "v", "P", "X", "<", ">", "*", "h", "p", "d")
SHADES = (0.0, 0.22, -0.14, 0.36, -0.24)  # of lightness, for the first, second ... label of a base


class Style(NamedTuple):
    """How an observer is drawn."""

    colour: str  # #rrggbb
    dash: tuple[int, ...]  # pixels on and off; empty: solid
    marker: str  # of matplotlib


def styles(labels: Iterable[str]) -> dict[str, Style]:
    """Return a style for each label; the same label has the same colour whatever it stands beside, unless it has siblings."""
    out: dict[str, Style] = {}
    siblings: dict[str, int] = {}
    names = list(dict.fromkeys(labels))
    for label in names:
        base = base_of(label) or label
        plain = base in names or base == label
        rank = 0 if label == base else siblings.setdefault(base, 1 if plain else 0)
        if label != base:
            siblings[base] += 1
        out[label] = Style(
            _shade(_colour(base), SHADES[rank % len(SHADES)]), DASHES[rank % len(DASHES)], _marker(label)
        )
    return out


def _colour(base: str) -> str:
    return COLOURS.get(base) or OWN[sum(map(ord, base)) % len(OWN)]


def _marker(label: str) -> str:
    known = [*COLOURS]
    base = base_of(label) or label
    first = known.index(base) if base in known else len(label)
    return MARKERS[(first + len(label) - len(base)) % len(MARKERS)]


def _shade(colour: str, by: float) -> str:
    """A colour made lighter (by > 0) or darker."""
    red, green, blue = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    hue, light, full = colorsys.rgb_to_hls(red, green, blue)
    light = min(max(light + by if light + by > 0.08 else light - by, 0.08), 0.82)
    return "#" + "".join(f"{round(255 * c):02X}" for c in colorsys.hls_to_rgb(hue, light, full))
