"""Figures of a result, for notebooks and papers: each function returns a matplotlib Figure and shows nothing by itself.

    result = pcbench.run("noise-map.toml")           # or pcbench.opened("results/noise-map")
    plots.distributions(result, metric="tail_rmse")

`scenario` and `signal` may be left out: then the first scenario and its first headline signal are meant. Axes of a study that a
figure does not show stand at their first value, or where `at` says. Intervals are 95 %. Errors are e = x - xhat.
What each shows is found in `frames`; the page of `report` draws the same with Vega.
"""

from pcbench.plots.gains import fair, trade_off
from pcbench.plots.lines import curves, distributions, time
from pcbench.plots.maps import divergence, heatmaps, winners
from pcbench.plots.palette import styles

__all__ = ["curves", "distributions", "divergence", "fair", "heatmaps", "styles", "time", "trade_off", "winners"]
