"""What every figure of matplotlib has in common: its size, its frame, its legend, and how a metric is named with its unit."""

from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

WIDTH, HEIGHT = 6.4, 3.8  # inches
UNITLESS = ("efficiency", "divergence", "unsettled")
WORDS = {"mae": "mean |error|", "rmse": "rms error", "mse": "mean square error", "peak": "largest |error|"}


def sheet(rows: int = 1, columns: int = 1, width: float = WIDTH, height: float = HEIGHT) -> tuple[Figure, Any]:
    """Return a figure with its axes [rows, columns], that no window shows."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def dress(ax: Axes, x: str, y: str, title: str = "") -> None:
    """Give axes their titles, and a light grid."""
    ax.set_xlabel(x)
    ax.set_ylabel(y)
    ax.set_title(title, loc="left", fontsize=10)
    ax.grid(True, color="#DDDDDD", linewidth=0.6)
    ax.set_axisbelow(True)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)


def legend(figure: Figure, ax: Axes) -> None:
    """Put one legend beside the axes, where it covers nothing."""
    handles, labels = ax.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside right upper", frameon=False, fontsize=8)


def title_of(metric: str, signal: str, unit: str) -> str:
    """Return a metric of a signal as an axis' title, with its unit."""
    late, plain = metric.startswith("tail_"), metric.removeprefix("tail_").removeprefix("pooled_")
    words = f"{WORDS.get(plain, plain.replace('_', ' '))} of {signal.replace('_', ' ')}" + (
        " in the tail" if late else ""
    )
    return words + (f" [{unit}]" if unit and metric not in UNITLESS else "")


def unit_of(part: pd.DataFrame) -> str:
    """Return the unit of a frame's rows."""
    return str(part.unit.iloc[0]) if len(part) else ""
