"""What pictures say: how a metric is named with its unit, and what a picture is of."""

from math import isfinite
from typing import Any

import pandas as pd

from pcbench.dataset.result import Result
from pcbench.plots import frames
from pcbench.plots.scales import number

LTI = "lti"  # the scenario of a table [lti]
WORDS = {
    "mae": "mean |error|",
    "rmse": "rms error",
    "mse": "mean square error",
    "max_abs_error": "largest |error|",
    "final_error": "error at the end",
    "tracking_rmse": "rms tracking error",
}


def title_of(metric: str, signal: str, unit: str) -> str:
    """Return a metric of a signal as an axis' title, with its unit."""
    return named(metric, signal) + (f" [{unit}]" if unit not in ("", "1") else "")


def named(metric: str, signal: str) -> str:
    """Return a metric of a signal in words."""
    late, plain = metric.startswith("steady_"), metric.removeprefix("steady_").removeprefix("pooled_")
    pooled = ", all runs together" if "pooled" in metric else ""
    words = WORDS.get(plain, plain.replace("_", " "))
    return f"{words} of {signal.replace('_', ' ')}" + (" in the tail" if late else "") + pooled


def unit_of(part: pd.DataFrame) -> str:
    """Return the unit of a frame's rows."""
    return str(part.unit.iloc[0]) if len(part) else ""


def title_of_scenario(result: Result, scenario: str) -> str:
    """Return what a scenario is called: one that a study's own plant makes, by the study's name."""
    return result.study.name if scenario == LTI else scenario


def about(result: Result, part: pd.DataFrame, at: dict[str, Any]) -> str:
    """Return what a picture is of: the scenario, the values of the axes it does not show, how many runs."""
    many = int((part.n + part.diverged).max())
    said = [title_of_scenario(result, part.scenario.iloc[0]), *(frames.said(axis, value) for axis, value in at.items())]
    return ", ".join([*said, f"{many:,} runs"] if many > 1 else said)


def times(value: float) -> str:
    """Return how many times larger something is: with two digits, or as many as tell it from 1."""
    if not isfinite(value):
        return "∞"
    if 1 < value < 1.1:
        return f"{value:.3f}×" if value < 1.01 else f"{value:.2f}×"
    return f"{number(float(f'{value:.2g}' if value < 100 else f'{value:.1g}'))}×"
