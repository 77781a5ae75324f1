"""Table 2, entry by entry: largest and mean absolute errors over 6 <= t <= 10 s of two observers under two unknown inputs.

Verdicts: `digits`, the value rounds to the print; `close`, within 1e-3 of it or one unit of its last digit; `band`, the print
lies between the least and the largest of 64 runs from x(0) (1 + 1e-6 N(0, 1)), since PIO's smallest errors are chatter of the
integration; `differs`. Source: Peng, Appl. Sci. 2017, 7(1), 67, Table 2; what it leaves unsaid is in `scenarios.arm`.
"""

from typing import Any

import pandas as pd

from pcbench import bench
from pcbench.reproduce.claim import Claim

CLOSE = 1e-3
STARTS = 64
SIGNALS = {
    "x1": "link_angle",
    "x2": "link_velocity",
    "x3": "motor_angle",
    "x4": "motor_velocity",
    "d": "input",
}
INPUTS = {"d1": "arm/sine", "d2": "arm/sawtooth"}
METRICS = {"max": "tail_peak", "mean": "tail_mae"}
PRINTED = {
    ("d1", "smo", "max"): "5.3352e-4 .0027 5.2854e-6 5.1507e-4 .0170",
    ("d1", "smo", "mean"): "1.4163e-4 .0012 2.1532e-6 1.8376e-4 .0077",
    ("d2", "smo", "max"): "5.3181e-4 .0032 5.8621e-6 5.1517e-4 .3389",
    ("d2", "smo", "mean"): "1.4173e-4 .0013 1.9428e-6 1.8237e-4 .0068",
    ("d1", "pio", "max"): "5.3233e-4 1.0138e-6 1.3686e-6 5.1937e-4 .0048",
    ("d1", "pio", "mean"): "1.4084e-4 9.3354e-8 2.1170e-7 1.8101e-4 .0017",
    ("d2", "pio", "max"): "5.3245e-4 .0103 8.7710e-7 5.1956e-4 .3517",
    ("d2", "pio", "mean"): "1.4084e-4 8.6742e-4 1.4003e-7 1.8100e-4 .0126",
}


def claims() -> list[Claim]:
    """Return the 40 entries of Table 2."""
    scenarios = list(INPUTS.values())
    one = bench.run({"name": "table-2", "scenarios": scenarios}, observers=["smo", "pio"], seeds=1).runs
    near = {"scenario": {"start_spread": 1e-6}}
    many = bench.run({"name": "starts", "scenarios": scenarios}, observers=["pio"], seeds=STARTS, options=near).runs
    out = []
    for (force, observer, what), text in PRINTED.items():
        for (x, signal), printed in zip(SIGNALS.items(), text.split(), strict=True):
            (value,) = _column(one, force, observer, signal, what)
            others = _column(many, force, observer, signal, what)
            low, high = (others.min(), others.max()) if len(others) else (value, value)
            verdict = judge(printed, value, min(low, value), max(high, value))
            shown = f"{value:.6g}" + (f"; nearby {low:.3g} to {high:.3g}" if verdict in ("band", "differs") else "")
            out.append(Claim(f"Table 2, {force} {observer.upper()} {what} {x}", printed, shown, verdict))
    return out


def judge(printed: str, value: float, low: float, high: float) -> str:
    """Return the verdict on a printed decimal number."""
    digits, _, exponent = printed.partition("e")
    unit = 10.0 ** (int(exponent or 0) - len(digits.partition(".")[2]))
    off = abs(value - float(printed))
    if off <= 0.5 * unit * (1 + 1e-9):
        return "digits"
    if off <= max(CLOSE * float(printed), unit * (1 + 1e-9)):
        return "close"
    return "band" if low <= float(printed) <= high else "differs"


def _column(runs: pd.DataFrame, force: str, observer: str, signal: str, what: str) -> Any:
    mine = (runs.scenario == INPUTS[force]) & (runs.observer == observer) & (runs.signal == signal)
    return runs.loc[mine, METRICS[what]].to_numpy()
