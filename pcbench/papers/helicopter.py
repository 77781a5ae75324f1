"""The high-gain observer on the helicopter: its claims with both delays, what misprints do, and what else there is to know.

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 5. The paper prints no numbers beside its figures;
random starts, noise, the filter and the controller's options are ours.
"""

from math import isfinite, isnan
from typing import Any

import numpy as np
import pandas as pd

from pcbench import api
from pcbench.papers.claim import FINDING, MISPRINT, Claim, digits, found, statement
from pcbench.papers.helicopter_runs import VISCOSITY, Flight, misread, record
from pcbench.plants import helicopter
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.synthesis import lqr
from pcbench.synthesis.lqr import limit

SEEDS = 256
RANDOM: dict[str, dict[str, Any]] = {"scenario": {"random_initial_state": True}}
NAMES = {"high-gain": "printed", "high-gain-robust": "robust"}


def claims() -> list[Claim]:
    """Return printed against reproduced, for `pcbench reproduce helicopter`."""
    with config.float64():
        runs = record()
        return [*_printed(runs), *_misread(), *_control(runs), *_starts(), *_noise(runs)]


def _printed(runs: dict[str, Flight]) -> list[Claim]:
    """What the paper's two simulations are said to show."""
    out = []
    for name, what in (("constant", "constant delay"), ("varying", "varying delay")):
        run = runs[name]
        B, times = run.z[-1, 4:], run.within
        text = f"{B[0]:.6f}, {B[1]:.6f} at 20 s"
        out.append(statement(f"{what}: the viscosities are found", "0.8, 0.318", text, bool(times.max() < 20)))
        inside = f"from {times[0]:.2f} s and {times[1]:.2f} s on"
        out.append(found(f"{what}: viscosities within 5 %", inside))
        e = run.rms(run.x - run.z)[:4]
        text = ", ".join(f"{v:.1e}" for v in e) + " rms from 10 s on"
        out.append(statement(f"{what}: the state of now is estimated", "converges", text, bool(e.max() < 1e-3)))
        for i, angle in enumerate(("pitch", "yaw")):
            claim, text = f"{what}: {angle} follows its path", f"{run.off[i]:.4f} rad rms from 10 s on"
            out.append(statement(claim, "satisfactorily", text, bool(run.off[i] < 0.05)))
        late = [float(np.abs(run.x - run.z)[a:b, :4].max()) for a, b in ((1000, 2000), (5000, 6000), (10_000, 11_000))]
        text = ", ".join(f"{v:.1e}" for v in late) + " at most, from 1, 5 and 10 s on for a second"
        shrinks = late[2] < 0.1 * late[1] < 0.01 * late[0]
        out.append(statement(f"Remark 2, {what}: the error converges exponentially", "to zero", text, shrinks))
    apart = runs["varying"].off[1] - runs["constant"].off[1], max(runs["varying"].off) - max(runs["constant"].off)
    text = f"off the path by {apart[0]:+.4f} rad (yaw), {apart[1]:+.4f} rad (pitch) against the constant delay"
    out.append(statement("varying delay: the control is more challenging", "more challenging", text, max(apart) > 1e-3))
    s, t = SCENARIOS["helicopter/varying"], np.arange(20_000) * 1e-3
    longest = float(
        (float(s.sampling.delay[0]) + s.sampling.delay_sine[0] * np.sin(s.sampling.delay_sine[1] * t)).max()
    )
    out.append(digits("largest varying delay [s]", "0.045", longest))
    radius, far = lqr.radius(4.0 * 0.2), lqr.radius(4.0 * 0.8)
    text = f"linear part: radius {radius:.2f} a sample at 0.2 s, {far:.2f} at 0.8 s; limit {limit() / 4.0:.2f} s"
    claim = "beyond a limit of the sampling period it does not converge"
    return [*out, statement(claim, "a limitation", text, bool(radius < 1 < far))]


def _misread() -> list[Claim]:
    """Take the text as it stands, one reading at a time."""
    out = []
    for what, run in misread().items():
        lost, B = run.diverged, run.z[-1, 4:]
        text = f"viscosities {B[0]:.3f}, {B[1]:.3f} at 20 s" if isnan(lost) else f"diverges at {lost:.2f} s"
        wrong = isfinite(lost) or not np.isfinite(run.within).all()
        if what:
            out.append(Claim(what, "taken literally", text, MISPRINT if wrong else FINDING))
    out.append(Claim("unit of the viscosities, Table 1", "N/V", "N m s/rad, by the equations", MISPRINT))
    return out


