"""The mobile cart: printed gains, the claims of section 6, the theorem and the integral, and what does not reproduce.

Source: Mohammed, Wang, Tian, Turk. J. Elec. Eng. & Comp. Sci. 25 (2017). The paper prints gains and states claims in words; its
error values appear only in figures. All numbers below are computed here. (7), (8a), (23), Remarks 1 and 3 are checked in NumPy,
sampled every te with d = te.
"""

from collections.abc import Iterator
from math import exp, expm1, pi

import numpy as np
import pandas as pd
from scipy.linalg import solve_discrete_lyapunov

from pcbench import api, planning
from pcbench.papers.claim import MISPRINT, OPEN, REPRODUCED, Claim, digits, report_finding, statement
from pcbench.planning import padding, run_local
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study import Study, options_of
from pcbench.study.grid import cell_of, cells
from pcbench.synthesis import riccati

SEEDS = 256
ZERO = 1e-10  # m
KFBO = {
    "cart/nominal": (("0.0082", "0.0083", "1.0329"), ("2.0405", "2.0818")),
    "cart/slow": (("0.0712", "0.0085", "1.0330"), ("0.2374", "0.0282")),
}
SECTIONS = {
    "6.1": "cart/nominal",
    "6.2 Gaussian": "cart/gaussian",
    "6.2 white": "cart/white",
    "6.3": "cart/drift",
    "6.4": "cart/slow",
}
LAM, B = 122.0, 355.0
C = np.array([[1.0, 0.0]])
SCALES = {"cart/nominal": "4.9499", "cart/slow": "4.9502"}


def claims() -> list[Claim]:
    """Return the claims for `pcbench reproduce cart`."""
    with config.float64():
        return [*_gains(), *theorem(), *_two_periods(), *_ordering(), *_under_noise(), *_misprints(), *_open()]


def _gains() -> Iterator[Claim]:
    for scenario, (P_printed, K_printed) in KFBO.items():
        numbers = api.design(scenario, "kfbo").certificate.numbers
        P, K = numbers["P"], numbers["K"]
        R = SCENARIOS[scenario].options["kfbo"]["R"]
        for name, printed, value in zip(("P11", "P12", "P22"), P_printed, (P[0, 0], P[0, 1], P[1, 1]), strict=True):
            yield digits(f"KFBO {name} at R = {R:g} (27)", printed, value)
        for name, printed, value in zip(("K1", "K2"), K_printed, K[:, 0], strict=True):
            yield digits(f"KFBO {name} at R = {R:g} (26)", printed, value)
    for scenario in ("cart/nominal", "cart/slow"):
        L = api.design(scenario, "pccebo").certificate.numbers["L"]
        te = SCENARIOS[scenario].sampling.sampling_period[0]
        for i, printed in enumerate(("1.0000", "0.0000")):
            yield digits(f"PCCEBO L{i + 1} at te = {te:g} s (23)", printed, L[i, 0])


def _two_periods() -> Iterator[Claim]:
    for scenario in ("cart/nominal", "cart/slow"):
        d = api.simulate(scenario, "pccebo")
        te = SCENARIOS[scenario].sampling.sampling_period[0]
        e = (d["position"] - d["pccebo.position"]).abs()[d["t"] >= 2 * te - 1e-9].max()
        yield statement(
            f"PCCEBO errors zero after two periods, te = {te:g} s",
            "zero",
            f"|e| < {ZERO:g} m from {2 * te:g} s on" if e < ZERO else f"|e| up to {e:.1e} m from {2 * te:g} s on",
            bool(e < ZERO),
        )


def _ordering() -> Iterator[Claim]:
    names = list(SECTIONS.values())
    result = api.run(Study(name="ordering", scenarios=names, observers=["pccebo", "kfbo"], seeds=SEEDS))
    stats, pairs = (t[t.signal == "position"].set_index(["scenario", "metric"]) for t in (result.stats, result.pairs))
    for section, scenario in SECTIONS.items():
        for metric in ("mae", "rmse"):
            row = pairs.loc[[(scenario, metric)]].iloc[0]
            mean = stats.loc[[(scenario, metric)]].set_index("observer")["mean"]
            seeds = f"{row.prob_a_better:.0%} of {int(row.n)} runs"
            text = f"pccebo {mean['pccebo']:.4g}, kfbo {mean['kfbo']:.4g} m; smaller in {seeds}"
            claim = f"{section}: PCCEBO better in position {metric.upper()}, 10 s"
            yield statement(claim, "smaller", text, row.mean_diff < 0 and row.prob_a_better == 1.0)


