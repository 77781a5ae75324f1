"""PCO and PI-PCO under variable sampling: when the integral reduces the effect of noise, in closed form and by Monte Carlo.

Source: Li, Wang, Tian, PI Piecewise Continuous Observer. The paper prints no gain and no error value, only figures and that
PI-PCO "shows better performances" under noise of variance 0.001. On the cart with intervals of 0.1 s and more, e^{-lam T} is
negligible and A12 constant. With F = A22 - Kp A12, k = Ki A12 and noise v of variance sigma^2 the position error r satisfies

    r_i = F r_(i-1) - l_(i-1) - (1 - F) v_i,   l_i = l_(i-1) + k (r_(i-1) + v_i);  stable iff k > 0, F + k < 1, 2 + 2F + k > 0
    var r / sigma^2 = (1 - F) / (1 + F) for PCO (k = 0), else (2F^2 + 3Fk - 4F + k^2 - k + 2) / ((1 - F - k)(2F + k + 2))

For |F| < 1 the integral reduces the variance iff F < 0 and 0 < k < -2F. This theorem is not in the paper.

Missing or misprinted in the paper: gains, intervals, the index of L, the error of (21).

- In (12) and (15) L_{t-1} means L_{i-1}: with it the theta form (15) to (17) is algebraically the form (12) to (14). t has no
  meaning as an index there.
- (21) states that the measured part of the error of xhat_i is 0. This holds for [y; w] at the sample's own time. (18)
  propagates the arriving data, and so their noise.
"""

from collections.abc import Iterator
from itertools import pairwise
from math import exp, expm1
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pcbench import api, planning
from pcbench.dataset.result import Result
from pcbench.papers.claim import FALSE, MISPRINT, OPEN, Claim, report_finding, statement
from pcbench.planning import padding, run_local
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study import Study, options_of
from pcbench.study.grid import cell_of

SEEDS = 1024
NEGLIGIBLE = 1e-5  # smallest tail error that counts: smaller ones are not resolved on the cart
CARTS_A12 = -np.expm1(-12.2) / 122  # at an interval of 0.1 s
STEADY = SCENARIOS[
    "cart/variable"
].with_fields(  # only noise: true initial state, a clock of 0.1 s, evaluated after the transient
    name="steady", sampling_pattern="periodic", sampling_period=(0.1,), xhat0=(5.0, 10.0), steady_start=5.0
)
GRID = [(F, k) for F in (-0.6, -0.3, 0.0, 0.3, 0.5) for k in (0.1, 0.4, 0.8, 1.4) if F + k < 0.9]
LAM, B, KP, KI = 122.0, 355.0, -61.0, 12.2


class Variances(NamedTuple):
    """Variance of the position error divided by that of the noise, with and without the integral, on common random numbers."""

    F: float
    k: float
    pco: float
    pi: float
    difference: float  # pi - pco
    errors: tuple[float, float, float]  # standard errors of these three

    @property
    def deviations(self) -> tuple[float, float, float]:
        """Deviations from the closed form, in standard errors."""
        exact = stationary(self.F, 0.0), stationary(self.F, self.k)
        away = self.pco - exact[0], self.pi - exact[1], self.difference - (exact[1] - exact[0])
        first, second, third = (a / e for a, e in zip(away, self.errors, strict=True))
        return first, second, third


def stationary(F: float, k: float) -> float:
    """Return the stationary variance of the position error over that of the noise; k = 0 is PCO."""
    if k == 0:
        return (1 - F) / (1 + F)
    return (2 * F**2 + 3 * F * k - 4 * F + k**2 - k + 2) / ((1 - F - k) * (2 * F + k + 2))


def stable(F: float, k: float) -> bool:
    """Return whether PI-PCO is stable: F alone does not decide it."""
    return k > 0 and F + k < 1 and 2 + 2 * F + k > 0


