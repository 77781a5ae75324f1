"""The sliding-mode and the PI observer on the arm: Table 2, what is said of it, and what remains of it on samples.

Source: Peng, Appl. Sci. 2017, 7(1), 67, section 5. The sampled comparison is ours.
"""

import numpy as np
import pandas as pd
from scipy.linalg import expm

from pcbench import api, planning
from pcbench.observers import smo
from pcbench.papers import arm_gains, arm_table
from pcbench.papers.claim import Claim, found, statement
from pcbench.planning import padding, run_local
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study import Study, options_of
from pcbench.study.grid import cell_of
from pcbench.study.times import whole

SEEDS = 256


def claims() -> list[Claim]:
    """Return printed against reproduced, for `pcbench reproduce arm`."""
    with config.float64():
        return [*arm_table.claims(), *arm_gains.claims(), *_findings(), *_sampled()]


def _findings() -> list[Claim]:
    """What Table 2 compares, and what it does not."""
    parts = arm_gains.parts()
    A11b = parts.A11 - smo.PRINTED.L1 @ parts.A211
    signals = list(arm_table.SIGNALS.values())[:4]
    frame = api.simulate("arm/sine", ["smo", "pio"])
    e = {o: frame[signals].to_numpy() - frame[[f"{o}.{s}" for s in signals]].to_numpy() for o in ("smo", "pio")}
    ebar = {o: each[:, [0, 3]] - each[:, [2]] * smo.PRINTED.L1[:, 0] for o, each in e.items()}
    k = whole(6.0, SCENARIOS["arm/sine"])
    off_by = max(np.abs(b[k] - expm(6 * A11b) @ b[0]).max() for b in ebar.values())
    jump = arm_table.nominal().query("scenario == 'arm/sawtooth' and signal == 'input'")
    recovery = jump.set_index("observer").recovery_time * 1e3
    falls = api.simulate("arm/sawtooth", ["smo", "pio"])
    tail = falls[falls.t > 6.0 - 1e-9]
    apart = {o: np.abs(tail.input.to_numpy() - tail[f"{o}.input"].to_numpy()) for o in ("smo", "pio")}
    when = sorted({f"{tail.t.to_numpy()[int(np.argmax(each))]:g}" for each in apart.values()})
    worst_d = {o: each.max() for o, each in apart.items()}
    size = {dt: _chatter(dt) for dt in (4e-4, 1e-4)}
    steps = ", ".join(f"{e3:.1e} with steps of {dt:g} s" for dt, e3 in size.items())
    steps_of_d = np.diff(falls.input.to_numpy())
    times = [f"{falls.t.to_numpy()[k + 1]:g}" for k in np.flatnonzero(np.abs(steps_of_d) > 0.1)]
    off = {f"{tau:g}": _just_after(falls, tau) for tau in (2.0, 4.0, 6.0, 8.0)}
    text = f"d jumps at {', '.join(times)} s; PIO's d is {min(off.values()):.2f} or more off there, SMO's as well"
    close = "but for rounding" if off_by < 1e-9 else f"but for {off_by:.0e}"
    return [
        *_compared(),
        statement(
            "under d2 SMO has the smaller largest error of d",
            ".3389 < .3517",
            f"both at t = {' and '.join(when)} s, the jump itself; back within 0.1 after {recovery['smo']:.1f} ms (SMO), "
            f"{recovery['pio']:.1f} ms (PIO)",
            bool(worst_d["smo"] < worst_d["pio"]),
        ),
        statement(
            "under d2 PIO's d deviates at", "2, 4, 6, 8 s", text, set(off) <= set(times) and min(off.values()) > 0.1
        ),
        found(
            "what the columns x1, x4 of Table 2 compare",
            f"ebar1 is e^(A11b t) of the initial error in both observers, {close} at 6 s",
        ),
        found(
            "what PIO's largest error of x3 (printed 1.3686e-6) is made of",
            steps,
            "chatter of the integration, some 1e-6 with steps of 1e-4 s: it shrinks with the step",
        ),
    ]


