"""PCO and PI-PCO as a reduced-order observer: the theta form (15)-(17), where it is stable, and how much noise is left.

The theta form is `reference.irregular.pco_theta`, in NumPy and from tick to tick. Everything after it linearises pcbench's own
step and compares with the closed forms: F = A22 - Kp A12, k = Ki A12, one output and one unmeasured state.
"""

from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import CART, ODD, SLOTS, Case, context_of, inputs, noise, problem, recorder, starts
from reference import irregular as reference
from reference import linear
from scipy.linalg import solve_discrete_lyapunov

from pcbench.engine import event_loop
from pcbench.errors import DesignError
from pcbench.observers import OBSERVERS, pco
from pcbench.observers.parts.prediction import Motion, Point
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.simulation.schedule import common_times, sampling
from pcbench.simulation.schedule.common_times import NEVER
from pcbench.simulation.schedule.sampling import Clock
from pcbench.synthesis import reduced_order

SCHEDULES = {  # ticks: intervals in turn; the least and the largest age (None: one interval); the share that is lost
    "sine": ([sampling.interval(Clock((0,), 60, None, "sine"), i) for i in range(1, 20)], None, 0.0),
    "any intervals": ([33, 89, 41, 60, 77, 30, 52], None, 0.0),
    "one age": ([70, 25, 40], (80, 80), 0.0),
    "jitter and loss": ([50, 31, 69, 48], (40, 60), 0.4),
    "together": ([12, 40, 15, 31], (20, 40), 0.0),  # a late one and the next may arrive at one tick
}
GIVEN = {  # F = 0.5, k = 0.1 on the cart; on the odd plant F is about 0.5 to 0.7, too
    "cart": {"pco": {"Kp": -61.0}, "pi-pco": {"Kp": -61.0, "Ki": 12.2}},
    "odd": {"pco": {}, "pi-pco": {}},
}


def case_of(plant):
    if plant == "cart":
        return Case(CART, 50, 60, ticks=700, noise_std=0.3, seed=2, x0=[5.0, 10.0])
    return Case(ODD, 50, 60, ticks=700, h=0.01, noise_std=0.2, seed=3, xhat0=[0.5, -1.0, 2.0])


@cache
def found_gains(plant):
    """Kp and Ki that are certified over every interval of 10 to 139 ticks, so over those of each clock here."""
    known = context_of(case_of(plant))._replace(intervals=tuple(range(10, 140)))
    return {
        name: OBSERVERS[name].design(known, OBSERVERS[name].options(**options)).gains
        for name, options in GIVEN[plant].items()
    }