def _under_noise() -> Iterator[Claim]:
    """Yield claims under noise after the transient, where the order is reversed, and the ratio to the Kalman bound."""
    study = Study(name="noise", scenarios=["cart/gaussian"], observers=["pccebo", "kfbo", "kf"], seeds=SEEDS)
    late = SCENARIOS["cart/gaussian"].with_fields(
        duration=43.142, steady_start=40.0
    )  # the tail is one period of the sawtooth
    options = {name: options_of(study, late, name) for name in ("pccebo", "kfbo")}
    (run,) = run_local.execute(study, padding.fit([planning.draft(cell_of(late), options)]))
    a, b = (np.sqrt(run.results[name]["steady_mse"][0].mean()) for name in options)
    claim = "6.2 Gaussian: PCCEBO stays better (rms over a sawtooth period after 40 s)"
    stays = statement(claim, "better responses", f"pccebo {a:.2f} m, kfbo {b:.2f} m", bool(a < b))
    rows = api.run(study, options={"scenario": {"random_initial_state": True}}).stats.query("signal == 'position'")
    rows = rows[rows.metric == "rms_efficiency"]
    worse = ", ".join(f"{o} {1 / e:.1f}" for o, e in zip(rows.observer, rows["mean"], strict=True))
    yield stays
    yield report_finding("6.2 Gaussian: rms from 3 s on, divided by the least possible", worse)


def _misprints() -> Iterator[Claim]:
    model = planning.context_of(cells(Study(name="cart", scenarios=["cart/nominal"]), "cart/nominal")[0]).model
    solution = riccati.continuous(model, 0.001 * np.eye(2), 0.004 * np.eye(1), "reproduce cart")
    numbers = api.design("cart/nominal", "kfbo").certificate.numbers
    P, K = numbers["P"], numbers["K"]
    literal, off = (P @ model.C.T * 0.004)[:, 0], error_of_held_input()
    yield Claim("Q = 0.001 I gives the printed K", "[2.0405, 2.0818]", _row(solution.K[:, 0]), MISPRINT)
    yield Claim("Q = 0.002 B B' gives the printed K", "[2.0405, 2.0818]", _row(K[:, 0]), REPRODUCED)
    yield Claim("(26) K = P C' R", "[2.0405, 2.0818]", _row(literal) + "; P C' R^-1 gives the printed K", MISPRINT)
    yield Claim(
        "(7), (8a): Gamma u_(m-1), the input held over a period",
        "exact",
        f"position off by up to {off:.2f} m under the sawtooth, without decay; the integral of (6) is exact",
        MISPRINT,
    )


def _open() -> Iterator[Claim]:
    """Yield results that depend on details missing in the paper; velocity."""
    sections = ["cart/gaussian", "cart/gaussian-fast"]
    stats = api.run(Study(name="te", scenarios=sections, observers=["pccebo", "kfbo"], seeds=SEEDS)).stats
    fast = "; ".join(
        f"te = {SCENARIOS[s].sampling.sampling_period[0]:g} s: {_mae_text(stats, s, 'position')} m" for s in sections
    )
    signs = {sign: _drift_stats(sign) for sign in (1, -1)}
    drift = "; ".join(
        f"{'+' if sign > 0 else '-'}: {_mae_text(drift_stats, 'cart/drift', 'position')} m"
        for sign, drift_stats in signs.items()
    )
    calm = api.run(Study(name="calm", scenarios=["cart/nominal"], observers=["pccebo", "kfbo"], seeds=1)).stats
    difference = abs(np.subtract(*_values(calm, "cart/nominal", "velocity", "mae")))
    yield Claim("6.2 Gaussian: te with d = 0.6 s", "not printed", f"position MAE, {fast}", OPEN)
    yield Claim("6.3: operator before 20 sin 2t cos 2t in B21", "lost", f"position MAE, {drift}", OPEN)
    yield Claim("Figure 12: MAE and RMSE", "bars without numbers", "the orders are compared above", OPEN)
    yield statement(
        "6.1: PCCEBO better in velocity MAE",
        "better performance",
        f"{_mae_text(calm, 'cart/nominal', 'velocity')} m/s: equal"
        if difference < 1e-9
        else f"apart by {difference:.2g} m/s",
        bool(difference > 1e-9),
    )
    for metric in ("mae", "rmse"):
        calm_values, drift_values = (
            _values(s, n, "position", metric) for s, n in ((calm, "cart/nominal"), (signs[1], "cart/drift"))
        )
        more = drift_values - calm_values
        text = f"{metric.upper()} grows by {more[0]:.3f} m (pccebo), {more[1]:.3f} m (kfbo)"
        claim = f"6.3: PCCEBO less sensitive to the parameters, {metric.upper()}"
        yield statement(claim, "less sensitive", text, bool(more[0] < more[1]))


def _drift_stats(sign: int) -> pd.DataFrame:
    axes = {"plant.drift_sign": [sign]}
    return api.run(Study(name="sign", scenarios=["cart/drift"], observers=["pccebo", "kfbo"], seeds=1, axes=axes)).stats


