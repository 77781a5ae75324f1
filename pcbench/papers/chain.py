"""The chain observer's three claims, on the plant as printed and as it can be, and what noise does to them.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5 and Remark 2; the printed design is in `chain_design`.
"""

from typing import Any

import numpy as np

from pcbench import api
from pcbench.papers import chain_design
from pcbench.papers.claim import FALSE, REPRODUCED, Claim, found, statement
from pcbench.plants import csth
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study.times import whole

SEEDS = 256
PLANTS = (
    ("csth/1s", "consistent plant, 1 s"),
    ("csth/10s", "consistent plant, 10 s"),
    ("csth/literal", "plant as printed"),
)
STATES = [name for name, _ in csth.SIGNALS]


def claims() -> list[Claim]:
    """Return printed against reproduced, for `pcbench reproduce chain`."""
    with config.float64():
        return [*chain_design.claims(), *_remark_2(), *_remark_3(), *_claims(), *_noise()]


def _remark_2() -> list[Claim]:
    """A_0 = 0: x(k+1) = 0.6 x(k-1) + 0.6 x(k-2), made A_0 = diag(0, 0.6), A_2 = diag(0.6, 0) as printed, P = I."""
    grows = np.abs(np.roots([1, 0, -0.6, -0.6])).max()
    e = 1.0  # of (22): the norms are equal and there is one delayed term
    left = (1 + e) * 0.6**2 - 1, (1 + 1 / e) * 0.6**2 - 1
    text = f"x(k+1) = 0.6 x(k-1) + 0.6 x(k-2) is certified (largest eigenvalue {max(left):.2f}) and grows by {grows:.4f} a step"
    verdict = FALSE if grows > 1 and max(left) < 0 else REPRODUCED
    return [Claim("Remark 2: Theorem 2 applies where A_0 = 0", "can be applied", text, verdict)]


def _remark_3() -> list[Claim]:
    """Remark 3: what the poles and the delays do; and chain 3, said to be chain 1."""
    tau = [whole(float(d), SCENARIOS["csth/10s"]) for d in SCENARIOS["csth/10s"].sampling.delay]
    steps = np.diff([0, *sorted(tau)])
    alike = (
        f"delays {tau} leave steps of {', '.join(map(str, steps))} samples: (8) is the same for the first and the last"
    )
    out = [statement("chain 3 is chain 1", "the same", alike, bool(steps[2] == steps[0]))]
    rates = {pole: _rate({"options": {"chain": {"pole": pole}}}) for pole in (1e-4, 1e-2, 0.5)}
    text = ", ".join(f"{rate:.3f} at {pole:g}" for pole, rate in rates.items())
    tuned = list(rates.values()) == sorted(rates.values())
    out.append(statement("Remark 3: poles tune the convergence", "can be tuned", f"radius of one sample {text}", tuned))
    seconds = {1: [20.0, 50.0, 70.0], 2: [40.0, 100.0, 140.0], 4: [80.0, 200.0, 280.0]}
    study = {"name": "late", "scenarios": ["csth/10s"]}
    radii = {k: _rate({"axes": {"delay": [d]}}) for k, d in seconds.items()}
    peaks = {k: _largest(study | {"axes": {"delay": [d]}}) for k, d in seconds.items()}
    text = "; ".join(f"{k} times the delays: radius {radii[k]:.3f}, |e| up to {peaks[k]:.3g} J" for k in seconds)
    grows = list(peaks.values()) == sorted(peaks.values()) and list(radii.values()) == sorted(radii.values())
    claim = "Remark 3: longer delays mean longer, larger transients, never instability"
    return [*out, statement(claim, "stable", text, grows and max(radii.values()) < 1)]


def _rate(changes: dict[str, Any]) -> float:
    """The chain's radius of one sample where the study is changed so."""
    study = {"name": "rate", "scenarios": ["csth/10s"]} | changes
    return float(api.design(study, "chain").certificate.numbers["radius_of_one_sample"])


def _largest(study: dict[str, Any]) -> float:
    """The chain's largest error of enthalpy [J]."""
    trace = api.simulate(study, ["chain"])
    return float((trace["enthalpy"] - trace["chain.enthalpy"]).abs().max())


def _claims() -> list[Claim]:
    """The three claims, on the plant as printed (`literal`) and made consistent (`1s`, `10s`)."""
    out, methods = [], ["chain", "equal-delay", "no-delay", "no-delay-plain", "model-only"]
    for scenario, what in PLANTS:
        study = {"name": "claims", "scenarios": [scenario], "options": {"no-delay-plain": {"variant": "plain"}}}
        trace = api.simulate(study, methods)
        x = trace[STATES].to_numpy()
        e = {name: np.abs(x - trace[[f"{name}.{s}" for s in STATES]].to_numpy())[:, 1] for name in methods}
        radius = float(api.design(scenario, "chain").certificate.numbers["radius_of_one_sample"])
        left, te = e["chain"][10], SCENARIOS[scenario].sampling.sampling_period[0]
        text = f"enthalpy off by {e['chain'][0]:.0f} J at first, {_small(left)} after 10 samples, {10 * te:g} s"
        text += f" (radius {radius:.4f})"
        out.append(statement(f"#1 converges: {what}", "in 10 s", text, bool(left < 1e-3 * e["chain"][0])))
        share = e["equal-delay"][100:].mean() / np.abs(x[100:, 1]).mean()
        slow = float(api.design(scenario, "equal-delay").certificate.numbers["radius"])
        text = f"enthalpy off by {100 * share:.2g} % of its size, radius {slow:.3f} (a stand-in: [21] is not printed)"
        claim = f"#2 (one delay of 2) is biased and slow: {what}"
        out.append(statement(claim, "biased, slow", text, bool(share > 0.01 and slow > 0.5)))
        numbers = api.design(scenario, "no-delay").certificate.numbers
        text = f"radius {numbers['radius_with_these']:.4f}, |e| of enthalpy {_small(e['no-delay'][-1])} at the end"
        out.append(
            statement(f"#3 (samples aligned) diverges: {what}", "diverges", text, numbers["radius_with_these"] > 1)
        )
        text = f"bounded: at most {e['no-delay-plain'].max():.3g} J"
        out.append(
            statement(
                f"#3 (late data as they come) diverges: {what}", "diverges", text, bool(e["no-delay-plain"].max() > 1e9)
            )
        )
        if scenario == "csth/literal":
            alone, used = _small(e["model-only"][5]), _small(e["chain"][5])
            text = f"|e| of enthalpy after 5 samples {alone} without measurements, {used} with"
            fair = bool(e["model-only"][5] > e["chain"][5])
            out.append(statement("The plant as printed shows what the observer is worth", "Figures 3 to 5", text, fair))
    return out


def _small(joule: float) -> str:
    return f"{joule:.1e} J" if joule > 1e-8 else "below 1e-8 J"


def _noise() -> list[Claim]:
    """What the paper leaves out: noise. Least possible over actual root-mean-square error of enthalpy, samples 100 to 300."""
    result = api.run("csth/10s-noise", observers=["chain", "chain-riccati"], seeds=SEEDS)
    rows = result.stats.query("signal == 'enthalpy' and metric == 'rms_efficiency'").set_index("observer")
    out = []
    for name, what in (("chain", "printed poles"), ("chain-riccati", "Riccati gains, deadbeat outputs")):
        row = rows.loc[name]
        text = f"{row['mean']:.3f} +- {(row['ci_high'] - row['ci_low']) / 2:.3f} of the best possible"
        out.append(found(f"under noise the chain with {what}", text))
    return out
