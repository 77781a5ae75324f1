"""Maps over two axes of a study: a metric of each observer, who wins and how surely, and how many runs diverge."""

from collections.abc import Callable
from functools import partial
from math import isfinite
from types import MappingProxyType
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, to_hex
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import fine_maps, frames, scales, small_maps
from pcbench.plots.canvas import PAPER, Paper
from pcbench.plots.fine_maps import Marks
from pcbench.plots.labels import about, named, times, title_of, unit_of
from pcbench.plots.layout import Key
from pcbench.plots.palette import Style, pale, styles
from pcbench.plots.small_maps import Cell, Map, Over

ERRORS = LinearSegmentedColormap.from_list("errors", ["#F3F6FA", "#A9C1DA", "#5A88B8", "#1B4674"])  # dark: more
LOST = LinearSegmentedColormap.from_list("lost", ["#FFFFFF", "#F0C9A8", "#C77B3B", "#7A3E0C"])
NOTHING = "#FFFFFF"  # of a cell in which every run diverged
MOST = 12  # panels of a map of winners


def heatmaps(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
    marks: Marks = MappingProxyType({}),
    paper: Paper = PAPER,
) -> Figure:
    """Return a map of a metric's mean over two axes (None: the first two that vary) for each observer, on one scale.

    Where an axis has more than 24 values it is an image, with lines of equal value, and `marks` on it: by what is said of each,
    its place (x, y). Raises UserError where fewer than two axes vary, or for a word that is none.
    """
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    title = title_of(metric, whole.signal.iloc[0], unit_of(whole))
    held = {name: part[name].iloc[0] for name in frames.varying(whole) if name not in (x, y)}
    part = part.assign(value=part["mean"])
    return _maps(result, part, (x, y), title, held, ERRORS, _norm(part["mean"]), paper, marks)