def monte_carlo(grid: list[tuple[float, float]], seeds: int, scenario: Scenario = STEADY) -> Iterator[Variances]:
    """Yield simulated variances of PCO and PI-PCO for each (F, k) on common random numbers; one program covers the grid."""
    drafts = []
    for number, (F, k) in enumerate(grid):
        Kp, Ki = (np.exp(-12.2) - F) / CARTS_A12, k / CARTS_A12
        gain_options = {"pco": {"Kp": Kp}, "pi-pco": {"Kp": Kp, "Ki": Ki}}
        study = Study(name="variance", scenarios=["cart/variable"], options=gain_options, seeds=seeds)
        options = {name: options_of(study, scenario, name) for name in gain_options}
        drafts.append(planning.draft(cell_of(scenario, number), options))
    for (F, k), run in zip(grid, run_local.execute(study, padding.fit(drafts)), strict=True):
        pco, pi = (
            run.results[name]["steady_mse"][0] / scenario.sampling.noise_std[0] ** 2 for name in ("pco", "pi-pco")
        )
        rows = (pco, pi, pi - pco)
        means, errors = ([float(f(row)) for row in rows] for f in (np.mean, standard_error))
        yield Variances(F, k, means[0], means[1], means[2], (errors[0], errors[1], errors[2]))


def standard_error(x: NDArray[np.float64]) -> np.float64:
    """Return the standard error of the mean of runs x."""
    return x.std(ddof=1) / np.sqrt(len(x))


def claims() -> list[Claim]:
    """Return the claims for `pcbench reproduce pi-pco`."""
    with config.float64():
        return [*_ordering(), *_stability(), *equations(), *_robustness(), *_variances()]


def _ordering() -> Iterator[Claim]:
    """Yield the paper's own test, exact model and white noise: its claim depends on gains that are not printed."""
    for Kp, Ki, description in (
        (-61.0, 12.2, "a smoothing gain, F = 0.5"),
        (61.0, 12.2, "an amplifying gain, F = -0.5"),
    ):
        options = {"pco": {"Kp": Kp}, "pi-pco": {"Kp": Kp, "Ki": Ki}}
        result = api.run("cart/variable", observers=list(options), options=options, seeds=SEEDS)
        for signal, unit in (("position", "m"), ("velocity", "m/s")):
            rows = _tail_rms(result, signal)
            alike = max(rows.values()) < NEGLIGIBLE
            rms_text = f"pco {rows['pco']:.5f}, pi-pco {rows['pi-pco']:.5f} {unit} (steady rms)"
            text = f"both below {NEGLIGIBLE:g} {unit}: negligible" if alike else rms_text
            gains = f"Kp = {Kp:g}, Ki = {Ki:g}: {description}"
            claim = f"PI-PCO better than PCO in {signal} under noise, variable intervals; {gains}"
            yield statement(claim, "better", text, bool(rows["pi-pco"] < rows["pco"]) and not alike)


def _variances() -> Iterator[Claim]:
    for c in monte_carlo(GRID, SEEDS):
        exact = stationary(c.F, 0.0), stationary(c.F, c.k)
        text = f"{c.pco:.4f} -> {c.pi:.4f}, at most {max(map(abs, c.deviations)):.1f} standard errors off"
        lower = c.F < 0 and c.k < -2 * c.F
        claim = (
            f"F = {c.F:g}, k = {c.k:g}: the integral {'lowers' if lower else 'raises'} the variance (over the noise's)"
        )
        right = (c.difference < 0) == (exact[1] < exact[0]) == lower and max(map(abs, c.deviations)) < 4
        comparison = f"{'agrees with' if right else 'differs from'} the closed form, {exact[0]:.4f} -> {exact[1]:.4f}"
        yield report_finding(claim, f"{text}; {comparison}")


def _stability() -> Iterator[Claim]:
    F, k = 0.5, 0.6
    radius = max(abs(np.roots([1, -(1 + F), F + k])))
    text = f"F = {F:g}, k = {k:g}: the error and the integral grow by a factor of {radius:.3f} per sample"
    yield statement("A stable F_i makes PI-PCO stable (26)", "ensures", text, bool(radius <= 1))


