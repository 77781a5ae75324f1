"""Table 2, entry by entry: largest and mean absolute errors over 6 <= t <= 10 s of two observers under two unknown inputs.

How an entry comes out: `digits`, the value rounds to the print; `close`, within 1e-3 of it or one unit of its last digit;
`band`, the print lies between the least and the largest of 64 runs from x(0) (1 + 1e-6 N(0, 1)), since PIO's smallest errors
are chatter of the integration; `differs`. All but the last are reproduced.
Source: Peng, Appl. Sci. 2017, 7(1), 67, Table 2; what it leaves unsaid is in `scenarios.arm`.
"""

from functools import cache
from typing import Any

import pandas as pd

from pcbench import api
from pcbench.papers.claim import FALSE, REPRODUCED, Claim, rounds_to, unit

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
METRICS = {"max": "steady_max_abs_error", "mean": "steady_mae"}
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

HOW = {
    "digits": "to the digit",
    "close": "within 1e-3, or one unit of the last digit",
    "band": "chatter of the integration",
    "differs": "another number",
}
AMONG = f"the print lies among {STARTS} runs from starts 1e-6 apart: chatter of the integration"
STEADY = {"digits": HOW["close"], "close": HOW["close"], "band": AMONG}  # PIO's last digits are those of its chatter


def claims() -> list[Claim]:
    """Return the 40 entries of Table 2."""
    scenarios = list(INPUTS.values())
    near = {"scenario": {"initial_spread": 1e-6}}
    many = api.run({"name": "starts", "scenarios": scenarios}, observers=["pio"], seeds=STARTS, options=near).runs
    out = []
    for (force, observer, what), text in PRINTED.items():
        for (x, signal), printed in zip(SIGNALS.items(), text.split(), strict=True):
            value = entry(force, observer, x, what)
            others = _column(many, force, observer, signal, what)
            low, high = (others.min(), others.max()) if len(others) else (value, value)
            how = judge(printed, value, min(low, value), max(high, value))
            nearby = f"; {STARTS} starts nearby {low:.3g} to {high:.3g}" if how in ("band", "differs") else ""
            verdict, rough = FALSE if how == "differs" else REPRODUCED, observer == "pio" and how != "differs"
            claim = f"Table 2, {force} {observer.upper()} {what} {x}"
            steady = STEADY[how] if rough else f"{value:.1g}" if how == "differs" else ""
            out.append(Claim(claim, printed, f"{value:.6g}, {HOW[how]}{nearby}", verdict, steady))
    return out


@cache
def nominal() -> pd.DataFrame:
    """Return the runs that Table 2 is about, one of each."""
    study = {"name": "table-2", "scenarios": list(INPUTS.values())}
    return api.run(study, observers=["smo", "pio"], seeds=1).runs


def entry(force: str, observer: str, x: str, what: str) -> float:
    """Return an entry of Table 2 as it comes out."""
    (value,) = _column(nominal(), force, observer, SIGNALS[x], what)
    return float(value)


def judge(printed: str, value: float, low: float, high: float) -> str:
    """Return how closely a printed decimal number comes out."""
    if rounds_to(printed, value):
        return "digits"
    if abs(value - float(printed)) <= max(CLOSE * float(printed), unit(printed) * (1 + 1e-9)):
        return "close"
    return "band" if low <= float(printed) <= high else "differs"


def _column(runs: pd.DataFrame, force: str, observer: str, signal: str, what: str) -> Any:
    mine = (runs.scenario == INPUTS[force]) & (runs.observer == observer) & (runs.signal == signal)
    return runs.loc[mine, METRICS[what]].to_numpy()