def _just_after(falls: pd.DataFrame, tau: float) -> float:
    """PIO's error of d at a jump."""
    row = falls.iloc[int(np.argmin(np.abs(falls.t.to_numpy() - tau)))]
    return float(abs(row["input"] - row["pio.input"]))


def _compared() -> list[Claim]:
    """Section 5: under d1 PIO is said to be better; column by column."""
    out = []
    for what in arm_table.METRICS:
        size = {o: {x: arm_table.entry("d1", o, x, what) for x in arm_table.SIGNALS} for o in ("smo", "pio")}
        lower = {x: size["pio"][x] < size["smo"][x] for x in arm_table.SIGNALS}
        text = f"smaller in {', '.join(x for x, less in lower.items() if less)}"
        text += "".join(f"; not in {x}" for x, less in lower.items() if not less)
        out.append(statement(f"under d1 PIO has the smaller {what} errors", "better", text, all(lower.values())))
    return out


def _chatter(dt: float) -> float:
    """PIO's largest error of x3 from 6 s on, integrated with another step."""
    base = SCENARIOS["arm/sine"]
    one = base.having(dt=dt, duration=10.0 + dt, sampling_period=(dt, dt))
    study = Study(name="step", scenarios=["arm/sine"], seeds=1)
    drafted = planning.draft(cell_of(one), {"pio": options_of(study, one, "pio")})
    (done,) = run_local.execute(study, padding.fit([drafted]))
    return float(done.results["pio"]["steady_max_abs_error"][2, 0])


def _sampled() -> list[Claim]:
    """What remains of the comparison on samples: root-mean-square error of link velocity from 6 s on."""
    four = ["smo", "pio", "smo-hold", "pio-hold"]
    quiet = {"delay": [0.0], "noise_std": [0.0], "sampling_period": [0.01, 0.2]}
    rows = api.run("arm/sampled", observers=four, seeds=1, axes=quiet).runs.query("signal == 'link_velocity'")
    rms = rows.set_index(["observer", "sampling_period"])["steady_rmse"].to_dict()
    out = []
    for label, what in (("-hold", "y held"), ("", "y predicted")):
        for te in (0.01, 0.2):
            a, b = rms["smo" + label, te], rms["pio" + label, te]
            claim = f"sampled every {te:g} s, {what}: x2 rms"
            out.append(found(claim, f"SMO {a:.4g}, PIO {b:.4g} rad/s", f"SMO {a:.3g}, PIO {b:.3g} rad/s"))
    late = ["smo", "pio", "smo-reconstruct", "pio-reconstruct", "kf"]
    mean, half = _rms(api.run("arm/sampled", observers=late, seeds=SEEDS).stats)
    for names, what in ((late[:2], "without"), (late[2:], "with")):
        text = ", ".join(f"{name.split('-')[0]} {mean[name]:.3g} +- {half[name]:.1g}" for name in names)
        claim = f"te = d = 0.02 s, noise 1e-3, prediction {what} the input found: x2 rms"
        out.append(found(claim, text + " rad/s"))
    noisy = {"delay": [0.0], "noise_std": [1e-3, 3e-3], "sampling_period": [0.005]}
    stats = api.run("arm/sampled", observers=["smo", "pio"], seeds=SEEDS, axes=noisy).stats
    for std in noisy["noise_std"]:
        mean, half = _rms(stats[stats.noise_std == std])
        text = ", ".join(f"{name.upper()} {mean[name]:.3g} +- {half[name]:.1g}" for name in mean)
        out.append(found(f"te = 5 ms, noise {std:g}: x2 rms", text + " rad/s"))
    return out


def _rms(stats: pd.DataFrame) -> tuple[dict[str, float], dict[str, float]]:
    """Root-mean-square error of link velocity over the tail and all runs, and half its interval, by observer."""
    rows = stats.query("signal == 'link_velocity' and metric == 'steady_pooled_rmse'")
    names = [str(name) for name in rows.observer]
    return dict(zip(names, rows["mean"], strict=True)), dict(zip(names, (rows.ci_high - rows.ci_low) / 2, strict=True))
