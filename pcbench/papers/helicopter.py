"""The high-gain observer on the helicopter: its claims with both delays, the effect of misprints, and further findings.

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 5. The paper prints figures without numbers. Random
initial states, noise, the filter and the controller's options are decided here. Single runs are recorded one by one, as are
those of the observer as printed without minus signs.
"""

from collections.abc import Iterator
from math import isfinite, isnan

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jax import Array
from jax.tree_util import Partial

from pcbench import api, planning
from pcbench.observers import high_gain
from pcbench.papers.claim import FINDING, MISPRINT, Claim, digits, report_finding, statement
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.plants import helicopter
from pcbench.protocols import Arrival, Now
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import trajectory
from pcbench.statistics.aggregate import Row
from pcbench.study import Choices, Study, options_of
from pcbench.study.grid import cell_of
from pcbench.synthesis import sampled_high_gain
from pcbench.toml_text import TomlTable

SEEDS = 256
RANDOM: dict[str, TomlTable] = {"scenario": {"random_initial_state": True}}
NAMES = {"high-gain": "printed", "high-gain-robust": "robust"}
HEAVY = {"robust": "heavy", "ekf": "heavy, ekf"}
VISCOSITY = np.array([0.8, 0.318])
TAIL = 10_000  # tick
FULL = {"feedforward": True, "predictor": True}
CASES: dict[str, tuple[str, str, TomlTable, TomlTable]] = {  # name: scenario, observer, choices, changes
    "constant": ("constant", "high-gain", {}, {}),
    "varying": ("varying", "high-gain", {}, {}),
    "robust": ("constant", "high-gain-robust", {}, {}),
    "ekf": ("constant", "ekf", {}, {}),
    "full": ("constant", "high-gain", FULL, {}),
    "full, varying": ("varying", "high-gain", FULL, {}),
    "still": ("constant", "high-gain", {"path": "still"}, {}),
    "still, true": ("constant", "high-gain", {"path": "still"}, {"xhat0": SCENARIOS["helicopter/constant"].truth.x0}),
    "late samples": ("constant", "high-gain-robust", {}, {"delay": (0.15, 0.15), "actuator_delay": 0.025}),
    "late commands": ("constant", "high-gain-robust", {}, {"actuator_delay": 0.15}),
    "heavy": ("constant", "high-gain-robust", {}, {"m": 1.1 * helicopter.Numbers().m}),
    "heavy, ekf": ("constant", "ekf", {}, {"m": 1.1 * helicopter.Numbers().m}),
}
MISPRINTS = {  # the printed text without its minus signs: (alpha_1, products in f_1, innovation, history)
    "alpha_1 with the yaw rate, as printed": (1.0, 1.0, 1.0, 1.0),
    "f_1 with + m l^2 sin cos psi'^2": (0.0, -1.0, 1.0, 1.0),
    "innovation with the opposite sign": (0.0, 1.0, -1.0, 1.0),
    "innovation with + alpha(t_k - tau)": (0.0, 1.0, 1.0, -1.0),
}


class Flight:
    """One run of 20 s: the truth x [N+1, 6], the estimate z [N+1, 6], the set point [N+1, 2]."""

    def __init__(self, out: trajectory.Recording) -> None:
        self.x, self.z, self.target = (np.asarray(a) for a in (out.x, next(iter(out.estimates.values())), out.target))

    def rms(self, errors: np.ndarray, start: int = TAIL) -> np.ndarray:
        """Return the root mean square from a tick on, without tick N."""
        return np.sqrt((errors[start:-1] ** 2).mean(0))

    @property
    def diverged(self) -> float:
        """Return the time at which the error exceeded the divergence threshold [s]; NaN: never."""
        bad = ~(np.abs(self.x - self.z).max(1) <= 1e6)
        return float(np.argmax(bad) * 1e-3) if bad.any() else float("nan")

    @property
    def off(self) -> np.ndarray:
        """Return the rms of set point minus angles in the tail [rad]."""
        return self.rms(self.target - self.x[:, :2])

    @property
    def within(self) -> np.ndarray:
        """Return the last time at which each viscosity was more than 5 % off [s]."""
        outside = ~(np.abs(self.z[:-1, 4:] - VISCOSITY) <= 0.05 * VISCOSITY)
        last = np.where(outside.any(0), len(outside) - np.argmax(outside[::-1], 0), 0)
        return np.where(last >= len(outside), np.inf, last * 1e-3)


