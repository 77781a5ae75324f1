"""The chain observer's three claims on the printed and on the physical plant, the effect of noise, and its printed design.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5 and Remark 2. Signs are missing in the available text, and T is
printed to two or three digits. So absolute values are compared, within 6 % or half a unit of the last printed digit. The design
follows from the printed T by (8): L = (T A^d - G T) inv(C), H_i = T A^i B, Q_j = C A^(j-1) B. Of V = C A^d inv(C), only the
entries that do not depend on signs are compared.
"""

from collections.abc import Iterator

import numpy as np

from pcbench import api
from pcbench.dynamics.linear import Matrix
from pcbench.papers.claim import FALSE, MISPRINT, OPEN, REPRODUCED, Claim, report_finding, statement, unit
from pcbench.plants import csth
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study.times import to_ticks
from pcbench.synthesis import chain

SEEDS = 256
PLANTS = (
    ("csth/1s", "consistent plant, 1 s"),
    ("csth/10s", "consistent plant, 10 s"),
    ("csth/literal", "plant as printed"),
)
STATES = [name for name, _ in csth.SIGNALS]
CLOSE = 0.06
# By chain: d, T, the other matrices row by row, entries of V; chain 3 is stated to equal chain 1.
PRINTED: dict[int, tuple[int, str, dict[str, str], dict[tuple[int, int], str]]] = {
    1: (
        2,
        "6.2e-3 2.6e-6 5.7e-6 0.652 6.6e-7 1.2e-6 0.732 2.1e-7 6.7e-7",
        {
            "L": "3e-7 2.3e-6 8.3e-12 1.9e-4 6.7e-2 5.7e-6 0.02 0.0172 1.2e-6",
            "H0": "6.2e-3 0.175 0.652 0.038 0.7323 0.02",
            "H1": "1.6e-3 2.1e-4 4.1e-4 4.5e-5 1.3e-4 2.4e-5",
            "Q1": "31.83 0 0 0 0 30411.5",
            "Q2": "0 0 0.0241 0 0 36.55",
        },
        {(1, 0): "4.5e-6", (1, 1): "3.5e-5", (2, 2): "1.4e-6"},
    ),
    2: (
        3,
        "2.9e-2 3.8e-5 8.2e-11 5.3e-3 9.1e-7 1e-9 4.5e-5 8.7e-8 1.2e-9",
        {
            "L": "2.5e-8 2e-4 1.4e-11 9.2e-4 0.998 8.27e-11 1.6e-4 0.0236 1e-9",
            "H0": "0.0295 2.4e-6 5.3e-3 3e-5 4.6e-5 3.6e-5",
            "H1": "0.0241 3.2e-8 5.7e-4 3.8e-7 5.4e-5 4.6e-7",
            "H2": "1.4e-4 3.1e-7 3e-6 4e-7 6.4e-7 3.3e-7",
            "Q1": "31.83 0 0 0 0 30411.5",
            "Q2": "0 0 0.0241 0 0 36.55",
            "Q3": "0 0 1.4e-4 0 0 0.044",
        },
        {(1, 0): "2.6e-8", (1, 1): "2.1e-7", (2, 2): "1.7e-9"},
    ),
}
GARBLED = {(1, "H0", 0): "6.21.6e-3", (2, "L", 8): "1 x 9"}  # as in the text, for the values used above


def claims() -> list[Claim]:
    """Return the claims for `pcbench reproduce chain`."""
    with config.float64():
        return [*design_claims(), *_remark_2(), *_remark_3(), *_claims(), *_noise()]


def _remark_2() -> Iterator[Claim]:
    """Yield the claim on A_0 = 0: x(k+1) = 0.6 x(k-1) + 0.6 x(k-2), with A_0 = diag(0, 0.6), A_2 = diag(0.6, 0), P = I."""
    grows = np.abs(np.roots([1, 0, -0.6, -0.6])).max()
    e = 1.0  # of (22): the norms are equal and there is one delayed term
    eigenvalues = (1 + e) * 0.6**2 - 1, (1 + 1 / e) * 0.6**2 - 1
    text = f"x(k+1) = 0.6 x(k-1) + 0.6 x(k-2) is certified (largest eigenvalue {max(eigenvalues):.2f})"
    text += f" and grows by a factor of {grows:.4f} per step"
    verdict = FALSE if grows > 1 and max(eigenvalues) < 0 else REPRODUCED
    yield Claim("Remark 2: Theorem 2 applies where A_0 = 0", "can be applied", text, verdict)


