"""The report's maps over two axes, and what gains are worth."""

from typing import Any

import altair as alt
import numpy as np
import pandas as pd

from pcbench.plots import frames
from pcbench.plots.palette import styles
from pcbench.plots.sheet import title_of, unit_of
from pcbench.report import chart
from pcbench.report.chart import Chart

STEP, WIDE = 56, 3  # pixels of a small map's cell, and how many maps stand side by side
PLAIN = alt.Axis(grid=False, labelAngle=0)
WORDS = {"paper": "as printed", "design": "by design", "tuned": "tuned"}


def heatmap(whole: pd.DataFrame, x: str, y: str, metric: str) -> Chart:
    """Return maps of a metric's mean over two axes, one for each observer."""
    signal, unit = whole.signal.iloc[0], unit_of(whole)
    share = metric == "divergence"
    data = chart.plain(whole, [x, y, *chart.others(whole, x, y)], ["observer", "mean", "ci_low", "ci_high"])
    if share:
        data = data.assign(**{c: 100 * data[c] for c in ("mean", "ci_low", "ci_high")})
    title = f"{metric} [% of runs]" if share else title_of(metric, signal, unit)
    scale = (
        alt.Scale(scheme="reds", domain=[0, 100])
        if share
        else chart.scale(data["mean"], scheme="viridis", reverse=True)
    )
    base, choices = chart.choosing(alt.Chart(chart.rounded(data)), whole, chart.others(whole, x, y))
    cells = base.mark_rect().encode(
        **_axes(whole, x, y),
        color=alt.Color(
            "mean:Q", title=title, scale=scale, legend=alt.Legend(orient="bottom", gradientLength=240, titleLimit=600)
        ),
        tooltip=[
            "observer",
            chart.safe(x),
            chart.safe(y),
            *(alt.Tooltip(f"{c}:Q", format=".4g") for c in ("mean", "ci_low", "ci_high")),
        ],
    )
    small = cells.properties(width=alt.Step(STEP), height=alt.Step(30)).facet(
        alt.Facet("observer:N", title=None, sort=chart.names(whole)), columns=WIDE
    )
    first = frames.fixed(whole, [x, y])
    means = first.groupby("observer", sort=False)["mean"]
    factor = 100 if share else 1
    ranges = [(o, factor * m.min(), factor * m.max()) for o, m in means]
    said = [f"{o} {a:.3g} to {b:.3g}" if np.isfinite(a) else f"{o} diverged in every run" for o, a, b in ranges]
    text = f"Ranges [{'%' if share else unit}]: " + ", ".join(said) + "."
    note = f"Upwards: {frames.label(y)}." + chart.where(whole, [x, y])
    what = "Diverged runs" if share else title_of(metric, signal, "")
    return Chart(f"{what} over {frames.label(x)} and {frames.label(y)}", chart.spec(small, choices), text, note)


def _axes(whole: pd.DataFrame, x: str, y: str) -> dict[str, Any]:
    """Both axes of a map; the upper one is named in its caption, for small maps have no room for it."""
    up = chart.order(whole, y)
    return {
        "x": alt.X(f"{chart.safe(x)}:O", title=frames.label(x), sort=chart.order(whole, x), axis=PLAIN),
        "y": alt.Y(
            f"{chart.safe(y)}:O", title=None, sort=up[::-1] if isinstance(up, list) else "descending", axis=PLAIN
        ),
    }


def winners(whole: pd.DataFrame, won: pd.DataFrame, x: str, y: str, metric: str) -> Chart:
    """Return the map of who wins over two axes; ties are blank."""
    signal = whole.signal.iloc[0]
    others = chart.others(whole, x, y)
    base, choices = chart.choosing(
        alt.Chart(chart.rounded(chart.plain(won, [x, y, *others], ["winner", "mean", "text"]))), whole, others
    )
    look, names = styles(whole.observer), [n for n in chart.names(whole) if n in set(won.winner)]
    colour = alt.Color(
        "winner:N",
        title="winner",
        scale=alt.Scale(domain=["", *names], range=["#FFFFFF", *(look[n].colour for n in names)]),
        legend=alt.Legend(values=names, orient="bottom") if names else None,
    )
    axes = _axes(whole, x, y)
    tips = ["text", chart.safe(x), chart.safe(y), alt.Tooltip("mean:Q", format=".4g", title="its mean")]
    cells = base.mark_rect(stroke="#CCCCCC").encode(color=colour, tooltip=tips, **axes)
    said = base.mark_text(fontSize=10).encode(
        text="text", color=alt.condition("datum.winner == ''", alt.value("#777777"), alt.value("#FFFFFF")), **axes
    )
    counted = won.text.value_counts()
    text = f"Of {len(won)} cells: " + ", ".join(f"{name} {n}" for name, n in counted.items()) + "."
    both = alt.layer(cells, said).properties(width=alt.Step(96), height=alt.Step(34))
    note = f"Blank: the best is not surely better than every other (5 %, Holm). Upwards: {frames.label(y)}."
    return Chart(f"Who wins: least {title_of(metric, signal, '')}", chart.spec(both, choices), text, note)


def fair(table: pd.DataFrame) -> Chart:
    """Return what gains as printed, by design and tuned are worth on held-out runs, beside training runs."""
    first, names = table.iloc[0], list(dict.fromkeys(table.observer))
    look = styles(names)
    data = frames.with_ends(table)
    columns = ["observer", "tuning", "training", "held_out", "low", "high", "efficiency"]
    base = alt.Chart(chart.rounded(data[columns]))
    x = alt.X("tuning:N", title=None, sort=list(WORDS))
    y = alt.Y("held_out:Q", title=title_of(first.metric, first.signal, first.unit), scale=chart.scale(data.held_out))
    colour = alt.Color("observer:N", scale=alt.Scale(domain=names, range=[look[n].colour for n in names]), legend=None)
    tips = [
        "observer",
        "tuning",
        *(alt.Tooltip(f"{c}:Q", format=".4g") for c in ("training", "held_out", "efficiency")),
    ]
    rule = base.mark_rule().encode(x=x, y=alt.Y("low:Q", scale=chart.scale(data.held_out)), y2="high:Q", color=colour)
    dots = base.mark_point(filled=True, size=70).encode(x=x, y=y, color=colour, tooltip=tips)
    rings = base.mark_point(size=150).encode(x=x, y=alt.Y("training:Q", scale=chart.scale(data.held_out)), color=colour)
    whole = (
        alt.layer(rule, dots, rings)
        .properties(width=110, height=chart.HEIGHT)
        .facet(alt.Facet("observer:N", title=None, sort=names), columns=5)
    )
    text = (
        ", ".join(
            f"{r['observer']} {WORDS[r['tuning']]} {r['held_out']:.3g} {first.unit}" for r in table.to_dict("records")
        )
        + "."
    )
    return Chart(
        "Gains as printed, by design and tuned",
        chart.spec(whole),
        text,
        "Dots: held-out runs with 95 % intervals; rings: training runs.",
    )