def claims() -> list[Claim]:
    """Return the claims for `pcbench reproduce helicopter`."""
    with config.float64():
        runs = record()
        return [*_check_simulations(runs), *_misprint_claims(), *_control(runs), *_starts(), *_noise(runs)]


def _check_simulations(runs: dict[str, Flight]) -> Iterator[Claim]:
    """Yield the claims on the paper's two simulations."""
    for name, description in (("constant", "constant delay"), ("varying", "varying delay")):
        run = runs[name]
        B, times = run.z[-1, 4:], run.within
        text = f"{B[0]:.6f}, {B[1]:.6f} at 20 s"
        yield statement(f"{description}: the viscosities are estimated", "0.8, 0.318", text, bool(times.max() < 20))
        inside = f"from {times[0]:.2f} s and {times[1]:.2f} s on"
        yield report_finding(f"{description}: viscosities within 5 %", inside)
        e = run.rms(run.x - run.z)[:4]
        text = ", ".join(f"{v:.1e}" for v in e) + " rms from 10 s on"
        yield statement(f"{description}: the present state is estimated", "converges", text, bool(e.max() < 1e-3))
        for i, angle in enumerate(("pitch", "yaw")):
            claim, text = f"{description}: {angle} follows its path", f"{run.off[i]:.4f} rad rms from 10 s on"
            yield statement(claim, "satisfactorily", text, bool(run.off[i] < 0.05))
        late = [float(np.abs(run.x - run.z)[a:b, :4].max()) for a, b in ((1000, 2000), (5000, 6000), (10_000, 11_000))]
        text = ", ".join(f"{v:.1e}" for v in late) + " at most, in one second from 1, 5 and 10 s on"
        shrinks = late[2] < 0.1 * late[1] < 0.01 * late[0]
        yield statement(f"Remark 2, {description}: the error converges exponentially", "to zero", text, shrinks)
    off_change = runs["varying"].off[1] - runs["constant"].off[1], max(runs["varying"].off) - max(runs["constant"].off)
    text = (
        f"off the path by {off_change[0]:+.4f} rad (yaw), {off_change[1]:+.4f} rad (pitch) against the constant delay"
    )
    yield statement("varying delay: the control is more challenging", "more challenging", text, max(off_change) > 1e-3)
    s, t = SCENARIOS["helicopter/varying"], np.arange(20_000) * 1e-3
    longest = float(
        (float(s.sampling.delay[0]) + s.sampling.delay_sine[0] * np.sin(s.sampling.delay_sine[1] * t)).max()
    )
    yield digits("largest varying delay [s]", "0.045", longest)
    limit = sampled_high_gain.limit("predictor", 3)
    radius, far = (sampled_high_gain.radius("predictor", 3, 4.0 * period) for period in (0.2, 0.8))
    text = f"linear part: radius {radius:.2f} per sample at 0.2 s, {far:.2f} at 0.8 s; limit {limit / 4.0:.2f} s"
    claim = "beyond a limit of the sampling period it does not converge"
    yield statement(claim, "a limitation", text, bool(radius < 1 < far))


