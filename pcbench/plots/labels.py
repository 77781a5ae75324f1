"""Texts of figures: metrics in words with their units, and titles. Figures as SVG, PDF or PNG files, or as a part of a page.

Text stays text in SVG and PDF.
"""

import io
import re
import zlib
from collections.abc import Mapping
from math import isfinite
from pathlib import Path

import matplotlib as mpl
import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset import single_table
from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.layout import TIMES, number
from pcbench.statistics.metric_matrix import OF_RUN
from pcbench.study import title_of_scenario

WORDS = {
    "mae": "mean |error|",
    "rmse": "rms error",
    "mse": "mean square error",
    "max_abs_error": "largest |error|",
    "final_error": "error at the end",
    "tracking_rmse": "rms tracking error",
    "nees": "NEES, squared error / assumed covariance",
}


def title_of(metric: str, signal: str, unit: str) -> str:
    """Return a metric of a signal as an axis' title, with its unit."""
    return with_unit(describe_metric(metric, signal), unit)


def with_unit(text: str, unit: str) -> str:
    """Return a text with a unit in brackets: [-] of what has none, nothing if the unit is not known."""
    return f"{text} [{'-' if unit == '1' else unit}]" if unit else text


def describe_metric(metric: str, signal: str) -> str:
    """Return a metric of a signal in words."""
    is_steady, base = metric.startswith("steady_"), metric.removeprefix("steady_").removeprefix("pooled_")
    suffix = ", pooled over runs" if "pooled" in metric else ""
    words = WORDS.get(base, base.replace("_", " "))
    if metric in OF_RUN:
        return words
    return f"{words} of {signal.replace('_', ' ')}" + (" after the transient" if is_steady else "") + suffix


def unit_of(part: pd.DataFrame) -> str:
    """Return the unit of a frame's rows."""
    return str(part.unit.iloc[0]) if len(part) else ""


def about(result: Result, part: pd.DataFrame, at: Mapping[str, object]) -> str:
    """Return the title of a figure: the scenario, the values of the axes it does not show, and the number of runs."""
    titles = frames.axis_titles(result, part) if at else {}
    return ", ".join(
        [
            title_of_scenario(result.study, part.scenario.iloc[0]),
            *(frames.format_axis(axis, value, titles) for axis, value in at.items()),
            describe_runs(frames.count_runs(part)),
        ]
    )


def describe_runs(many: int) -> str:
    """Return a number of runs in words; 0: the numbers are exact."""
    return f"{many:,} runs" if many > 1 else "one run" if many else "exact values"


def quantity(value: str, unit: str) -> str:
    """Return a number with its unit, if it has one."""
    return value if unit in ("", "1") else f"{value} {unit}"


def times(value: float) -> str:
    """Return a ratio with two digits, or as many as distinguish it from 1, at most four."""
    if not isfinite(value):
        return "∞"
    if 1 < value < 1.1:
        return "1×" if value < SAME else f"{value:.3f}×" if value < 1.01 else f"{value:.2f}×"
    return f"{number(float(f'{value:.2g}'))}×"


SAME = 1.0005  # a ratio below it is written as 1
POLYLINE = re.compile(r' d="([-+.\deMLz\s]*)"')  # a path of straight lines
KINDS = ("svg", "pdf", "png")
DPI = 200  # of PNG
FAMILY = f"'{TIMES}', 'STIX Two Text', 'Times New Roman', 'Times'"  # where the first is not installed
TIP = re.compile(rb'<g id="tip:([^"]*)">')
TAG, PRECISE = re.compile(r"<[^>]*>"), re.compile(r"(\d+\.\d\d)\d+")  # numbers inside a tag say where, not what
USED = re.compile(r'(?:href="#|url\(#)([^")]+)')  # an identifier
WRAPPED = re.compile(r"<g>\s*(<(?:path|use)\b[^>]*/>|<text\b[^>]*>[^<]*</text>)\s*</g>")  # in a group that says nothing


def render_figure(figure: Figure, kind: str) -> bytes:
    """Return a figure as a file's content. Text stays text in SVG and PDF; the same figure gives the same bytes."""
    out = io.BytesIO()
    metadata: dict[str, None] = {"svg": {"Date": None}, "pdf": {"CreationDate": None}, "png": {"Software": None}}[kind]
    with mpl.rc_context(
        {"svg.fonttype": "none", "svg.hashsalt": "pcbench", "pdf.fonttype": 42, "text.hinting": "none"}
    ):
        figure.savefig(out, format=kind, dpi=DPI, metadata=metadata)
    if kind != "svg":
        return out.getvalue()
    return TIP.sub(rb"<g><title>\1</title>", out.getvalue()).replace(f"'{TIMES}'".encode(), FAMILY.encode())


def save(figure: Figure, file: str | Path) -> None:
    """Write a figure as SVG, PDF or PNG, by its suffix. Raise UserError for another suffix or if the file cannot be written."""
    kind = Path(file).suffix.removeprefix(".").lower()
    if kind not in KINDS:
        raise UserError(f"plots.save: got {str(file)!r}, expected a name that ends in .{', .'.join(KINDS)}; use one.")
    single_table.put_content(file, render_figure(figure, kind))


def inline(figure: Figure, name: str) -> str:
    """Return a figure as SVG for a page: without header, with few digits, and with identifiers of its `name`."""
    text = render_figure(figure, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>|<!--.*?-->", "", text, flags=re.S)
    text = POLYLINE.sub(lambda match: f' d="{_compact(match[1])}"', text)
    text = TAG.sub(lambda tag: PRECISE.sub(r"\1", tag.group()), text)
    text = re.sub(r' xmlns(:xlink)?="[^"]*"| version="1.1"', "", text, count=3).replace("xlink:href", "href")
    text = _with_short_ids(text, name).replace("\n<g>\n</g>", "")
    while (flat := WRAPPED.sub(r"\1", text)) != text:
        text = flat
    text = re.sub(r' transform="rotate\(-0 [^"]*"', "", text)
    text = re.sub(r' style="[^"]*"', lambda match: match[0].replace(": ", ":").replace("; ", ";"), text)
    return re.sub(r"\n\s*", "\n", text)


def _with_short_ids(text: str, name: str) -> str:
    """Return a figure whose identifiers are few letters that no figure of another `name` has; those never used are left out."""
    first = f"f{zlib.crc32(name.encode()):x}-"
    short = {match: f"{first}{i}" for i, match in enumerate(dict.fromkeys(USED.findall(text)))}
    text = re.sub(r' id="([^"]*)"', lambda match: f' id="{short[match[1]]}"' if match[1] in short else "", text)
    return USED.sub(lambda match: match[0].replace(match[1], short[match[1]]), text)


def _compact(path: str) -> str:
    """Return a path of straight lines with relative coordinates, in tenths of a point; equal successive points are one."""
    out, x, y = [], 0, 0
    for command, *point in re.findall(r"([MLz])\s*(?:([-+.\de]+)\s+([-+.\de]+))?", path):
        if command == "z":
            out.append("z")
            continue
        a, b = (round(10 * float(v)) for v in point)
        if command == "M":
            out.append(f"M{a / 10:g} {b / 10:g}")
        elif (a, b) != (x, y):
            out.append(f"l{(a - x) / 10:g} {(b - y) / 10:g}")
        x, y = a, b
    return re.sub(r"(?<![\d.])0\.", ".", "".join(out)).replace(" -", "-")
