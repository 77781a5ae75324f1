"""Delays of a recorded log: over time, and how often each occurs."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.plots import scales
from pcbench.plots.canvas import PAPER, Paper, drawn_on
from pcbench.plots.layout import Panel, sheet
from pcbench.plots.lines import keys_of
from pcbench.recordings.survey import Survey

BINS = 40
DIGITS = 9  # of a second: what is less is rounding


def delays(table: pd.DataFrame, *, paper: Paper = PAPER) -> Figure:
    """Return the delays of every channel of a log over time, and their histogram; `table` is what `pcbench.info` returns.

    Of a long log an even selection of samples is drawn. Raises UserError where no sample ever arrived.
    """
    found: Survey = table.attrs["survey"]
    kept = {name: seen.delays.kept.round(DIGITS) for name, seen in found.channels.items() if len(seen.delays.kept)}
    if not kept:
        raise UserError(
            f"plots.delays: got a log {table.attrs['name']} in which nothing arrived, expected samples that did."
        )
    late = np.concatenate([each[:, 1] for each in kept.values()])
    keys, edges = keys_of(kept), edges_of(late)
    y = scales.of([late.min(), late.max(), edges[0], edges[-1]])
    shares = {name: np.histogram(each[:, 1], edges)[0] / len(each) for name, each in kept.items()}
    x = scales.linear(0.0, max(found.end - found.start, 1e-9))
    panels = [
        Panel(x, y, "time since the start [s]", "delay [s]"),
        Panel(y, scales.of([0.0, *np.concatenate(list(shares.values()))]), "delay [s]", "share of samples"),
    ]
    figure, (over_time, often) = sheet(paper, "", panels, keys if len(keys) > 1 else [])
    with drawn_on(paper):
        for key in keys:
            t, delay = kept[key.label].T
            over_time.scatter(t - found.start, delay, s=2, color=key.style.colour, linewidths=0, rasterized=True)
            often.stairs(shares[key.label], edges, color=key.style.colour, linewidth=1.2)
    return figure


def edges_of(late: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the edges of some BINS bars, each as wide as a whole number of the delays' smallest difference.

    Of delays in whole ticks every bar so holds as many ticks as any other: none is empty for its width alone.
    """
    values = np.unique(late)
    step = float(np.diff(values).min()) if len(values) > 1 else max(float(values[0]) / BINS, 1e-3)
    width = step * max(np.ceil((values[-1] - values[0]) / step / BINS), 1)
    first = values[0] - step / 2
    many = int(np.floor((values[-1] - first) / width)) + 1
    edges: NDArray[np.float64] = first + width * np.arange(many + 1)
    return edges