def _control(runs: dict[str, Flight]) -> list[Claim]:
    """What the loop is limited by."""
    full = max(runs[name].off.max() for name in ("full", "full, varying"))
    lost, kept = runs["still"].diverged, isnan(runs["still, true"].diverged)
    still = ("converges" if isnan(lost) else f"diverges at {lost:.2f} s") + (
        ", not from the true state" if kept else ""
    )
    out = [
        found(
            "what keeps the pitch off its path",
            f"{full:.1e} rad rms with feedforward and predictor, {runs['constant'].off[0]:.3f} without: no gravity term",
        ),
        found("set point at rest, (1, 1) rad, printed observer", still),
    ]
    for name, what in (
        ("late samples", "samples 0.15 s late, commands 0.025 s"),
        ("late commands", "the other way round"),
    ):
        run = runs[name]
        text = f"yaw {run.off[1]:.3f} rad off its path, its rate found to {run.rms(run.x - run.z)[3]:.1e} rad/s"
        out.append(found(what, text))
    heavy = {what: runs[name].rms(runs[name].z[:, 4:] - VISCOSITY) for what, name in HEAVY.items()}
    text = ", ".join(f"{b[0]:.2f} and {b[1]:.3f} ({what})" for what, b in heavy.items())
    out.append(found("10 % more mass than the model: viscosities off by, rms", text))
    out.append(found("linear limit of Theta Ts", f"{limit():.4f}"))
    return out


HEAVY = {"robust": "heavy", "ekf": "heavy, ekf"}


def _rows(frame: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(k): v for k, v in row.items()} for row in frame.to_dict("records")]


def _starts() -> list[Claim]:
    """How often the observer diverges from random starts, by the sampling period."""
    axes = {"sampling_period": [0.05, 0.2, 0.8, 1.5]}
    done = api.run("helicopter/constant", observers=list(NAMES), seeds=SEEDS, axes=axes, options=RANDOM)
    unsettled = done.runs[done.runs.signal.str.endswith("viscosity")].query("status == 'unsettled'")
    late = unsettled.groupby(["observer", "sampling_period"]).seed.nunique().to_dict()
    texts: dict[float, list[str]] = {}
    for r in _rows(done.stats.query("signal == 'pitch_viscosity' and metric == 'divergence_rate'")):
        interval = f"{100 * r['ci_low']:.1f} .. {100 * r['ci_high']:.1f} %"
        never = late.get((r["observer"], r["sampling_period"]), 0)
        text = f"{NAMES[r['observer']]} {r['diverged']} of {r['n']} ({interval}), {never} others not within 5 %"
        texts.setdefault(r["sampling_period"], []).append(text)
    return [found(f"random starts, Ts = {te:g} s: runs that diverge", "; ".join(text)) for te, text in texts.items()]


def _noise(runs: dict[str, Flight]) -> list[Claim]:
    """The filter beside the observer, under noise and without."""
    names, stds = ["high-gain-robust", "ekf"], [5e-4, 2e-2]
    done = api.run("helicopter/constant", observers=names, seeds=SEEDS, axes={"noise_std": stds}, options=RANDOM)
    rows = _rows(done.stats.query("metric == 'steady_pooled_rmse'"))
    value = {(r["noise_std"], r["signal"], r["observer"]): r["mean"] for r in rows}
    signals = [name for name, _ in helicopter.SIGNALS + helicopter.UNKNOWNS]
    out = []
    for std in stds:
        both = [tuple(value[std, signal, name] for name in names) for signal in signals]
        text = "; ".join(f"{signal} {a:.3g} / {b:.3g}" for signal, (a, b) in zip(signals, both, strict=True))
        better = sum(b < a for a, b in both)
        out.append(
            found(f"noise {std:g} rad: tail rms, robust / ekf", f"{text} (ekf better in {better} of {len(both)})")
        )
    a, b = (runs[name].within for name in ("robust", "ekf"))
    text = f"robust {a[0]:.2f}, {a[1]:.2f} s; ekf {b[0]:.2f}, {b[1]:.2f} s"
    out.append(found("no noise, nominal start: viscosities within 5 % from", text))
    return out
