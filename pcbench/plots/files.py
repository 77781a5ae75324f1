"""Pictures as files: SVG and PDF whose text is text, PNG; and as a part of a page."""

import io
import re
from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

from pcbench.dataset import write_table
from pcbench.errors import UserError

KINDS = ("svg", "pdf", "png")
DPI = 200  # of PNG
TIP = re.compile(rb'<g id="tip:([^"]*)">')
TAG, PRECISE = re.compile(r"<[^>]*>"), re.compile(r"(\d+\.\d\d)\d+")  # numbers inside a tag say where, not what
IDENTITY = re.compile(
    r' id="(?:figure|axes|patch|text|line2d|matplotlib|xtick|ytick|\w+Collection|QuadMesh|QuadContourSet)[\w.]*"'
)


def saved(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file's content. Text stays text in SVG and PDF; the same figure gives the same bytes."""
    out = io.BytesIO()
    about: dict[str, Any] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}[kind]
    with mpl.rc_context({"svg.fonttype": "none", "svg.hashsalt": "pcbench", "pdf.fonttype": 42}):
        figure.savefig(out, format=kind, dpi=DPI, metadata=about)
    return TIP.sub(rb"<g><title>\1</title>", out.getvalue()) if kind == "svg" else out.getvalue()


def save(figure: Figure, file: str | Path) -> None:
    """Write a figure as SVG, PDF or PNG, as its suffix says; raise UserError for another, or where it cannot be written."""
    kind = Path(file).suffix.removeprefix(".").lower()
    if kind not in KINDS:
        raise UserError(f"plots.save: got {str(file)!r}, expected a name that ends in .{', .'.join(KINDS)}; give one.")
    write_table.put_content(file, saved(figure, kind))


def inline(figure: Figure, name: str) -> str:
    """Return a figure as SVG that stands inside a page: no header, few digits, names within it that begin with `name`."""
    text = saved(figure, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.S)
    text = IDENTITY.sub("", text)
    text = TAG.sub(lambda tag: PRECISE.sub(r"\1", tag.group()), text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"| version="1.1"', "", text, count=3).replace("xlink:href", "href")
    text = re.sub(r'( id="|href="#|url\(#)', rf"\g<1>{name}-", text)
    return re.sub(r"\n\s*", "\n", text)
