"""Errors relative to model-only, for a study that varies its axes one at a time."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.labels import about, describe_metric
from pcbench.plots.layout import PAPER, Paper, is_positive, set_range, set_values, sheet
from pcbench.plots.palette import SOFT, styles

MODEL_ONLY = "model-only"
BESIDE = 2  # panels


def ratio_to_model_only(result: Result, scenario: str, signal: str, metric: str) -> pd.DataFrame:
    """Return axis, value, observer, part: the mean of a metric divided by that of model-only, for numeric axes."""
    stats = frames.rows(result, scenario, signal, metric)
    alone = stats[stats.observer == MODEL_ONLY].set_index("cell")["mean"]
    nominal, out = frames.values_at(stats, int(stats.cell.min())), []
    for axis in frames.varying_axes(stats):
        part = frames.fix_axes(stats, [axis], {a: v for a, v in nominal.items() if a != axis})
        if any(isinstance(value, str) for value in part[axis]):
            continue
        rows = part[part.observer != MODEL_ONLY]
        ratio = rows["mean"].to_numpy() / alone.loc[rows.cell].to_numpy()
        out.append(pd.DataFrame({"axis": axis, "value": rows[axis], "observer": rows.observer, "part": ratio}))
    return pd.concat(out, ignore_index=True) if out else pd.DataFrame(columns=["axis", "value", "observer", "part"])


def tolerances(parts: pd.DataFrame) -> pd.DataFrame:
    """Return axis, observer, most: the value up to which an observer is better than model-only, from the first value on.

    It is interpolated linearly between two values. It is infinite, with the sign of the values, if the observer is better at
    all values, and NaN if it is worse at the first one. A mean that is not finite (diverged runs) counts as worse.
    """
    out = []
    for (axis, observer), group in parts.groupby(["axis", "observer"], sort=False):
        nominal = group.value.iloc[0]
        for sign in (1, -1):
            side = group[sign * (group.value - nominal) >= 0].sort_values("value", ascending=sign > 0, kind="stable")
            if len(side) > 1:
                out.append((axis, observer, _crossing(side.value.to_numpy(float), side.part.to_numpy(float), sign)))
    return pd.DataFrame(out, columns=["axis", "observer", "most"])


def _crossing(value: np.ndarray, part: np.ndarray, sign: int) -> float:
    worse = np.flatnonzero(~(part <= 1))
    if not len(worse):
        return sign * float("inf")
    i = int(worse[0])
    if i == 0:
        return float("nan")
    if not np.isfinite(part[i]) or not np.isfinite(value[i - 1]):
        return float(value[i - 1])
    return float(value[i - 1] + (1 - part[i - 1]) / (part[i] - part[i - 1]) * (value[i] - value[i - 1]))


def bearing(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    paper: Paper = PAPER,
) -> Figure:
    """Return the errors of observers divided by those of model-only, one panel per axis; above 1, model-only is better.

    Raises UserError unless the study has `vary = "one-at-a-time"` and the observer `model-only`.
    """
    stats = frames.rows(result, scenario, signal, metric)
    if result.study.vary != "one-at-a-time" or MODEL_ONLY not in set(stats.observer):
        raise UserError(
            f'bearing of {result.study.name}: got vary = "{result.study.vary}" and observers '
            f'{", ".join(dict.fromkeys(stats.observer))}, expected vary = "one-at-a-time" and {MODEL_ONLY} among them.'
        )
    parts = ratio_to_model_only(result, stats.scenario.iloc[0], stats.signal.iloc[0], metric)
    look = styles(parts.observer)
    axes = list(dict.fromkeys(parts.axis))
    columns = min(BESIDE, len(axes))
    words = f"{describe_metric(metric, stats.signal.iloc[0])} divided by that of {MODEL_ONLY} [-]"
    with sheet(paper, f"{words}: {about(result, stats, {})}", len(axes), columns, height=1.1) as (figure, panels):
        for ax, name in zip(panels, axes, strict=True):
            rows = parts[parts.axis == name]
            place = set_values(ax, "x", list(dict.fromkeys(rows.value)), frames.INFINITE.get(name, "∞"))
            rows = rows.assign(x=rows.value.map(place)).sort_values("x", kind="stable")
            set_range(ax, "y", [*parts.part, 1.0], is_positive(parts.part))
            ax.set_xlabel(frames.label(name, frames.axis_titles(result, stats)))
            ax.axhline(1.0, color=SOFT, linewidth=0.9)
            for observer, style in look.items():
                line = rows[rows.observer == observer]
                ax.plot(line.x, line.part, label=observer, color=style.colour, linestyle=style.line,
                        linewidth=1.0, marker=style.marker, markersize=3.5)  # fmt: skip
    return figure
