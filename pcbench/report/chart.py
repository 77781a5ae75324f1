"""What all charts of the report have in common: Vega-Lite specifications with titles, units, tooltips, and a sentence in words.

Axes of a study that a chart does not show can be chosen below it; on paper they stand at their first value.
"""

from typing import Any, NamedTuple

import altair as alt
import numpy as np
import pandas as pd

from pcbench.plots import frames
from pcbench.plots.palette import styles

HEIGHT = 260  # pixels
DIGITS = 4  # that are kept of a number
alt.data_transformers.disable_max_rows()


class Chart(NamedTuple):
    """A chart with its words."""

    title: str
    spec: dict[str, Any]
    text: str  # what it shows, for those who do not see it
    note: str = ""  # how to read it


def names(whole: pd.DataFrame) -> list[str]:
    """Return the observers in the order of the study."""
    return list(dict.fromkeys(whole.observer))


def others(whole: pd.DataFrame, x: str, y: str) -> list[str]:
    """Return the axes that vary besides two."""
    return [name for name in frames.varying(whole) if name not in (x, y)]


def look(whole: pd.DataFrame) -> dict[str, Any]:
    """Return colour and dashes by observer, with one legend for both."""
    labels = names(whole)
    style = styles(labels)
    legend = alt.Legend(
        orient="bottom", columns=3, symbolType="stroke", symbolStrokeWidth=2.5, symbolSize=300, symbolOpacity=1
    )
    colours = alt.Scale(domain=labels, range=[style[n].colour for n in labels])
    dashes = alt.Scale(domain=labels, range=[list(style[n].dash) or [1, 0] for n in labels])
    return {
        "color": alt.Color("observer:N", title=None, scale=colours, legend=legend),
        "strokeDash": alt.StrokeDash("observer:N", title=None, scale=dashes, legend=legend),
    }


def choosing(chart: Any, whole: pd.DataFrame, others: list[str]) -> tuple[Any, list[Any]]:
    """The chart with a choice of the value of every other axis, the first chosen."""
    params = []
    for name in others:
        values = [word(v) for v in dict.fromkeys(whole[name])]
        param = alt.param(
            name=f"at_{safe(name)}",
            value=values[0],
            bind=alt.binding_select(options=values, name=f"{frames.label(name)} "),
        )
        params.append(param)
        chart = chart.transform_filter(f"datum.{safe(name)} == at_{safe(name)}")
    return chart, params


def plain(part: pd.DataFrame, axes: list[str], columns: list[str]) -> pd.DataFrame:
    """The columns a chart needs, axes under names that Vega can read."""
    out = part[[*axes, *columns]].copy()
    for name in axes:
        out[name] = [word(v) for v in out[name]]
    return out.rename(columns={name: safe(name) for name in axes})


def order(part: pd.DataFrame, axis: str) -> Any:
    """Return the order of an axis' values: numbers as numbers, words as the study has them."""
    values = [word(v) for v in dict.fromkeys(part[axis])]
    return values if any(isinstance(v, str) for v in values) else "ascending"


def where(whole: pd.DataFrame, free: list[str], how: str = "The words are of") -> str:
    """Return as a sentence at which values of the other axes a text holds; empty where none varies."""
    first = frames.fixed(whole, free).iloc[0]
    said = ", ".join(f"{frames.label(a)} {word(first[a])}" for a in frames.varying(whole) if a not in free)
    return f" {how} {said}." if said else ""


def word(value: Any) -> Any:
    """Return an axis' value as a chart says it; "own" where it is the scenario's own."""
    return "own" if value is None or value != value else value


def safe(axis: str) -> str:
    """Return an axis' name without what Vega takes for a path."""
    return axis.replace(".", "_")


def rounded(data: pd.DataFrame) -> pd.DataFrame:
    """Numbers with as many digits as a picture shows; what is not finite is left out by Vega as null."""
    out = data.copy()
    for name in out.columns:
        if out[name].dtype.kind == "f":
            out[name] = [float(f"{v:.{DIGITS}g}") if np.isfinite(v) else None for v in out[name]]
    return out


def scale(values: pd.Series, **more: Any) -> Any:
    """Return a scale: logarithmic where values are `frames.wide`."""
    return alt.Scale(type="log", **more) if frames.wide(values) else alt.Scale(zero=False, nice=True, **more)


def spec(chart: Any, params: list[Any] | None = None) -> dict[str, Any]:
    """Return a chart's specification, as wide as the page unless it is of small maps."""
    for param in params or []:
        chart = chart.add_params(param)
    spec: dict[str, Any] = chart.to_dict()
    if "facet" not in spec and "width" not in spec:
        spec |= {"width": "container", "height": HEIGHT}
    return spec | {
        "config": spec.get("config", {})
        | {"font": "system-ui, sans-serif", "axis": {"grid": True, "gridColor": "#EEEEEE", "labelOverlap": "greedy"}}
    }
