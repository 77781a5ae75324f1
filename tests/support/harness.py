"""Small cases for tests: one run traced tick by tick, on the cart or on any linear plant, at one compiled shape.

The plants here are not degenerate: `ODD` has three states, two inputs and two outputs, no symmetry, and its inputs differ
at every tick.
"""

from typing import Any, NamedTuple

import jax
import numpy as np

from pcbench.dynamics import linear
from pcbench.observers import OBSERVERS
from pcbench.protocols import Plant
from pcbench.simulation import rng
from pcbench.simulation import trajectory as one_run
from pcbench.simulation.schedule import common_times
from pcbench.simulation.trajectory import Recording
from pcbench.simulation.types import GridPointParams, Layout
from pcbench.synthesis.certificate import DesignContext

RING, SLOTS = 512, 2  # room for a sample at every tick with a delay of 400: one shape for every test


class Params(NamedTuple):
    Phi: Any
    Gamma: Any
    C: Any


LINEAR = Plant(
    step=lambda params, now, x: params.Phi[now.tick] @ x + params.Gamma[now.tick] @ now.u,
    output=lambda params, now, x: params.C @ x,
)
CART = linear.Model(np.array([[0.0, 1.0], [0.0, -122.0]]), np.array([[0.0], [355.0]]), np.array([[1.0, 0.0]]))
ODD = linear.Model(
    np.array([[-1.0, 2.0, 0.3], [-4.0, -0.5, 1.0], [0.2, -0.7, 0.1]]),
    np.array([[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]]),
    np.array([[1.0, 0.2, 0.0], [0.0, -0.4, 1.5]]),
)
PUSHED = ODD._replace(E=np.array([[1.0], [0.3], [0.2]]))
FIND_INPUTS = ("smo", "pio")  # they need a plant with an unknown input, and move by Runge-Kutta: see test_unknown_input
# no linear model is enough for the first, and one output for the second: test_helicopter, test_high_gain_predictor
ELSEWHERE = (*FIND_INPUTS, "high-gain", "high-gain-predictor")
CHAINS = ("eso", "super-twisting", "cdob")  # they need a chain of integrators, with one output
TWO_AXES = linear.Model(np.eye(4, k=2), np.eye(4, 2, -2), np.eye(2, 4))  # positions, rates; and their frictions


def friction(u: Any, x: Any) -> Any:
    """Return (a, phi) of TWO_AXES with frictions p: accelerations a p + phi."""
    return -x[2:], u - x[:2]


def suitable(observer: str) -> list[linear.Model]:
    """Models that an observer can be designed for."""
    linear_models = [PUSHED] if observer in FIND_INPUTS else [CART] if observer in CHAINS else [CART, ODD]
    return {"high-gain": [TWO_AXES], "high-gain-predictor": [CART]}.get(observer, linear_models)


class Case(NamedTuple):
    """One run; times in ticks of h seconds."""

    model: linear.Model
    te: int
    d: int
    ticks: int = 900
    h: float = 1e-3
    noise_std: float = 0.0
    x0: Any = None
    xhat0: Any = None
    u: Any = None  # [N+1, m]
    seed: int = 0
    Phi: Any = None  # [N+1, n, n] and
    Gamma: Any = None  # [N+1, n, m], where the plant is not the model
    input_intensity: float = 0.0


def inputs(case: Case) -> np.ndarray:
    """Different at every tick, and never small."""
    if case.u is not None:
        return case.u
    m = case.model.B.shape[1]
    return np.random.default_rng(7).normal(size=(case.ticks + 1, m)) * 3 + 1


def starts(case: Case) -> tuple[np.ndarray, np.ndarray]:
    n = len(case.model.A)
    x0 = np.arange(1.0, n + 1) * [5.0, -3.0, 2.0, 1.5][:n] if case.x0 is None else np.asarray(case.x0, float)
    return x0, np.zeros(n) if case.xhat0 is None else np.asarray(case.xhat0, float)


def context_of(case: Case) -> DesignContext:
    q, n = case.model.C.shape
    prior = np.diag(np.arange(1.0, n + 1) ** 2)
    chain = case.model is TWO_AXES
    many = 2 if chain else 0 if case.model.E is None else case.model.E.shape[1]
    return DesignContext(
        "case", case.model, case.h, case.ticks, (case.te,) * q, (case.d,) * q, (case.noise_std,) * q, prior,
        case.input_intensity, flight=case.d // case.te + 1, latest=case.d, unknown_std=(1.0,) * many, unknown0=(0.0,) * many,
        unknown_range=((-np.inf, np.inf),) * many, parts=jax.tree_util.Partial(friction) if chain else None,
    )  # fmt: skip


def problem(case: Case, observers: dict[str, dict[str, Any]]) -> tuple[Layout, GridPointParams]:
    """Observers are name -> options."""
    q, n = case.model.C.shape
    known = context_of(case)
    Phi, Gamma = linear.one_tick(case.model, case.h)
    every = (case.ticks + 1,)
    params = Params(
        np.broadcast_to(Phi, every + Phi.shape) if case.Phi is None else case.Phi,
        np.broadcast_to(Gamma, every + Gamma.shape) if case.Gamma is None else case.Gamma,
        case.model.C,
    )
    x0, xhat0 = starts(case)
    plan = common_times.pad_slots(common_times.periodic([case.te] * q, [case.d] * q, case.ticks), SLOTS)
    gains = {o: OBSERVERS[o].design(known, OBSERVERS[o].options(**given)).gains for o, given in observers.items()}
    n_ticks = case.ticks
    p = GridPointParams(
        params, gains, plan, inputs(case), np.asarray(case.h), x0, xhat0, np.eye(n), np.full(q, case.noise_std),
        np.ones(n), np.full(n, 1e9), np.array([[0, n_ticks // 2], [n_ticks // 2, n_ticks - 1], [n_ticks - 1, n_ticks]]),
    )  # fmt: skip
    layout = Layout(LINEAR, tuple((o, OBSERVERS[o].observer) for o in observers), 8, RING, False)
    return layout, jax.tree.map(np.asarray, p)


def recorder() -> Any:
    """Return what records a run, compiled once for each shape."""
    return one_run.jit_record()


def trace(case: Case, observers: dict[str, dict[str, Any]]) -> Recording:
    """Run one seed; arrays [N+1, ...]."""
    layout, p = problem(case, observers)
    return jax.tree.map(np.asarray, recorder()(layout, p, np.asarray(0), np.asarray(case.seed)))


def noise(case: Case) -> list[np.ndarray]:
    """The additive noise of each channel, as the run draws it."""
    q = len(case.model.C)
    draw = rng.measurement_noise(0, case.seed, case.ticks // case.te + 1, q)
    return [case.noise_std * np.asarray(draw[j]) for j in range(q)]
