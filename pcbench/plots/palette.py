"""One look for each observer, the same in every picture: a colour, a dash pattern and a marker.

Colours were searched for, not chosen: those of observers that run together lie apart for readers of normal sight and for those
who lack one kind of cone (Machado, Oliveira, Fernandes, IEEE Trans. Vis. Comput. Graph. 15 (2009), 1291), differ in lightness,
hence also on grey paper, and are dark enough to be seen as lines on white. Dashes and markers say the same once more: no
picture needs colour to be read. An observer run with other options (kf-bias, pccebo-tuned) has the hue of its base in
another shade, its dashes with a dot more, and a marker of its own. The truth is ink, what is measured a pale line.
"""

from collections.abc import Iterable
from typing import NamedTuple, TypedDict

from pcbench.observers import base_of

INK, SOFT, GRID = "#1B1B1B", "#6B6B6B", "#E4E4E4"
PLANT, MEASURED = INK, "#B9C4CF"  # that no observer has


class Style(NamedTuple):
    """How an observer is drawn."""

    colour: str  # #rrggbb
    dash: tuple[float, ...]  # on and off in widths of the line; empty: solid
    marker: str  # of matplotlib

    @property
    def line(self) -> str | tuple[int, tuple[float, ...]]:
        """Return the dashes as matplotlib takes them."""
        return (0, self.dash) if self.dash else "solid"


class LineLook(TypedDict):
    """How matplotlib draws a line."""

    label: str
    color: str
    linestyle: str | tuple[int, tuple[float, ...]]
    linewidth: float


LOOKS = {
    "kf": Style("#224E89", (), "o"),
    "model-only": Style("#898989", (1.0, 1.4), "x"),
    "pccebo": Style("#AE5C18", (6.0, 1.6), "s"),
    "kfbo": Style("#10A5D2", (2.8, 1.4), "^"),
    "pco": Style("#2A4000", (4.0, 1.4, 4.0, 1.4, 1.0, 1.4), "D"),
    "pi-pco": Style("#AD263F", (6.0, 1.4, 1.0, 1.4), "v"),
    "chain": Style("#6633FF", (6.0, 1.6), "s"),
    "equal-delay": Style("#722241", (2.8, 1.4), "^"),
    "no-delay": Style("#C3902C", (6.0, 1.4, 1.0, 1.4), "v"),
    "smo": Style("#9922CC", (6.0, 1.6), "s"),
    "pio": Style("#54AB53", (2.8, 1.4), "^"),
    "high-gain": Style("#B14DD0", (6.0, 1.6), "s"),
    "eso": Style("#CE44EB", (1.0, 1.0, 4.0, 1.0), "p"),
    "cascade-predictor": Style("#510015", (8.0, 1.2, 1.0, 1.2), "h"),
    "cdob": Style("#A814A3", (3.0, 1.0, 1.0, 2.4), ">"),
    "super-twisting": Style("#040842", (2.0, 1.0, 2.0, 3.0), "*"),
    "finite-time": Style("#AEA709", (5.0, 3.0), "8"),
    "high-gain-predictor": Style("#340829", (7.0, 1.4, 2.4, 1.4, 2.4, 1.4), "<"),
    "lmi-sampled": Style("#FA0DBD", (9.0, 1.4, 3.0, 1.4), "H"),
    "interval": Style("#1267AB", (2.0, 1.2, 6.0, 1.2), "d"),
    "ekf": Style("#884400", (2.8, 1.4), "^"),
    "ekf-iterated": Style("#542F6B", (6.0, 1.4, 1.0, 1.4), "v"),
    "ukf": Style("#0C11BB", (4.0, 1.4, 4.0, 1.4, 1.0, 1.4), "D"),
    "mhe": Style("#709FA6", (9.0, 1.6), "s"),
    "particle": Style("#07B472", (1.8, 1.8), "P"),
    "kf-event": Style("#980026", (5.0, 1.2, 1.6, 1.2), "D"),
    "kf-ignore-delay": Style("#4D159C", (6.0, 1.6), "d"),
    "kf-drop-delayed": Style("#C92536", (2.8, 1.4), "v"),
    "kf-reprocess": Style("#4589A8", (6.0, 1.4, 1.0, 1.4), "s"),
    "kf-cloning": Style("#580A51", (4.0, 1.4, 4.0, 1.4, 1.0, 1.4), "D"),
    "kf-larsen": Style("#575C6B", (9.0, 1.6), "s"),
    "kf-alexander": Style("#7D09D8", (4.5, 2.2), ">"),
    "kf-delayed-horizon": Style("#800908", (1.8, 1.8), "P"),
    "kf-shifted-innovation": Style("#609156", (7.0, 1.4, 2.4, 1.4), "X"),
    "oosm-a1": Style("#241264", (5.0, 1.2, 1.0, 1.2, 1.0, 1.2), "p"),
    "oosm-b1": Style("#B07800", (3.4, 3.0), "h"),
    "oosm-lag": Style("#E073D5", (9.0, 1.4, 3.0, 1.4, 3.0, 1.4), "*"),
    "ekf-delay": Style("#D572F4", (6.0, 1.6), "s"),
    "mmae-delay": Style("#F83844", (2.8, 1.4), "^"),
}
SIBLINGS = ("P", "X", "<", ">", "h", "p", "*")  # markers of a base's variants
USER_COLOURS = ("#00796B", "#8E5A9E", "#7A6A00", "#4C6EA8", "#7B3F00")  # of a user's own observers, by name
USER_DASHES = ((8.0, 1.6), (2.0, 1.2), (5.0, 1.2, 2.0, 1.2))
SHADES = (0.0, 0.34, -0.6, 0.5, -0.42, 0.18, -0.22)  # of white or black, for the first, second ... label of a base
CONTRAST = 2.4  # to white, that every shade has at least


