"""Simulated means against exact ones: distances in standard errors, sorted, over the normal quantiles they should have."""

import numpy as np
from matplotlib.figure import Figure
from scipy.special import ndtri

from pcbench.dataset.validate_exact import Checked
from pcbench.errors import UserError
from pcbench.plots import scales
from pcbench.plots.canvas import PAPER, Paper, drawn_on
from pcbench.plots.layout import Panel, sheet
from pcbench.plots.lines import keys_of
from pcbench.plots.palette import SOFT


def quantiles(found: Checked, *, paper: Paper = PAPER) -> Figure:
    """Return the quantile plot of a comparison: points on the line are chance. Raises UserError where there is none to draw."""
    rows = found.rows[np.isfinite(found.rows.z)].sort_values("z", kind="stable")
    if rows.empty:
        raise UserError("plots.quantiles: got no mean that varies, expected some; run a study with noise.")
    expected = ndtri((np.arange(len(rows)) + 0.5) / len(rows))
    keys = keys_of(dict.fromkeys(sorted(rows.observer)))
    panel = Panel(
        scales.of(expected),
        scales.of([*rows.z, *expected]),
        "normal quantile",
        "(mean less exact) / standard error",
        2.4,
    )
    figure, (ax,) = sheet(paper, f"{len(rows):,} simulated means against exact values", [panel], keys)
    with drawn_on(paper):
        ends = [expected[0], expected[-1]]
        ax.plot(ends, ends, color=SOFT, linewidth=0.8, zorder=1)
        for key in keys:
            mine = (rows.observer == key.label).to_numpy()
            ax.scatter(expected[mine], rows.z[mine], s=7, color=key.style.colour, linewidths=0, label=key.label)
    return figure