def _remark_3() -> Iterator[Claim]:
    """Yield claims of Remark 3 on the effect of poles and delays; chain 3 is stated to equal chain 1."""
    tau = [to_ticks(float(d), SCENARIOS["csth/10s"]) for d in SCENARIOS["csth/10s"].sampling.delay]
    steps = np.diff([0, *sorted(tau)])
    alike = (
        f"delays {tau} give steps of {', '.join(map(str, steps))} samples: (8) is the same for the first and the last"
    )
    yield statement("chain 3 is chain 1", "the same", alike, bool(steps[2] == steps[0]))
    rates = {pole: _rate({"options": {"chain": {"pole": pole}}}) for pole in (1e-4, 1e-2, 0.5)}
    text = ", ".join(f"{rate:.3f} at {pole:g}" for pole, rate in rates.items())
    tuned = list(rates.values()) == sorted(rates.values())
    yield statement("Remark 3: poles tune the convergence", "can be tuned", f"spectral radius per sample {text}", tuned)
    seconds = {1: [20.0, 50.0, 70.0], 2: [40.0, 100.0, 140.0], 4: [80.0, 200.0, 280.0]}
    study = {"name": "late", "scenarios": ["csth/10s"]}
    radii = {k: _rate({"axes": {"delay": [d]}}) for k, d in seconds.items()}
    peaks = {k: _largest(study | {"axes": {"delay": [d]}}) for k, d in seconds.items()}
    text = "; ".join(f"{k} times the delays: radius {radii[k]:.3f}, |e| up to {peaks[k]:.3g} J" for k in seconds)
    grows = list(peaks.values()) == sorted(peaks.values()) and list(radii.values()) == sorted(radii.values())
    claim = "Remark 3: longer delays mean longer, larger transients, never instability"
    yield statement(claim, "stable", text, grows and max(radii.values()) < 1)


def _rate(changes: dict[str, object]) -> float:
    """Return the chain's spectral radius per sample in a changed study."""
    study = {"name": "rate", "scenarios": ["csth/10s"]} | changes
    return float(api.design(study, "chain").certificate.numbers["radius_of_one_sample"])


def _largest(study: dict[str, object]) -> float:
    """Return the chain's largest error of enthalpy [J]."""
    trace = api.simulate(study, ["chain"])
    return float((trace["enthalpy"] - trace["chain.enthalpy"]).abs().max())


def _claims() -> Iterator[Claim]:
    """Yield the three claims, on the plant as printed (`literal`) and made consistent (`1s`, `10s`)."""
    methods = ["chain", "equal-delay", "no-delay", "no-delay-plain", "model-only"]
    for scenario, description in PLANTS:
        study = {"name": "claims", "scenarios": [scenario], "options": {"no-delay-plain": {"variant": "plain"}}}
        trace = api.simulate(study, methods)
        x = trace[STATES].to_numpy()
        e = {name: np.abs(x - trace[[f"{name}.{s}" for s in STATES]].to_numpy())[:, 1] for name in methods}
        radius = float(api.design(scenario, "chain").certificate.numbers["radius_of_one_sample"])
        error, te = e["chain"][10], SCENARIOS[scenario].sampling.sampling_period[0]
        text = f"enthalpy off by {e['chain'][0]:.0f} J at first, {_small(error)} after 10 samples, {10 * te:g} s"
        text += f" (radius {radius:.4f})"
        yield statement(f"#1 converges: {description}", "in 10 s", text, bool(error < 1e-3 * e["chain"][0]))
        share = e["equal-delay"][100:].mean() / np.abs(x[100:, 1]).mean()
        slow = float(api.design(scenario, "equal-delay").certificate.numbers["radius"])
        text = f"enthalpy off by {100 * share:.2g} % of its size, radius {slow:.3f} (a substitute: [21] is not printed)"
        claim = f"#2 (one delay of 2) is biased and slow: {description}"
        yield statement(claim, "biased, slow", text, bool(share > 0.01 and slow > 0.5))
        numbers = api.design(scenario, "no-delay").certificate.numbers
        text = f"radius {numbers['radius_with_these']:.4f}, |e| of enthalpy {_small(e['no-delay'][-1])} at the end"
        yield statement(
            f"#3 (samples aligned) diverges: {description}", "diverges", text, numbers["radius_with_these"] > 1
        )
        text = f"bounded: at most {e['no-delay-plain'].max():.3g} J"
        yield statement(
            f"#3 (delayed data as they arrive) diverges: {description}",
            "diverges",
            text,
            bool(e["no-delay-plain"].max() > 1e9),
        )
        if scenario == "csth/literal":
            without_samples, with_samples = _small(e["model-only"][5]), _small(e["chain"][5])
            text = f"|e| of enthalpy after 5 samples {without_samples} without measurements, {with_samples} with"
            fair = bool(e["model-only"][5] > e["chain"][5])
            yield statement("The plant as printed shows the benefit of the observer", "Figures 3 to 5", text, fair)


def _small(joule: float) -> str:
    return f"{joule:.1e} J" if joule > 1e-8 else "below 1e-8 J"