def styles(labels: Iterable[str]) -> dict[str, Style]:
    """Return a style for each label, whatever their order.

    A label has the same style in all figures, unless others of its observer are shown too.
    """
    out: dict[str, Style] = {}
    siblings: dict[str, int] = {}
    names = list(dict.fromkeys(labels))
    for label in sorted(names):
        base = base_of(label) or label
        rank = 0
        if label != base:
            rank = siblings.get(base, 1 if base in names else 0)
            siblings[base] = rank + 1
        out[label] = _style(base, rank)
    return {label: out[label] for label in names}


def _style(base: str, rank: int) -> Style:
    number = sum(map(ord, base))  # by which a user's own observer gets one of these looks
    user_dash = USER_DASHES[number % len(USER_DASHES)]
    user_style = Style(USER_COLOURS[number % len(USER_COLOURS)], user_dash, "Dv"[number % 2])
    look = LOOKS.get(base, user_style)
    if not rank:
        return look
    dash = ((*look.dash, 1.0, 1.4) if look.dash else (9.0, 1.4, 1.0, 1.4)) + (1.0, 1.4) * (rank - 1)
    first = 3 * list(LOOKS).index(base) if base in LOOKS else number
    shades = [mix_gray(look.colour, abs(shade), 255 if shade >= 0 else 0) for shade in SHADES]
    shades = [colour for colour in shades if 1.05 / (luminance(colour) + 0.05) > CONTRAST]
    colour = shades[rank % len(shades)]
    return Style(colour, dash, SIBLINGS[(first + rank) % len(SIBLINGS)])


def mix_gray(colour: str, share: float, other: int) -> str:
    """Return a colour mixed with a share of a grey from 0 (black) to 255 (white)."""
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return "#" + "".join(f"{round(c + share * (other - c)):02X}" for c in parts)


def pale(colour: str, share: float = 0.75) -> str:
    """Return a colour mixed with so much white that dark text is legible on it."""
    return mix_gray(colour, share, 255)


def luminance(colour: str) -> float:
    """Return the relative luminance of a colour: 0 of black, 1 of white."""
    parts = (int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5))
    return sum(w * (p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4)
               for w, p in zip((0.2126, 0.7152, 0.0722), parts, strict=True))  # fmt: skip


def ink_on(colour: str) -> str:
    """Return the colour of legible text on a colour: dark or white."""
    return INK if luminance(colour) > 0.22 else "#FFFFFF"
