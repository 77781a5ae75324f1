"""One look for each observer, the same in every picture: a colour, a dash pattern and a marker.

Colours were searched for, not chosen: those of observers that run together lie apart for readers of normal sight and for those
who lack one kind of cone (Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009), 1291), differ in lightness,
hence also on grey paper, and are dark enough to be seen as lines on white. Dashes and markers say the same once more: no
picture needs colour to be read. An observer run with other options (kf-bias, pccebo-tuned) has the hue of its base in
another shade, its dashes with a dot more, and a marker of its own. The truth is ink, what is measured a pale line.
"""

from collections.abc import Iterable
from typing import Any, NamedTuple

from pcbench.observers import base_of

INK, SOFT, GRID = "#1B1B1B", "#6B6B6B", "#E4E4E4"
PLANT, MEASURED = INK, "#B9C4CF"  # that no observer has
DASHES: dict[str, tuple[float, ...]] = {
    "kf": (),
    "model-only": (1.0, 1.4),
    "pccebo": (6.0, 1.6),
    "kfbo": (2.8, 1.4),
    "pco": (4.0, 1.4, 4.0, 1.4, 1.0, 1.4),
    "pi-pco": (6.0, 1.4, 1.0, 1.4),
    "chain": (6.0, 1.6),
    "equal-delay": (2.8, 1.4),
    "no-delay": (6.0, 1.4, 1.0, 1.4),
    "smo": (6.0, 1.6),
    "pio": (2.8, 1.4),
    "high-gain": (6.0, 1.6),
    "ekf": (2.8, 1.4),
    "ekf-iterated": (6.0, 1.4, 1.0, 1.4),
    "ukf": (4.0, 1.4, 4.0, 1.4, 1.0, 1.4),
    "mhe": (9.0, 1.6),
    "particle": (1.8, 1.8),
    "kf-ignore-delay": (6.0, 1.6),
    "kf-drop-delayed": (2.8, 1.4),
    "kf-reprocess": (6.0, 1.4, 1.0, 1.4),
    "kf-cloning": (4.0, 1.4, 4.0, 1.4, 1.0, 1.4),
    "kf-larsen": (9.0, 1.6),
    "kf-alexander": (4.5, 2.2),
    "kf-delayed-horizon": (1.8, 1.8),
    "kf-shifted-innovation": (7.0, 1.4, 2.4, 1.4),
    "oosm-a1": (5.0, 1.2, 1.0, 1.2, 1.0, 1.2),
    "oosm-b1": (3.4, 3.0),
    "oosm-lag": (9.0, 1.4, 3.0, 1.4, 3.0, 1.4),
    "ekf-delay": (6.0, 1.6),
    "mmae-delay": (2.8, 1.4),
}
COLOURS = {
    "kf": "#224E89",
    "model-only": "#898989",
    "pccebo": "#AE5C18",
    "kfbo": "#10A5D2",
    "pco": "#2A4000",
    "pi-pco": "#AD263F",
    "chain": "#6633FF",
    "equal-delay": "#722241",
    "no-delay": "#C3902C",
    "smo": "#9922CC",
    "pio": "#54AB53",
    "high-gain": "#B14DD0",
    "ekf": "#884400",
    "ekf-iterated": "#542F6B",
    "ukf": "#0C11BB",
    "mhe": "#709FA6",
    "particle": "#07B472",
    "kf-ignore-delay": "#4D159C",
    "kf-drop-delayed": "#C92536",
    "kf-reprocess": "#4589A8",
    "kf-cloning": "#580A51",
    "kf-larsen": "#575C6B",
    "kf-alexander": "#7D09D8",
    "kf-delayed-horizon": "#800908",
    "kf-shifted-innovation": "#609156",
    "oosm-a1": "#241264",
    "oosm-b1": "#B07800",
    "oosm-lag": "#E073D5",
    "ekf-delay": "#D572F4",
    "mmae-delay": "#F83844",
}
MARKERS = {"kf": "o", "model-only": "x", "pccebo": "s", "kfbo": "^", "pco": "D", "pi-pco": "v", "chain": "s",
           "equal-delay": "^", "no-delay": "v", "smo": "s", "pio": "^", "high-gain": "s", "ekf": "^",
           "ekf-iterated": "v", "ukf": "D", "mhe": "s", "particle": "P",
           "kf-ignore-delay": "^", "kf-drop-delayed": "v", "kf-reprocess": "s", "kf-cloning": "D", "kf-larsen": "<",
           "kf-alexander": ">",
           "kf-delayed-horizon": "P", "kf-shifted-innovation": "X", "oosm-a1": "p", "oosm-b1": "h", "oosm-lag": "*",
           "ekf-delay": "s", "mmae-delay": "^"}  # fmt: skip