def _misprint_claims() -> Iterator[Claim]:
    """Yield the results of each reading of the printed text, one at a time."""
    for misprint, run in misprint_runs().items():
        divergence_time, B = run.diverged, run.z[-1, 4:]
        text = (
            f"viscosities {B[0]:.3f}, {B[1]:.3f} at 20 s"
            if isnan(divergence_time)
            else f"diverges at {divergence_time:.2f} s"
        )
        wrong = isfinite(divergence_time) or not np.isfinite(run.within).all()
        if misprint:
            yield Claim(misprint, "taken literally", text, MISPRINT if wrong else FINDING)
    yield Claim("unit of the viscosities, Table 1", "N/V", "N m s/rad, by the equations", MISPRINT)


def _control(runs: dict[str, Flight]) -> Iterator[Claim]:
    """Yield findings on the limits of the loop."""
    full = max(runs[name].off.max() for name in ("full", "full, varying"))
    divergence_time, converges = runs["still"].diverged, isnan(runs["still, true"].diverged)
    still = ("converges" if isnan(divergence_time) else f"diverges at {divergence_time:.2f} s") + (
        ", but not from the true state" if converges else ""
    )
    yield report_finding(
        "why the pitch is off its path",
        f"{full:.1e} rad rms with feedforward and predictor, {runs['constant'].off[0]:.3f} without, as the control has no "
        "gravity term",
    )
    yield report_finding("set point at rest, (1, 1) rad, printed observer", still)
    for name, description in (
        ("late samples", "samples delayed by 0.15 s, commands by 0.025 s"),
        ("late commands", "samples delayed by 0.025 s, commands by 0.15 s"),
    ):
        run = runs[name]
        text = f"yaw {run.off[1]:.3f} rad off its path, rms error of its rate {run.rms(run.x - run.z)[3]:.1e} rad/s"
        yield report_finding(description, text)
    heavy = {description: runs[name].rms(runs[name].z[:, 4:] - VISCOSITY) for description, name in HEAVY.items()}
    text = ", ".join(f"{b[0]:.2f} and {b[1]:.3f} ({description})" for description, b in heavy.items())
    yield report_finding("10 % more mass than the model: rms error of the viscosities", text)
    yield report_finding("linear limit of Theta Ts", f"{sampled_high_gain.limit('predictor', 3):.4f}")


def _rows(frame: pd.DataFrame) -> list[Row]:
    return [{str(k): v for k, v in row.items()} for row in frame.to_dict("records")]


def _starts() -> list[Claim]:
    """Return how often the observer diverges from random initial states, by sampling period."""
    axes = {"sampling_period": [0.05, 0.2, 0.8, 1.5]}
    result = api.run("helicopter/constant", observers=list(NAMES), seeds=SEEDS, axes=axes, options=RANDOM)
    unsettled_runs = result.runs[result.runs.signal.str.endswith("viscosity")].query("status == 'unsettled'")
    late = unsettled_runs.groupby(["observer", "sampling_period"]).seed.nunique().to_dict()
    texts: dict[float, list[str]] = {}
    for r in _rows(result.stats.query("signal == 'pitch_viscosity' and metric == 'divergence_rate'")):
        interval = f"{100 * r['ci_low']:.1f} .. {100 * r['ci_high']:.1f} %"
        never = late.get((r["observer"], r["sampling_period"]), 0)
        text = f"{NAMES[r['observer']]} {r['diverged']} of {r['n']} ({interval}), {never} others not within 5 %"
        texts.setdefault(r["sampling_period"], []).append(text)
    return [
        report_finding(f"random initial states, Ts = {te:g} s: runs that diverge", "; ".join(text))
        for te, text in texts.items()
    ]


