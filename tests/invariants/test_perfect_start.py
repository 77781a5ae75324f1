"""Perfect start: true model, true initial state, no noise => zero error, for every schedule and every observer that knows it.

The tolerance is rounding: 1e-12 of the largest state (a recursion of some hundred ticks rounds to a few 1e-14 of it).
One tick of slip anywhere breaks it; the mutants below show that.
"""

import jax
import numpy as np
import pytest
from harness import CART, CHAINS, ELSEWHERE, ODD, Case, context_of, problem, recorder, trace
from hypothesis import given, settings
from hypothesis import strategies as st

from pcbench.observers import LATE, NONLINEAR, OBSERVERS, finite_time, interval
from pcbench.protocols import Plant

KNOWING = {
    name: {}
    for name, entry in OBSERVERS.items()
    if entry.knows_schedule and name not in (*ELSEWHERE, *LATE, *NONLINEAR)
}
del KNOWING[
    "chain"
]  # needs whole samples, and from a perfect start sees only zeros: its slips are caught in test_chain
del KNOWING["cascade-predictor"]  # its links have the length of the delay, whatever an age is: test_cascade_predictor
SLIPPED = [
    pytest.param(name, marks=pytest.mark.nightly) if name in ("pco", "pi-pco") else name  # theirs: test_pco_forms too
    for name in KNOWING
    if name
    not in ("model-only", "lmi-sampled")  # this one compares a sample with its own snapshot: see test_lmi_sampled
]
START = {2: [5.0, 10.0], 3: [1.0, -2.0, 0.5]}


def perfect(model, te, d, ticks=400, h=1e-3):
    start = START[len(model.A)]
    return Case(model, te, d, ticks=ticks, h=h, x0=start, xhat0=start)


def error(got):
    size = np.abs(got.x).max()
    return {name: np.abs(got.x - xhat).max() / size for name, xhat in got.estimates.items()}


@settings(max_examples=10)
@given(te=st.integers(1, 399), d=st.integers(0, 399), odd=st.booleans())
def test_no_error_for_any_period_and_delay(te, d, odd):
    case = perfect(ODD, te, d, h=0.01) if odd else perfect(CART, te, d)
    elsewhere = {"ekf", "lmi-sampled"} | (
        {*CHAINS} if odd else set()
    )  # test_helicopter; no gain bears every period: test_lmi_sampled
    few = {name: options for name, options in KNOWING.items() if name not in elsewhere}
    observers = few | {"kfbo": {"sampled_innovation": True}}  # this variant of kfbo knows the schedule too
    found = error(trace(case, observers))
    gains = finite_time.design(context_of(case), finite_time.Options()).gains
    large = {
        "finite-time": (gains.K, gains.H),
        "interval": (interval.design(context_of(case), interval.Options()).gains.L,),
    }
    for observer, matrices in large.items():  # gains reach 15,000 on the cart
        largest = max(np.abs(np.asarray(a)).sum(-1).max() for a in matrices)
        assert found.pop(observer) < 1e-15 * (10 + largest), f"rounding times the gains of {observer}"
    assert max(found.values()) < 1e-12


@pytest.mark.parametrize("observer", SLIPPED)
@pytest.mark.parametrize("slip", [-1, 1])
def test_one_tick_of_slip_in_what_an_arrival_says_of_its_age_is_caught(observer, slip):
    layout, p = problem(perfect(CART, 40, 60), {observer: {}})
    mutated = p._replace(schedule=p.schedule._replace(timestamp=p.schedule.timestamp + slip))
    got = jax.tree.map(np.asarray, recorder()(layout, mutated, np.asarray(0), np.asarray(0)))
    assert error(got)[observer] > 1e-4


@pytest.mark.parametrize("observer", SLIPPED)
def test_delivering_the_neighbouring_packet_is_caught(observer):
    layout, p = problem(perfect(CART, 40, 60), {observer: {}})
    other = np.where(p.schedule.arrive > 0, p.schedule.arrive - 1, p.schedule.arrive)
    mutated = p._replace(schedule=p.schedule._replace(arrive=other))
    got = jax.tree.map(np.asarray, recorder()(layout, mutated, np.asarray(0), np.asarray(0)))
    assert error(got)[observer] > 1e-4


@pytest.mark.parametrize("observer", list(KNOWING))
def test_an_input_one_tick_late_is_caught(observer):
    case = perfect(CART, 40, 60)
    layout, p = problem(case, {observer: {}})
    plant = layout.plant
    late = Plant(lambda params, now, x: plant.step(params, now._replace(u=now.past_u(1)), x), plant.output)
    got = recorder()(layout._replace(plant=late), p, np.asarray(0), np.asarray(0))
    assert error(jax.tree.map(np.asarray, got))[observer] > 1e-4


def test_kfbo_on_held_data_stays_behind_by_half_a_period():
    """It does not know that Y is held: on constant velocity its bias is velocity x te / 2 (and te/2 + 1/2 tick is exact).

    The cart at a constant input moves at v = b u / lam after 0.1 s; a sample held over te is on average te/2 old.
    """
    te, d, ticks, u = 100, 100, 9000, 2.0
    v = 355 * u / 122
    case = Case(CART, te, d, ticks=ticks, x0=[0.0, v], xhat0=[0.0, v], u=np.full((ticks + 1, 1), u))
    got = trace(case, {"kfbo": {"R": 0.004}})
    bias = (got.x - got.estimates["kfbo"])[-10 * te - 1 : -1, 0].mean()
    assert bias == pytest.approx(v * te * 1e-3 / 2, rel=1e-3)


def test_kfbo_without_hold_has_no_bias():
    """With a sample at every tick the hold is one tick: the bias shrinks to v x dt / 2."""
    ticks, u = 9000, 2.0
    v = 355 * u / 122
    case = Case(CART, 1, 100, ticks=ticks, x0=[0.0, v], xhat0=[0.0, v], u=np.full((ticks + 1, 1), u))
    got = trace(case, {"kfbo": {"R": 0.004}})
    bias = (got.x - got.estimates["kfbo"])[-1001:-1, 0].mean()
    assert bias == pytest.approx(v * 1e-3 / 2, rel=1e-3)
