"""Figures of a result for notebooks, papers and the report: functions that return a matplotlib Figure.

    result = pcbench.run("noise-map.toml")           # or pcbench.open_result("results/noise-map")
    plots.distributions(result, metric="steady_rmse")
    plots.save(plots.curves(result, paper=plots.JOURNALS["ieee"]), "curve.pdf")

Without `scenario` and `signal`, a figure shows the first scenario and its first main signal. An axis of the study that a figure
does not show has its first value, or the value in `at`. Intervals are 95 %. Errors are e = x - xhat. `paper` sets the column
width [inches], the font and its size; `JOURNALS` has a paper for each journal. `plots.save` writes SVG, PDF and PNG; text stays
text in SVG and PDF.
"""

from pcbench.plots.calibration_curves import calibration
from pcbench.plots.errors_over_time import error_bands
from pcbench.plots.fault_tolerance import bearing
from pcbench.plots.gains import fair, trade_off
from pcbench.plots.labels import save
from pcbench.plots.layout import JOURNALS, Paper
from pcbench.plots.lines import convergence, cost, curves, distributions, quantiles
from pcbench.plots.maps import divergence, heatmaps, winners
from pcbench.plots.paired_ratios import ratios
from pcbench.plots.palette import styles
from pcbench.plots.performance_profiles import profiles
from pcbench.plots.regret_matrix import regrets
from pcbench.plots.scenario_errors import scenarios
from pcbench.plots.time_series import delay_profiles, delays, nees, time

__all__ = ["JOURNALS", "Paper", "bearing", "calibration", "convergence", "cost", "curves", "delay_profiles", "delays",
           "distributions", "divergence", "error_bands", "fair", "heatmaps", "nees", "profiles", "quantiles", "ratios",
           "regrets", "save", "scenarios", "styles", "time", "trade_off", "winners"]  # fmt: skip