def divergence(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    at: dict[str, Any] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map over two axes of the share of runs that diverged, for each observer, in per cent."""
    whole = frames.rows(result, scenario, None, "divergence_rate")
    x, y = two_axes(whole, x, y)
    part = frames.fixed(whole, [x, y], at)
    held = {name: part[name].iloc[0] for name in frames.varying(whole) if name not in (x, y)}
    part = part.assign(value=100 * part["mean"], unit="%")
    return _maps(result, part, (x, y), "diverged runs [%]", held, LOST, Normalize(0, 100), paper)


def winners(
    result: Result,
    x: str | None = None,
    y: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return a map over two axes of who wins, in its colour, and by which factor it is ahead of the second.

    Where the best is not surely better than every other (5 %, Holm) its colour is pale, and the cell says with whom it ties.
    Other axes that vary have a map for each of their values, where these are few and `at` says nothing of them.
    """
    whole = frames.rows(result, scenario, signal, metric)
    x, y = two_axes(whole, x, y)
    others = [n for n in frames.varying(whole) if n not in (x, y, *(at or {}))]
    found = frames.fixed(frames.standings(result, scenario, signal, metric), [x, y, *others], at)
    if len(found.groupby(others, sort=False) if others else []) > MOST:
        found = frames.fixed(found, [x, y])
    groups = list(found.groupby(others, sort=False)) if others else [((), found)]
    look = styles(whole.observer)
    made = [
        Map(
            ", ".join(frames.said(n, v) for n, v in zip(others, key, strict=True)),
            _cells(mine, x, y, partial(_won, look)),
        )
        for key, mine in groups
    ]
    keys = [Key(name, look[name], "patch") for name in look if name in set(found.best)]
    title = f"least {named(metric, whole.signal.iloc[0])}, {about(result, whole, at or {})}"
    return _drawn(made, _over(result, whole, x), _over(result, whole, y), title, keys, paper, False)


def two_axes(part: pd.DataFrame, x: str | None, y: str | None) -> tuple[str, str]:
    """Return the two axes of a map: those that are given, or the first that vary; raise UserError where there are not two."""
    found = frames.varying(part)
    chosen = [name for name in (x, y) if name] + [name for name in found if name not in (x, y)]
    if len(chosen) < 2 or chosen[0] not in found or chosen[1] not in found:
        raise UserError(
            f"map of {part.scenario.iloc[0]}: got axes that vary: {', '.join(found) or 'none'}, expected two; give the study "
            "two axes with several values each, or name two of these."
        )
    return (chosen[0], chosen[1]) if x or y else frames.map_axes(part)


def _won(look: dict[str, Style], row: dict[str, Any]) -> Cell:
    if not row["best"]:
        return Cell(NOTHING, ("all diverge", "-"), "all runs diverge")
    colour, factor = look[row["best"]].colour, row["factor"]
    ahead = times(factor) if isfinite(factor) and factor > 1 else ""
    if row["winner"]:
        p = f", p {row['p']:.1g}" if isfinite(row["p"]) else ""
        return Cell(colour, (f"{row['best']}\n{ahead}", row["best"]), f"{row['best']} surely{p}, the second {ahead}")
    tied = " = ".join((row["best"], *row["alike"][:1])) + (" …" if len(row["alike"]) > 1 else "")
    return Cell(pale(colour), (f"tie\n{tied}", "tie"), f"tie: {' = '.join((row['best'], *row['alike']))}")


def _maps(
    result: Result,
    part: pd.DataFrame,
    axes: tuple[str, str],
    title: str,
    held: dict[str, Any],
    colours: Any,
    norm: Any,
    paper: Paper,
    marks: Marks = MappingProxyType({}),
) -> Figure:
    """Draw a map of the column `value` for each observer, in colours."""
    x, y = axes

    def painted(row: dict[str, Any]) -> Cell:
        value, unit = row["value"], str(row.get("unit", ""))
        if not isfinite(value):
            return Cell(NOTHING, ("all diverged", "-"), f"{row['observer']}: all runs diverged")
        tip = f"{row['observer']}: {scales.number(float(f'{value:.4g}'))} {unit}"
        return Cell(to_hex(colours(float(norm(value)))), (scales.short(value),), tip, value)

    maps = [Map(str(o), _cells(mine, x, y, painted)) for o, mine in part.groupby("observer", sort=False)]
    log = isinstance(norm, LogNorm)
    low, high = float(norm.vmin), float(norm.vmax)
    scale = scales.of([low, high], log)
    levels = [(v, said) for v, said in zip(scale.ticks, scale.words, strict=True) if low <= v <= high]
    keys = [Key(said, Style(to_hex(colours(float(norm(v)))), (), ""), "patch") for v, said in levels]
    said = f"{title}, {about(result, part, held)}"
    return _drawn(maps, _over(result, part, x), _over(result, part, y), said, keys, paper, log, marks)


def _drawn(
    maps: list[Map], x: Over, y: Over, title: str, keys: list[Key], paper: Paper, log: bool,
    marks: Marks = MappingProxyType({}),
) -> Figure:  # fmt: skip
    if fine_maps.is_fine(x, y):
        return fine_maps.drawn(maps, x, y, title, keys, paper, log, marks)
    return small_maps.drawn(maps, x, y, title, keys, paper, log)


def _cells(rows: pd.DataFrame, x: str, y: str, cell: Callable[[dict[str, Any]], Cell]) -> dict[tuple[Any, Any], Cell]:
    return {(row[x], row[y]): cell({str(k): v for k, v in row.items()}) for row in rows.to_dict("records")}


def _over(result: Result, part: pd.DataFrame, axis: str) -> Over:
    found = list(dict.fromkeys(part[axis]))
    ordered = sorted(found) if all(isinstance(v, int | float) for v in found) else found
    return Over(frames.label(axis, frames.units(result, part)), ordered)


def _norm(values: pd.Series) -> Any:
    found = values[np.isfinite(values)]
    if not len(found):
        return Normalize(0, 1)
    low, high = float(found.min()), float(found.max())
    if high - low <= scales.SAME * abs(high):
        return Normalize(min(0.0, low), max(0.0, high) or 1.0)
    return (
        LogNorm(low, high)
        if low > 0 and high > 10 * low
        else Normalize(min(low, 0.0) if low < 0.3 * high else low, high)
    )