SIBLINGS = ("P", "X", "<", ">", "h", "p", "*")  # markers of a base's variants
OWN = ("#00796B", "#8E5A9E", "#7A6A00", "#4C6EA8", "#7B3F00")  # of a user's own observers, by name
OWN_DASHES = ((8.0, 1.6), (2.0, 1.2), (5.0, 1.2, 2.0, 1.2))
SHADES = (0.0, 0.34, -0.42, 0.5, -0.6, 0.18, -0.22)  # of white or black, for the first, second ... label of a base


class Style(NamedTuple):
    """How an observer is drawn."""

    colour: str  # #rrggbb
    dash: tuple[float, ...]  # on and off in widths of the line; empty: solid
    marker: str  # of matplotlib

    @property
    def line(self) -> Any:
        """Return the dashes as matplotlib takes them."""
        return (0, self.dash) if self.dash else "solid"


def styles(labels: Iterable[str]) -> dict[str, Style]:
    """Return a style for each label; the same label has the same look whatever it stands beside, unless it has siblings."""
    out: dict[str, Style] = {}
    siblings: dict[str, int] = {}
    names = list(dict.fromkeys(labels))
    for label in names:
        base = base_of(label) or label
        plain = base in names or base == label
        rank = 0 if label == base else siblings.setdefault(base, 1 if plain else 0)
        if label != base:
            siblings[base] += 1
        out[label] = _style(base, rank)
    return out


def shade(colour: str, by: float) -> str:
    """Return a colour mixed with so much white, or where `by` is negative black."""
    return mixed(colour, by, 255) if by >= 0 else mixed(colour, -by, 0)


def mixed(colour: str, share: float, other: int) -> str:
    """Return a colour mixed with a share of a grey from 0 (black) to 255 (white)."""
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(c + share * (other - c)):02X}" for c in parts)


def pale(colour: str, share: float = 0.75) -> str:
    """Return a colour mixed with so much white that dark words are read on it."""
    return mixed(colour, share, 255)


def on(colour: str) -> str:
    """Return the ink that is read on a colour: dark or white."""
    parts = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    light = sum(w * (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4)
                for w, p in zip((0.2126, 0.7152, 0.0722), parts, strict=True))  # fmt: skip
    return INK if light > 0.22 else "#FFFFFF"


def _style(base: str, rank: int) -> Style:
    own = sum(map(ord, base))
    colour = COLOURS.get(base) or OWN[own % len(OWN)]
    dash = DASHES.get(base, OWN_DASHES[own % len(OWN_DASHES)])
    marker = MARKERS.get(base, "Dv"[own % 2])
    if not rank:
        return Style(colour, dash, marker)
    dotted = ((*dash, 1.0, 1.4) if dash else (9.0, 1.4, 1.0, 1.4)) + (1.0, 1.4) * (rank - 1)
    first = 3 * list(COLOURS).index(base) if base in COLOURS else own
    return Style(shade(colour, SHADES[rank % len(SHADES)]), dotted, SIBLINGS[(first + rank) % len(SIBLINGS)])