def _noise() -> Iterator[Claim]:
    """Yield findings under noise: Kalman bound over root-mean-square error of enthalpy, samples 100 to 300."""
    result = api.run("csth/10s-noise", observers=["chain", "chain-riccati"], seeds=SEEDS)
    rows = result.stats.query("signal == 'enthalpy' and metric == 'rms_efficiency'").set_index("observer")
    for name, description in (("chain", "printed poles"), ("chain-riccati", "Riccati gains, deadbeat outputs")):
        row = rows.loc[name]
        text = f"{row['mean']:.3f} +- {(row['ci_high'] - row['ci_low']) / 2:.3f} of the best possible"
        yield report_finding(f"under noise the chain with {description}", text)


def design_claims() -> list[Claim]:
    """Return the claims on the printed design."""
    return [*_entries(), *_misprints(), *_open_claims()]


def design_chain(d: int, T_printed: str) -> dict[str, Matrix]:
    """Return L, H_i, Q_j and V of a chain, computed from its printed T on the plant as printed."""
    A, B, C, *_ = csth.nominal(csth.Numbers(literal=True))
    power = np.linalg.matrix_power
    T, G = np.array(T_printed.split(), float).reshape(3, 3), chain.companion(1e-4, 3)
    out = {"L": (T @ power(A, d) - G @ T) @ np.linalg.inv(C), "V": C @ power(A, d) @ np.linalg.inv(C)}
    out |= {f"H{i}": T @ power(A, i) @ B for i in range(d)}
    return out | {f"Q{j}": C @ power(A, j - 1) @ B for j in range(1, d + 1)}


def close(word: str, value: float) -> bool:
    """Return whether a printed absolute value equals a value, within 6 % or half a unit of its last digit."""
    return abs(abs(value) - float(word)) <= max(CLOSE * float(word), 0.5 * unit(word))


def _entries() -> Iterator[Claim]:
    for number, (d, T, entries, V) in PRINTED.items():
        values = design_chain(d, T)
        words = {(name, i): word for name, text in entries.items() for i, word in enumerate(text.split())}
        words |= {("V", 3 * i + j): word for (i, j), word in V.items()}
        for (name, i), word in words.items():
            value, wide = abs(values[name].ravel()[i]), values[name].shape[1]
            if float(word) == 0 and value < 1e-12:
                continue
            printed = f"{GARBLED[number, name, i]}, read {word}" if (number, name, i) in GARBLED else word
            verdict = REPRODUCED if close(word, value) else MISPRINT
            digits = max(3, len(word.partition("e")[0].replace(".", "").lstrip("0")))
            claim = f"chain {number}: |{name}({i // wide + 1},{i % wide + 1})|"
            yield Claim(claim, printed, f"{value:.{digits}g}", verdict)


def _misprints() -> Iterator[Claim]:
    """Yield the contradictions in the printed text."""
    wrong = np.abs(np.roots([1, -3e-4, 3e-8, -1e-2])).max()
    poles = f"1e-12: only this value gives three poles at 1e-4 (1e-2 has one of size {wrong:.3f})"
    heater = f"{csth.Numbers().mc:.9g}: Q1 = C B prints 30411.5"
    yield Claim("B(3,2)", "3041.5241", heater, MISPRINT)
    yield Claim("g_1 of the poles", "10^-2", poles, MISPRINT)
    yield Claim("Q_0, Q_d of (9) where D != 0", "D - V D, C A^(d-1) B", _feedthrough(), MISPRINT)


def _feedthrough() -> str:
    """Return which coefficients of (9) predict y exactly: a plant with D, xhat exact, one link."""
    rng = np.random.default_rng(5)
    A, B, C, D, V = (rng.standard_normal(shape) for shape in [(3, 3), (3, 1), (2, 3), (2, 1), (2, 2)])
    x, u = rng.standard_normal(3), rng.standard_normal((2, 1))
    y = C @ (A @ x + B @ u[0]) + D @ u[1]
    other_terms = (C @ A - V @ C) @ x + V @ (C @ x + D @ u[0])
    exact_y = other_terms + D @ u[1] + (C @ B - V @ D) @ u[0]
    printed_y = other_terms + (D - V @ D) @ u[1] + C @ B @ u[0]
    wrong, exact = np.abs(y - printed_y).max(), np.abs(y - exact_y).max()
    close = "exact" if exact < 1e-12 else f"off by {exact:.0e}"
    return f"D, C A^(d-1) B - V D: {close}; as printed off by {wrong:.2f}"


def _open_claims() -> Iterator[Claim]:
    free_reason = "C is invertible, so any invertible T solves (8): nine free numbers, used as printed"
    reason = "depends on the signs of T, which are lost"
    yield Claim("chains 1, 2: T", "nine numbers each", free_reason, OPEN)
    yield Claim("chains 1, 2: W, the rest of V", "printed", reason, OPEN)