def _values(stats: pd.DataFrame, scenario: str, signal: str, metric: str) -> np.ndarray:
    """Return the means of pccebo and kfbo."""
    rows = stats[(stats.scenario == scenario) & (stats.signal == signal) & (stats.metric == metric)]
    return rows.set_index("observer")["mean"].loc[["pccebo", "kfbo"]].to_numpy()


def _mae_text(stats: pd.DataFrame, scenario: str, signal: str) -> str:
    a, b = _values(stats, scenario, signal, "mae")
    return f"pccebo {a:.4g}, kfbo {b:.4g}"


def _row(values: np.ndarray) -> str:
    return "[" + ", ".join(f"{v:.4g}" for v in values) + "]"


def theorem() -> Iterator[Claim]:
    """Yield claims on the inequality (23), and on its guarantee."""
    for scenario, printed in SCALES.items():
        te, P = SCENARIOS[scenario].sampling.sampling_period[0], float(printed) * np.eye(2)
        Y = float(printed) * C.T
        largest = float(np.linalg.eigvalsh(inequality(te, P, Y)).max())
        text = (
            f"largest eigenvalue {largest:.4f}; inv(P) Y = [{', '.join(f'{v:g}' for v in np.linalg.solve(P, Y)[:, 0])}]"
        )
        claim = f"P = {printed} I, Y = [{printed}, 0]' satisfy (23), te = {te:g} s"
        yield statement(claim, "a feasible solution", text, largest < 0)
        half = float(np.linalg.eigvalsh(inequality(te, P / 2, Y / 2)).max())
        text = f"P / 2, Y / 2 are feasible too (largest eigenvalue {half:.4f}): the scale is free"
        yield Claim(f"scale {printed} of P, te = {te:g} s", printed, text, OPEN)
    L, te = np.array([[1e-3], [0.0]]), 0.2
    F = transition(te) - L @ C @ transition(te)
    P = solve_discrete_lyapunov(F.T, np.eye(2))
    margin, radius = -float(np.linalg.eigvalsh(inequality(te, P, P @ L)).max()), float(max(abs(np.linalg.eigvals(F))))
    text = f"L = [0.001, 0]' is certified (margin {margin:.2g}) and keeps {100 * radius:.1f} % of the error per period"
    yield statement("Remark 1: (23) guarantees fast convergence", "fast", text, not (margin > 0 and radius > 0.9))
    yield _slower()


def inequality(te: float, P: np.ndarray, Y: np.ndarray) -> np.ndarray:
    """Return the left side of (23), [4, 4]."""
    M = P @ transition(te) - Y @ C @ transition(te)
    return np.block([[-P, M.T], [M, -P]])


def transition(t: float) -> np.ndarray:
    """Return e^{At}."""
    return np.array([[1.0, -expm1(-LAM * t) / LAM], [0.0, exp(-LAM * t)]])


def _slower() -> Claim:
    """Return the claim of Remark 3: as R grows the slow pole of A - K C moves to the origin."""
    rates = {}
    for R in (0.004, 0.3, 1.0):
        K1 = -LAM + np.sqrt(LAM**2 + 2 * B * np.sqrt(0.002 / R))
        rates[R] = -max(np.linalg.eigvals(np.array([[-K1, 1.0], [-(K1**2) / 2, -LAM]])).real)
    text = "KFBO's slowest rate: " + ", ".join(f"{rate:.3g} 1/s at R = {R:g}" for R, rate in rates.items())
    falls = list(rates.values()) == sorted(rates.values(), reverse=True)
    return statement("Remark 3: the larger R, the slower KFBO", "slow response", text, falls)


def error_of_held_input(te: float = 0.2, horizon: float = 10.0) -> float:
    """Return PCCEBO's largest position error [m] from 1 s on if (8a) holds the input over a period, as printed.

    With L = [1, 0]' the sampled position is exact. The velocity error at the end of a period is visible until the next arrival.
    """
    ticks, dt = round(te / 1e-3), 1e-3
    u = np.array([10 * (1 - 2 * (k * dt / pi % 1.0)) for k in range(round(horizon / dt) + 1)])
    decay, e, worst = exp(-LAM * dt), 0.0, 0.0
    gain = B * (1 - decay) / LAM
    for first in range(0, len(u) - ticks, ticks):
        exact = approximate = 0.0
        for k in range(first, first + ticks):
            exact, approximate = decay * exact + gain * u[k], decay * approximate + gain * u[first]
        e = exp(-LAM * te) * e + exact - approximate
        if first * dt >= 1:
            worst = max(worst, abs(-expm1(-LAM * 2 * te) / LAM * e))
    return worst
