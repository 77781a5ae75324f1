"""The mobile cart: every printed gain, the claims of section 6, and what does not reproduce.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017). The paper prints gains and claims in words; its
error values stand only in figures. All numbers below are computed anew.
"""

import numpy as np

from pcbench import bench
from pcbench.reproduce.claim import Claim, digits, statement
from pcbench.scenarios import SCENARIOS
from pcbench.study import Study
from pcbench.synthesis import riccati

SEEDS = 256
KFBO = {
    "cart/nominal": (("0.0082", "0.0083", "1.0329"), ("2.0405", "2.0818")),
    "cart/slow": (("0.0712", "0.0085", "1.0330"), ("0.2374", "0.0282")),
}
SECTIONS = {"6.1": "cart/nominal", "6.2 Gaussian": "cart/gaussian", "6.2 white": "cart/white", "6.3": "cart/drift", "6.4": "cart/slow"}


def claims() -> list[Claim]:
    """Return printed against reproduced, for `pcbench reproduce cart`."""
    return [*_gains(), *_two_periods(), *_ordering(), *_misprints()]


def _gains() -> list[Claim]:
    out = []
    for scenario, (P_printed, K_printed) in KFBO.items():
        numbers = bench.design(scenario, "kfbo").certificate.numbers
        P, K = numbers["P"], numbers["K"]
        R = SCENARIOS[scenario].options["kfbo"]["R"]
        for name, printed, value in zip(("P11", "P12", "P22"), P_printed, (P[0, 0], P[0, 1], P[1, 1]), strict=True):
            out.append(digits(f"KFBO {name} at R = {R:g} (27)", printed, value))
        for name, printed, value in zip(("K1", "K2"), K_printed, K[:, 0], strict=True):
            out.append(digits(f"KFBO {name} at R = {R:g} (26)", printed, value))
    for scenario in ("cart/nominal", "cart/slow"):
        L = bench.design(scenario, "pccebo").certificate.numbers["L"]
        te = SCENARIOS[scenario].sampling_period[0]
        for i, printed in enumerate(("1.0000", "0.0000")):
            out.append(digits(f"PCCEBO L{i + 1} at te = {te:g} s (23)", printed, L[i, 0]))
    return out


def _two_periods() -> list[Claim]:
    out = []
    for scenario in ("cart/nominal", "cart/slow"):
        d = bench.trace(scenario, "pccebo")
        te = SCENARIOS[scenario].sampling_period[0]
        e = (d["position"] - d["pccebo.position"]).abs()[d["t"] >= 2 * te - 1e-9].max()
        out.append(
            statement(f"PCCEBO errors zero after two periods, te = {te:g} s", "zero", f"|e| < {e:.1e} m from {2 * te:g} s on", e < 1e-10)
        )
    return out


def _ordering() -> list[Claim]:
    names = list(SECTIONS.values())
    result = bench.run(Study(name="ordering", scenarios=names, observers=["pccebo", "kfbo"], seeds=SEEDS))
    out = []
    for section, scenario in SECTIONS.items():
        for metric in ("mae", "rmse"):
            row = result.pairs.query("scenario == @scenario and signal == 'position' and metric == @metric").iloc[0]
            means = result.stats.query("scenario == @scenario and signal == 'position' and metric == @metric")
            a, b = means["mean"]
            text = f"{a:.4g} < {b:.4g} m in {row.prob_a_better:.0%} of {int(row.n)} seeds"
            holds = row.mean_diff < 0 and row.prob_a_better == 1.0
            out.append(statement(f"{section}: PCCEBO better in position {metric.upper()}, 10 s", "smaller", text, holds))
    out.append(_steady_state())
    return out


def _steady_state() -> Claim:
    """Under noise the order turns once the start is forgotten: KFBO's stationary error against PCCEBO's."""
    result = bench.run(
        Study(name="tail", scenarios=["cart/gaussian"], observers=["pccebo", "kfbo", "dkf"], seeds=SEEDS,
              options={"scenario": {"random_start": True}})  # fmt: skip
    )
    rows = result.stats.query("signal == 'position' and metric == 'efficiency'")
    worse = [f"{o} {1 / e:.1f}" for o, e in zip(rows.observer, rows["mean"], strict=True)]
    return statement(
        "6.2: PCCEBO is effective under noise (tail rms from 3 s, times the best possible)",
        "better responses",
        ", ".join(worse),
        bool(rows["mean"].iloc[0] > 0.5),
    )


def _misprints() -> list[Claim]:
    model = bench.sweep.setting(bench.cells(Study(name="cart", scenarios=["cart/nominal"]), "cart/nominal")[0]).model
    asprinted = riccati.continuous(model, 0.001 * np.eye(2), 0.004 * np.eye(1), "reproduce cart")
    found = bench.design("cart/nominal", "kfbo").certificate.numbers
    P, K = found["P"], found["K"]
    literal = (P @ model.C.T * 0.004)[:, 0]
    margin = bench.design("cart/nominal", "pccebo").certificate.margin
    return [
        Claim("Q = 0.001 I gives the printed K", "[2.0405, 2.0818]", _row(asprinted.K[:, 0]), "does not reproduce"),
        Claim("Q = 0.002 B B' gives the printed K", "[2.0405, 2.0818]", _row(K[:, 0]), "reproduced"),
        Claim("(26) K = P C' R", "[2.0405, 2.0818]", _row(literal) + "; P C' R^-1 gives the print", "misprint"),
        Claim("P = 4.9499 I (23)", "4.9499 I", f"any multiple of I, here I with margin {margin:.3g}: only a scale", "does not reproduce"),
    ]


def _row(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{v:.4g}" for v in values) + "]"