def _robustness() -> Iterator[Claim]:
    """Yield claims on the purpose of the integral: a wrong model."""
    for scenario, wrong in (("cart/variable-bias", "input bias 0.2"), ("cart/variable-gain", "input gain +10 %")):
        rows = _tail_rms(api.run(scenario, seeds=256))
        text = ", ".join(f"{name} {rows[name]:.4f}" for name in ("pco", "pi-pco", "kf", "kf-bias")) + " m"
        claim = f"The integral makes PCO more robust: {wrong} that no model contains"
        yield statement(claim, "more robust", text, bool(rows["pi-pco"] < rows["pco"]))


def _tail_rms(result: Result, signal: str = "position") -> dict[str, float]:
    """Return a signal's root-mean-square error over the tail and all runs, by observer."""
    rows = result.stats[(result.stats.signal == signal) & (result.stats.metric == "steady_pooled_rmse")]
    return dict(zip(rows["observer"], rows["mean"], strict=True))


def equations() -> list[Claim]:
    """Return claims that cannot be computed from the paper, and errors in its equations."""
    first = [f"{b - a}" for a, b in pairwise([0, *arrivals(4)])]
    same, late = theta_form(0), theta_form(1)
    text = f"L_(i-1): (15) and (12) agree to {_size(same)}; L_(i-2): they differ by {late:.2g} m/s"
    return [
        Claim("Kp, Ki", "not printed", "both signs of F are tested above", OPEN),
        Claim("T_i, Figure 3", "not printed", f"ours begins with {', '.join(first)} ms", OPEN),
        Claim("L_(t-1) in (12), (15)", "t - 1", text, MISPRINT if same < 1e-9 < late else FALSE),
        _measured_part(),
    ]


def arrivals(count: int) -> list[int]:
    """Return the first ticks at which a sample arrives in cart/variable: T_i = round(200 + 100 sin 0.6 i) ms."""
    return [int(t) for t in np.cumsum([round(200 + 100 * np.sin(0.6 * i)) for i in range(1, count + 1)])]


def theta_form(late: int, count: int = 40) -> float:
    """Return the difference between (15) to (17) and (12) to (14) if (15) uses the integral `late` samples older."""
    rng, w, L = np.random.default_rng(2), 0.0, [0.0] * (late + 1)
    y, integral, worst = [5.0], 0.0, 0.0
    times = [0, *arrivals(count)]
    theta = w - KP * y[0]
    for a, b in pairwise(times):
        T = (b - a) * 1e-3
        A12, A22 = -expm1(-LAM * T) / LAM, exp(-LAM * T)
        M = B * np.array([(T - A12) / LAM, A12]) * np.sin(4e-3 * a)
        y.append(y[-1] + rng.standard_normal())
        nu = y[-1] - y[-2] - M[0] - A12 * w
        F = A22 - KP * A12
        theta = F * theta + (F * KP - KP) * y[-2] + M[1] - KP * M[0] + L[-1 - late]
        w = A22 * w + M[1] + KP * nu + integral
        integral += KI * nu
        L.append(integral)
        worst = max(worst, abs(theta + KP * y[-1] - w))
    return worst


def _measured_part() -> Claim:
    """Return the measured part of x - xhat at the arrivals, under the paper's noise."""
    trace = api.simulate("cart/variable", "pi-pco")
    late = [k for k in arrivals(40) if 3000 <= k < len(trace)]
    e = (trace["position"] - trace["pi-pco.position"]).to_numpy()[late]
    std = SCENARIOS["cart/variable"].sampling.noise_std[0]
    text = f"rms {np.sqrt(np.mean(e**2)):.3f} m at the arrivals after 3 s: the noise (sd {std:.3f} m), which (18) keeps"
    return Claim("(21) measured part of x_i - xhat_i", "0", text, MISPRINT if np.abs(e).max() > 1e-3 else FALSE)


def _size(value: float) -> str:
    return "rounding" if value < 1e-9 else f"{value:.1g} m/s"