def _noise(runs: dict[str, Flight]) -> Iterator[Claim]:
    """Yield the comparison of observer and filter, with noise and without."""
    names, stds = ["high-gain-robust", "ekf"], [5e-4, 2e-2]
    result = api.run("helicopter/constant", observers=names, seeds=SEEDS, axes={"noise_std": stds}, options=RANDOM)
    rows = _rows(result.stats.query("metric == 'steady_pooled_rmse'"))
    value = {(r["noise_std"], r["signal"], r["observer"]): r["mean"] for r in rows}
    signals = [name for name, _ in helicopter.SIGNALS + helicopter.UNKNOWNS]
    for std in stds:
        pairs = [tuple(value[std, signal, name] for name in names) for signal in signals]
        text = "; ".join(f"{signal} {a:.3g} / {b:.3g}" for signal, (a, b) in zip(signals, pairs, strict=True))
        better = sum(b < a for a, b in pairs)
        yield report_finding(
            f"noise {std:g} rad: steady rms, robust / ekf", f"{text} (ekf better in {better} of {len(pairs)})"
        )
    a, b = (runs[name].within for name in ("robust", "ekf"))
    text = f"robust {a[0]:.2f}, {a[1]:.2f} s; ekf {b[0]:.2f}, {b[1]:.2f} s"
    yield report_finding("no noise, nominal initial state: viscosities within 5 % from", text)


def record() -> dict[str, Flight]:
    """Return the recording of every case, all of one shape."""
    drafts = [_draft(*CASES[name]) for name in CASES]
    return {name: Flight(_record_trajectory(p)) for name, p in zip(CASES, padding.fit(drafts), strict=True)}


def _draft(name: str, observer: str, choices: TomlTable, changes: TomlTable) -> Plan:
    parameters = {k: v for k, v in changes.items() if k == "m"}
    s = SCENARIOS["helicopter/" + name].with_fields(**{k: v for k, v in changes.items() if k not in parameters})
    options = options_of(Study(name="reproduce", scenarios=[s.name]), s, observer)
    return planning.draft(cell_of(s, parameters=parameters, choices=Choices(**choices)), {observer: options})


def _record_trajectory(p: Plan) -> trajectory.Recording:
    out = trajectory.jit_record()(p.layout, p.problem, np.asarray(0), np.asarray(0))
    return jax.tree.map(np.asarray, out)


def _literal(params: helicopter.Params, reading: Array, u: Array, x: Array) -> tuple[Array, Array]:
    """Return the parts of the plant with the misprints in `reading`."""
    a, phi = helicopter.parts(params, u, x)
    M = helicopter.inertia(params, x[0])
    cross = params.ml2 * jnp.sin(x[0]) * jnp.cos(x[0]) * x[3] ** 2 / M[0]
    a = a.at[0].set((1 - reading[0]) * a[0] - reading[0] * x[3] / M[0])
    return a, phi.at[0].add((1 - reading[1]) * cross)


def _jump(gains: high_gain.Gains, memory: high_gain.Memory, now: Now, arrival: Arrival) -> high_gain.Memory:
    """Return the observer's memory after a jump, with the signs of the innovation in its parts."""
    reading = gains.parts.args[1]
    snapshot = arrival.snapshot[:2] + (1 - reading[3]) * arrival.snapshot[2:]
    after = high_gain.jump(gains, memory, now, arrival._replace(snapshot=snapshot))
    return after._replace(c=jnp.where(arrival.mask, reading[2] * after.c, after.c))


def _note(gains: high_gain.Gains, memory: high_gain.Memory, now: Now) -> Array:
    """C z - al, and al."""
    return jnp.concatenate([high_gain.snapshot(gains, memory, now), memory.al])


def misprint_runs() -> dict[str, Flight]:
    """Return the runs of the restored observer, and of one misprint at a time, from one program."""
    (p,) = padding.fit([_draft(*CASES["constant"])])
    observer = high_gain.OBSERVER._replace(snapshot=_note, jump=_jump)
    layout = p.layout._replace(observers=(("high-gain", observer),))
    out = {}
    for misprint, reading in {"": (0.0, 1.0, 1.0, 1.0), **MISPRINTS}.items():
        parts = Partial(_literal, p.problem.params, np.array(reading))
        gains = {"high-gain": p.problem.gains["high-gain"]._replace(parts=parts)}
        out[misprint] = Flight(_record_trajectory(p._replace(layout=layout, problem=p.problem._replace(gains=gains))))
    return out
