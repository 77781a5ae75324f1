"""The report's lines: how errors are distributed, how they move with one axis, one run in time."""

from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from pcbench.plots import frames
from pcbench.plots.palette import MEASURED, PLANT, styles
from pcbench.plots.sheet import title_of, unit_of
from pcbench.report import chart
from pcbench.report.chart import Chart

OTHERS = {"plant": PLANT, "target": "#CFCFCF", "measured": MEASURED}


def distribution(whole: pd.DataFrame, part: pd.DataFrame, metric: str) -> Chart:
    """Return the distribution of a metric over runs: a line for each observer."""
    signal, unit = whole.signal.iloc[0], unit_of(whole)
    x = alt.X("value:Q", title=title_of(metric, signal, unit), scale=chart.scale(part.value))
    y = alt.Y("share:Q", title="share of runs", scale=alt.Scale(domain=[0, 1]))
    tips = ["observer", alt.Tooltip("value:Q", format=".4g"), alt.Tooltip("share:Q", format=".1%")]
    line = (
        alt.Chart(chart.rounded(part))
        .mark_line(interpolate="step-after")
        .encode(x=x, y=y, tooltip=tips, **chart.look(whole))
    )
    here = whole[whole.cell == whole.cell.iloc[0]]
    median = {row["observer"]: row["p50"] for row in here.to_dict("records")}
    text = "Medians: " + ", ".join(f"{o} {_said(v, unit)}" for o, v in median.items()) + "."
    note = "Left is better, steep is even." + chart.where(whole, [], "Shown at")
    return Chart(f"How {title_of(metric, signal, '')} is distributed", chart.spec(line), text, note)


def curve(whole: pd.DataFrame, axis: str, metric: str) -> Chart:
    """Return the mean of a metric over one axis, with its 95 % interval; other axes that vary can be chosen."""
    signal, unit = whole.signal.iloc[0], unit_of(whole)
    others = [name for name in frames.varying(whole) if name != axis]
    words = not all(isinstance(v, int | float) for v in whole[axis])
    x = alt.X(
        f"{chart.safe(axis)}:{'N' if words else 'Q'}",
        title=frames.label(axis),
        scale=alt.Undefined if words else alt.Scale(zero=False),
        sort=chart.order(whole, axis) if words else alt.Undefined,
    )
    y = alt.Y("mean:Q", title=title_of(metric, signal, unit), scale=chart.scale(whole["mean"]))
    data = chart.rounded(chart.plain(whole, [axis, *others], ["observer", "mean", "ci_low", "ci_high", "diverged"]))
    base, choices = chart.choosing(alt.Chart(data), whole, others)
    tips = [
        "observer",
        chart.safe(axis),
        *(alt.Tooltip(f"{c}:Q", format=".4g") for c in ("mean", "ci_low", "ci_high")),
        "diverged",
    ]
    band = base.mark_area(opacity=0.18).encode(
        x=x, y=alt.Y("ci_low:Q", scale=chart.scale(whole["mean"])), y2="ci_high:Q", color=chart.look(whole)["color"]
    )
    line = base.mark_line(point=True).encode(x=x, y=y, tooltip=tips, **chart.look(whole))
    first = frames.fixed(whole, [axis])
    first = first if words else first.sort_values(axis, kind="stable")
    text = " ".join(_over(mine, str(o), axis, unit) for o, mine in first.groupby("observer", sort=False))
    return Chart(
        f"{title_of(metric, signal, '')} over {frames.label(axis)}",
        chart.spec(alt.layer(band, line), choices),
        text,
        "Bands: 95 % intervals." + chart.where(whole, [axis]),
    )


def time(part: pd.DataFrame, names: list[str], signal: str, unit: str, seed: int, at: str = "") -> Chart:
    """Return one run in time: the plant, the estimates, what has arrived and is held."""
    look = styles(names)
    series = list(dict.fromkeys(part.series))
    colours = [_of_series(s, look) for s in series]
    low, high = frames.room(part)
    ends = part[part.kind != "measured"].groupby("series", sort=False).value.last()
    part = part.assign(value=part.value.where(part.value.between(low - (high - low), high + (high - low))))
    wide = part[part.kind != "measured"]
    scale = alt.Scale(domain=series, range=colours)
    x = alt.X("t:Q", title="t [s]")
    y = alt.Y(
        "value:Q",
        title=f"{signal.replace('_', ' ')} [{unit}]",
        scale=alt.Scale(domain=[low, high], nice=False),
    )
    legend = alt.Legend(
        orient="bottom", columns=3, symbolType="stroke", symbolStrokeWidth=3, symbolSize=300, symbolOpacity=1
    )
    colour = alt.Color("series:N", title=None, scale=scale, legend=legend)
    dashes = [list(look[s].dash) or [1, 0] if s in look else [1, 0] for s in series]
    dash = alt.StrokeDash("series:N", title=None, scale=alt.Scale(domain=series, range=dashes), legend=legend)
    thick = alt.condition("datum.kind == 'estimate'", alt.value(1.4), alt.value(5))
    faint = alt.condition("datum.kind == 'estimate'", alt.value(1.0), alt.value(0.6))
    data = chart.rounded(wide[["series", "kind", "t", "value"]])
    lines = (
        alt.Chart(data)
        .mark_line(clip=True)
        .encode(
            x=x, y=y, color=colour, strokeDash=dash, strokeWidth=thick, opacity=faint, tooltip=["series", "t", "value"]
        )
    )
    held = part[part.kind == "measured"]
    layers = [lines]
    if len(held):
        steps = alt.Chart(chart.rounded(held[["series", "t", "value"]].dropna())).mark_line(
            interpolate="step-after", strokeWidth=1, clip=True
        )
        layers.insert(0, steps.encode(x=x, y=y, color=colour))
    text = "At the end: " + ", ".join(f"{o} {v:.4g}" for o, v in ends.items()) + f" {unit}."
    return Chart(
        f"One run in time (seed {seed})",
        chart.spec(alt.layer(*layers)),
        text,
        "What leaves the plant's range is cut off." + at,
    )


def _over(mine: pd.DataFrame, observer: str, axis: str, unit: str) -> str:
    a, b = mine.iloc[0], mine.iloc[-1]
    return f"{observer}: {_said(a['mean'], unit)} at {a[axis]} to {_said(b['mean'], unit)} at {b[axis]}."


def _said(value: float, unit: str) -> str:
    return f"{value:.3g} {unit}" if np.isfinite(value) else "(diverged in every run)"


def _of_series(series: str, look: dict[str, Any]) -> str:
    name = series.removeprefix("plant under ")
    return look[name].colour if name in look else OTHERS.get(series, MEASURED)
