"""Single runs of the helicopter, and of the observer as its text reads without minus signs.

Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206, section 5.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.tree_util import Partial

from pcbench import planning
from pcbench.observers import high_gain
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.plants import helicopter
from pcbench.protocols import Arrival, Now
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import trajectory
from pcbench.study import Choices, Study, options_of
from pcbench.study.grid import cell_of

VISCOSITY = np.array([0.8, 0.318])
TAIL = 10_000  # tick
FULL = {"feedforward": True, "predictor": True}
CASES: dict[str, tuple[str, str, dict[str, Any], dict[str, Any]]] = {  # name: scenario, observer, choices, changes
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
MISPRINTS = {  # how the text reads without its minus signs, or as printed: (alpha_1, products in f_1, innovation, history)
    "alpha_1 with the yaw rate, as printed": (1.0, 1.0, 1.0, 1.0),
    "f_1 with + m l^2 sin cos psi'^2": (0.0, -1.0, 1.0, 1.0),
    "innovation with its sign turned": (0.0, 1.0, -1.0, 1.0),
    "innovation with + alpha(t_k - tau)": (0.0, 1.0, 1.0, -1.0),
}


class Flight:
    """One run of 20 s: the truth x [N+1, 6], the estimate z [N+1, 6], the set point [N+1, 2]."""

    def __init__(self, out: trajectory.Recording) -> None:
        self.x, self.z, self.target = (np.asarray(a) for a in (out.x, next(iter(out.estimates.values())), out.target))

    def rms(self, what: np.ndarray, start: int = TAIL) -> np.ndarray:
        """Root of the mean square from a tick on, tick N left out."""
        return np.sqrt((what[start:-1] ** 2).mean(0))

    @property
    def diverged(self) -> float:
        """Return when the error left the bound [s]; NaN: never."""
        bad = ~(np.abs(self.x - self.z).max(1) <= 1e6)
        return float(np.argmax(bad) * 1e-3) if bad.any() else float("nan")

    @property
    def off(self) -> np.ndarray:
        """Return the rms of set point less angles in the tail [rad]."""
        return self.rms(self.target - self.x[:, :2])

    @property
    def within(self) -> np.ndarray:
        """Return when each viscosity was last more than 5 % off [s]."""
        outside = ~(np.abs(self.z[:-1, 4:] - VISCOSITY) <= 0.05 * VISCOSITY)
        last = np.where(outside.any(0), len(outside) - np.argmax(outside[::-1], 0), 0)
        return np.where(last >= len(outside), np.inf, last * 1e-3)


def record() -> dict[str, Flight]:
    """Run every case once, all of one shape."""
    drafts = [_draft(*CASES[name]) for name in CASES]
    return {name: Flight(_recorded(p)) for name, p in zip(CASES, padding.fit(drafts), strict=True)}


def _draft(name: str, observer: str, choices: dict[str, Any], changes: dict[str, Any]) -> Plan:
    parameters = {k: v for k, v in changes.items() if k == "m"}
    s = SCENARIOS["helicopter/" + name].having(**{k: v for k, v in changes.items() if k not in parameters})
    options = options_of(Study(name="reproduce", scenarios=[s.name]), s, observer)
    return planning.draft(cell_of(s, parameters=parameters, choices=Choices(**choices)), {observer: options})


def _recorded(p: Plan) -> trajectory.Recording:
    out = trajectory.compiled()(p.layout, p.problem, np.asarray(0), np.asarray(0))
    return jax.tree.map(np.asarray, out)


def _literal(params: Any, read: Any, u: Any, x: Any) -> Any:
    """The parts of the plant with the misprints that `read` says."""
    a, phi = helicopter.parts(params, u, x)
    M = helicopter.inertia(params, x[0])
    cross = params.ml2 * jnp.sin(x[0]) * jnp.cos(x[0]) * x[3] ** 2 / M[0]
    a = a.at[0].set((1 - read[0]) * a[0] - read[0] * x[3] / M[0])
    return a, phi.at[0].add((1 - read[1]) * cross)


def _jump(gains: Any, memory: Any, now: Now, arrival: Arrival) -> Any:
    """The observer's jump with the signs of the innovation that its parts carry."""
    read = gains.parts.args[1]
    snapshot = arrival.snapshot[:2] + (1 - read[3]) * arrival.snapshot[2:]
    jumped = high_gain.jump(gains, memory, now, arrival._replace(snapshot=snapshot))
    return jumped._replace(c=jnp.where(arrival.mask, read[2] * jumped.c, jumped.c))


def _note(gains: Any, memory: Any, now: Now) -> Any:
    """C z - al, and al."""
    return jnp.concatenate([high_gain.snapshot(gains, memory, now), memory.al])


def misread() -> dict[str, Flight]:
    """Run the printed observer as restored, and with one misprint at a time; all in one program."""
    (p,) = padding.fit([_draft(*CASES["constant"])])
    observer = high_gain.OBSERVER._replace(snapshot=_note, jump=_jump)
    layout = p.layout._replace(observers=(("high-gain", observer),))
    out = {}
    for what, read in {"": (0.0, 1.0, 1.0, 1.0), **MISPRINTS}.items():
        parts = Partial(_literal, p.problem.params, np.array(read))
        gains = {"high-gain": p.problem.gains["high-gain"]._replace(parts=parts)}
        out[what] = Flight(_recorded(p._replace(layout=layout, problem=p.problem._replace(gains=gains))))
    return out
