"""The chain observer's three claims, on the plant as printed and as it can be, and what noise does to them.

Source: Alipouri, Zhong, Actuators 2021, 10, 281, section 5 and Remark 2; the printed design is in `chain_design`.
"""

import numpy as np

from pcbench import bench, machine
from pcbench.plants import csth
from pcbench.reproduce import chain_design
from pcbench.reproduce.claim import Claim, statement

SEEDS = 256
STATES = [name for name, _ in csth.SIGNALS]


def claims() -> list[Claim]:
    """Return printed against reproduced, for `pcbench reproduce chain`."""
    with machine.float64():
        return [*chain_design.claims(), *_remark_2(), *_claims(), *_noise()]


def _remark_2() -> list[Claim]:
    """A_0 = 0: x(k+1) = 0.6 x(k-1) + 0.6 x(k-2), made A_0 = diag(0, 0.6), A_2 = diag(0.6, 0) as printed, P = I."""
    grows = np.abs(np.roots([1, 0, -0.6, -0.6])).max()
    e = 1.0  # of (22): the norms are equal and there is one delayed term
    left = (1 + e) * 0.6**2 - 1, (1 + 1 / e) * 0.6**2 - 1
    text = f"x(k+1) = 0.6 x(k-1) + 0.6 x(k-2) is certified (largest eigenvalue {max(left):.2f}) and grows by {grows:.4f} a step"
    verdict = "does not hold" if grows > 1 and max(left) < 0 else "holds"
    return [Claim("Remark 2: Theorem 2 applies where A_0 = 0", "can be applied", text, verdict)]


def _claims() -> list[Claim]:
    """The three claims, on the plant as printed (`literal`) and made consistent (`10s`)."""
    out, methods = [], ["chain", "equal-delay", "no-delay", "no-delay-plain", "open-loop"]
    for scenario, what in (("csth/10s", "consistent plant, 10 s"), ("csth/literal", "plant as printed")):
        study = {"name": "claims", "scenarios": [scenario], "options": {"no-delay-plain": {"variant": "plain"}}}
        trace = bench.trace(study, methods)
        x = trace[STATES].to_numpy()
        e = {name: np.abs(x - trace[[f"{name}.{s}" for s in STATES]].to_numpy())[:, 1] for name in methods}
        radius = float(bench.design(scenario, "chain").certificate.numbers["radius_of_one_sample"])
        text = f"enthalpy off by {e['chain'][0]:.0f} J at first, {e['chain'][10]:.1e} J after 10 samples (radius {radius:.4f})"
        out.append(statement(f"#1 converges: {what}", "in 10 s", text, bool(e["chain"][10] < 1e-3 * e["chain"][0])))
        share = e["equal-delay"][100:].mean() / np.abs(x[100:, 1]).mean()
        slow = float(bench.design(scenario, "equal-delay").certificate.numbers["radius"])
        text = f"enthalpy off by {100 * share:.2g} % of its size, radius {slow:.3f} (a stand-in: [21] is not printed)"
        claim = f"#2 (one delay of 2) is biased and slow: {what}"
        out.append(statement(claim, "biased, slow", text, bool(share > 0.01 and slow > 0.5)))
        numbers = bench.design(scenario, "no-delay").certificate.numbers
        text = f"radius {numbers['radius_with_these']:.4f}, |e| of enthalpy {e['no-delay'][-1]:.1e} J at the end"
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
            text = f"|e| of enthalpy after 5 samples {e['open-loop'][5]:.1e} J without measurements, {e['chain'][5]:.1e} J with"
            fair = bool(e["open-loop"][5] > e["chain"][5])
            out.append(statement("The plant as printed shows what the observer is worth", "Figures 3 to 5", text, fair))
    return out


def _noise() -> list[Claim]:
    """What the paper leaves out: noise. Least possible over actual root-mean-square error of enthalpy, samples 100 to 300."""
    result = bench.run("csth/10s-noise", observers=["chain", "chain-riccati"], seeds=SEEDS)
    rows = result.stats.query("signal == 'enthalpy' and metric == 'efficiency'").set_index("observer")
    out = []
    for name, what in (("chain", "printed poles"), ("chain-riccati", "Riccati gains, deadbeat outputs")):
        row = rows.loc[name]
        text = f"{row['mean']:.3f} +- {(row['ci_high'] - row['ci_low']) / 2:.3f} of the best possible"
        claim = f"under noise the chain with {what} is near the best"
        out.append(statement(claim, "not in the paper", text, bool(row["mean"] > 0.7)))
    return out