def times_of(schedule, ticks):
    """(taken, arrives) of every sample, in order; arrives is None where it is lost."""
    gaps, ages, loss = SCHEDULES[schedule]
    rng = np.random.default_rng(4)
    taken = np.cumsum([0, *np.resize(gaps, 2 * ticks // gaps[0])])
    ages = np.diff(taken) if ages is None else rng.integers(ages[0], ages[1] + 1, len(taken) - 1)
    arrives = np.maximum.accumulate(taken[:-1] + ages)  # never before an older one
    lost = rng.uniform(size=len(ages)) < loss
    return [(int(a), None if gone else int(b)) for a, b, gone in zip(taken, arrives, lost, strict=False) if a <= ticks]


def run(plant, schedule):
    """The case, pcbench's recording of pco and pi-pco, and the reference's samples."""
    case = case_of(plant)
    q, times = len(case.model.C), times_of(schedule, case.ticks)
    found = [
        common_times.Sample(j, i, a, NEVER if b is None else b) for i, (a, b) in enumerate(times) for j in range(q)
    ]
    layout, p = problem(case, {})
    layout = layout._replace(observers=tuple((name, OBSERVERS[name].observer) for name in GIVEN[plant]))
    plan = common_times.pad_slots(common_times.schedule(found, case.ticks, q), SLOTS)
    p = p._replace(schedule=plan, gains=found_gains(plant))
    got = recorder()(layout, jax.tree.map(np.asarray, p), np.asarray(0), np.asarray(case.seed))
    model = linear.Model(case.model.A, case.model.B, case.model.C, case.h)
    _, samples = reference.simulate(model, inputs(case), starts(case)[0], [times] * q, noise(case._replace(te=1)))
    return case, jax.tree.map(np.asarray, got), model, samples


@pytest.mark.parametrize("schedule", SCHEDULES)
@pytest.mark.parametrize("plant", ["odd", *(pytest.param(p, marks=pytest.mark.nightly) for p in GIVEN if p != "odd")])
def test_the_observers_are_the_theta_form_and_the_reference(plant, schedule):
    """To 1e-12 of the largest state: some ten samples, each a product of matrices of size 1."""
    case, got, model, samples = run(plant, schedule)
    for name, gains in found_gains(plant).items():
        Ki = gains.Ki if name == "pi-pco" else None
        for form in (reference.pco_theta, reference.pco):
            want = form(model, inputs(case), samples, starts(case)[1], gains.T, gains.Kp, Ki)
            size = max(np.abs(want).max(), np.abs(got.x).max())
            np.testing.assert_allclose(got.estimates[name], want, rtol=0, atol=1e-12 * size)
    assert np.abs(got.estimates["pco"] - got.estimates["pi-pco"]).max() > 1e-3 * size, "the integral does something"


def test_the_schedules_are_what_they_are_called():
    times = {name: times_of(name, 700) for name in SCHEDULES}
    assert any(b is None for _, b in times["jitter and loss"])
    arrivals = [b for _, b in times["together"]]
    assert len(set(arrivals)) < len(arrivals)
    assert {b - a for a, b in times["one age"]} == {80}


# the step itself


def step_of(F, k, A12=0.4):
    """pcbench's step from sample to sample as s -> J s + b v, s = [inv(T) [y; w] (2), L], and A_d; true state 0.

    One tick between samples, A11 = 1, A21 = A22 = 0.
    """
    Ad = jnp.array([[1.0, A12], [0.0, 0.0]])
    table = jnp.stack([jnp.eye(2), Ad])
    motion = Motion(Ad, jnp.zeros((2, 1)), jnp.stack([table, jnp.stack([jnp.eye(2), Ad @ Ad])]))
    gain = jnp.array([[-F / A12]]), jnp.array([[k / A12]])
    gains = pco.Gains(motion, jnp.eye(2), jnp.eye(2), jnp.zeros((1, 1)), *gain, jnp.zeros(0))

    def step(s, v):
        before = pco.ReducedState(Point(s[:2], jnp.asarray(3)), s[2:], jnp.asarray(True))
        after = pco.step_reduced(gains, before, Measurement(jnp.asarray(4), v[None], jnp.array([True]), jnp.zeros(2)))
        return jnp.concatenate([after.point.free, after.L])

    return *jax.jacfwd(step, (0, 1))(jnp.zeros(3), jnp.asarray(0.0)), Ad


def steps(F, k):
    """(J, b, A_d) for each F and k, as NumPy arrays."""
    return list(zip(*map(np.asarray, STEPS(np.asarray(F), np.asarray(k))), strict=True))


STEPS = jax.jit(jax.vmap(step_of))
GRID = [(F, k) for F in np.linspace(-2.9, 0.9, 39) for k in np.linspace(0.05, 3.95, 40)]
EDGE = 0.04  # a tenth of the grid's step: nearer, the Lyapunov equation loses digits


def inside(F, k):
    """How far (F, k) stands inside the stability region, > 0 where it does."""
    return min(k, 1 - F - k, 2 + 2 * F + k)


def variance(J, b, Ad):
    """Var of the predicted position error over that of the noise, from S = J S J' + b b'; without L where nothing drives it."""
    n = 3 if b[2] else 2
    S = solve_discrete_lyapunov(J[:n, :n], np.outer(b[:n], b[:n]))
    return Ad[0] @ S[:2, :2] @ Ad[0]


STABLE = np.array([(F, k) for F, k in GRID if inside(F, k) > EDGE])


def test_the_steps_stationary_variance_is_the_closed_form():
    F, k = STABLE.T
    assert len(F) > 300
    got = [variance(*step) for step in steps(F, k)]
    want = (2 * F**2 + 3 * F * k - 4 * F + k**2 - k + 2) / ((1 - F - k) * (2 * F + k + 2))
    np.testing.assert_allclose(got, want, rtol=1e-10)


def test_without_the_integral_it_is_1_minus_f_over_1_plus_f():
    F = np.linspace(-0.95, 0.95, 39)
    np.testing.assert_allclose([variance(*step) for step in steps(F, 0 * F)], (1 - F) / (1 + F), rtol=1e-10)


def test_the_integral_lowers_the_variance_only_for_negative_f_and_k_below_minus_2f():
    F, k = STABLE[(np.abs(STABLE[:, 0]) < 0.99) & (np.abs(STABLE @ [2, 1]) > 1e-6)].T
    pi_pco, pco = (np.array([variance(*step) for step in steps(F, each)]) for each in (k, 0 * k))
    lower = (F < 0) & (k < -2 * F)
    assert 20 < lower.sum() < len(lower) - 20
    np.testing.assert_array_equal(pi_pco < pco, lower)


def test_the_step_is_stable_exactly_inside_the_region():
    """Of s the measured part y forgets: its eigenvalue is 0, the others are those of J."""
    pairs = [(F, k) for F in np.linspace(-3.2, 1.2, 45) for k in np.linspace(-0.5, 4.4, 50) if abs(inside(F, k)) > 1e-6]
    J = np.stack([step[0] for step in steps(*np.array(pairs).T)])
    radius = np.abs(np.linalg.eigvals(J)).max(-1)
    assert 0.1 < (radius < 1).mean() < 0.9
    np.testing.assert_array_equal(radius < 1, [inside(F, k) > 0 for F, k in pairs])


def test_the_jacobian_that_is_certified_is_stable_exactly_inside_the_region():
    """With A22 != 0, too."""
    rng, one = np.random.default_rng(5), np.ones((1, 1))
    for _ in range(200):
        F, k, A12, A22 = (
            rng.uniform(-3, 1),
            rng.uniform(-0.5, 4),
            rng.choice([-1, 1]) * rng.uniform(0.1, 2),
            rng.normal(),
        )
        J, alone = (
            reduced_order.jacobian(A12 * one[None], A22 * one[None], (A22 - F) / A12 * one, Ki)[0]
            for Ki in (k / A12 * one, None)
        )
        assert (np.abs(np.linalg.eigvals(J)).max() < 1) == (inside(F, k) > 0)
        np.testing.assert_allclose(alone, F * one, atol=1e-12)


def test_the_jacobian_that_is_certified_is_the_steps():
    """The step moves what is estimated of w, J what is wrong with it: the sign of w is turned."""
    F, k, A12, turned = np.array([0.5, -0.7, 0.2]), np.array([0.1, 0.4, 0.9]), 0.4, np.diag([-1.0, 1.0])
    for (J, _, Ad), f, c in zip(steps(F, k), F, k, strict=True):
        assert Ad[0, 1] == A12
        blocks = (np.full((1, 1, 1), v) for v in (A12, 0.0))
        certified = reduced_order.jacobian(*blocks, np.full((1, 1), -f / A12), np.full((1, 1), c / A12))[0]
        np.testing.assert_allclose(turned @ J[1:, 1:] @ turned, certified, atol=1e-12)


@pytest.mark.parametrize(
    ("F", "k"),
    [(0.5, 0.1), (0.5, 0.45), (-0.9, 0.3), (-1.2, 1.5), (0.5, 0.55), (0.5, -0.05), (-1.2, 0.35), (0.0, 1.05)],
)
def test_gains_are_certified_exactly_where_they_are_stable(F, k):
    """On the cart over one interval of 0.2 s, A22 = e^(-24.4)."""
    known = context_of(case_of("cart"))._replace(intervals=(200,))
    A12, A22 = (1 - np.exp(-24.4)) / 122, np.exp(-24.4)
    options = OBSERVERS["pi-pco"].options(Kp=(A22 - F) / A12, Ki=k / A12)
    if inside(F, k) > 0:
        assert OBSERVERS["pi-pco"].design(known, options).certificate.margin > 0
    else:
        with pytest.raises(DesignError):
            OBSERVERS["pi-pco"].design(known, options)


@pytest.mark.nightly
def test_the_closed_form_is_what_many_runs_leave():
    """Position on the cart over intervals of 0.2 s, start known: within four standard errors of 1024 runs."""
    case = Case(CART, 20, 20, ticks=3000, h=0.01, noise_std=0.3, x0=[5.0, 10.0], xhat0=[5.0, 10.0])
    layout, p = problem(case, GIVEN["cart"])
    run = jax.jit(event_loop.simulate, static_argnums=0)
    out = run(layout._replace(width=1024), p, jnp.asarray(0), jnp.arange(1024))
    for name, want in (("pco", 1 / 3), ("pi-pco", 14 / 31)):  # F = 0.5, k = 0.1
        square = np.asarray(out.streams[name].square)[1:, 0].sum(0) / (case.ticks - case.ticks // 2) / case.noise_std**2
        assert abs(square.mean() - want) < 4 * square.std() / np.sqrt(1024)
        assert square.std() / np.sqrt(1024) < 0.01 * want
