"""The sampled high-gain observer with an output predictor: runs against the reference, its gain, and its certificate."""

import math

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, noise, starts, trace
from reference import held, linear

import pcbench
from pcbench import planning
from pcbench.dynamics.linear import Model
from pcbench.errors import UserError
from pcbench.observers import high_gain_predictor, lmi_sampled
from pcbench.plants import flexible_joint
from pcbench.study import parse
from pcbench.synthesis import sampled_high_gain
from pcbench.synthesis.certificate import is_certified

ONE = ODD._replace(C=ODD.C[:1])  # three states, two inputs, one output
CHAIN = Model(np.eye(3, k=1), np.eye(3)[:, 2:], np.eye(3)[:1])


def design(case, theta):
    return high_gain_predictor.design(context_of(case), high_gain_predictor.Options(theta=theta))


@pytest.mark.parametrize(("te", "d"), [(20, 0), (30, 75), (26, 26)])
@pytest.mark.parametrize(("model", "h"), [(ONE, 0.01), (CART, 1e-3)], ids=["odd", "cart"])
def test_run_with_noise_is_the_references(model, h, te, d):
    case = Case(model, te, d, ticks=400, h=h, noise_std=0.2, seed=5, xhat0=[0.5, -1.0, 2.0][: len(model.A)])
    u, (x0, xhat0), known = inputs(case), starts(case), linear.Model(model.A, model.B, model.C, h)
    samples = linear.simulate(known, u, x0, [te], [d], noise(case))[1]
    got = trace(case, {"high-gain-predictor": {"theta": 3.0}})
    want = held.predictor_run(known, u, samples, xhat0, design(case, 3.0).gains.L)
    size = np.abs(want).max()
    np.testing.assert_allclose(got.estimates["high-gain-predictor"], want, rtol=0, atol=1e-10 * size)


@pytest.mark.parametrize(("te", "d"), [(1, 0), (17, 0), (30, 45)])
def test_perfect_start_stays_perfect(te, d):
    case = Case(ONE, te, d, ticks=300, h=0.01, x0=[1.0, -2.0, 0.5], xhat0=[1.0, -2.0, 0.5])
    got = trace(case, {"high-gain-predictor": {}})
    assert np.abs(got.x - got.estimates["high-gain-predictor"]).max() < 1e-12 * np.abs(got.x).max()


@pytest.mark.parametrize("theta", [0.5, 4.0, 100.0])
def test_gain_has_all_its_eigenvalues_at_minus_theta(theta):
    for model in (ONE, CART, CHAIN):
        L = high_gain_predictor.binomial_gain(model.A, model.C, theta)
        got, n = np.poly(model.A - L @ model.C), len(model.A)
        want = np.array([math.comb(n, i) * theta**i for i in range(n + 1)])
        np.testing.assert_allclose(got / want, 1.0, rtol=1e-9)
    np.testing.assert_allclose(L.T, [[3 * theta, 3 * theta**2, theta**3]], rtol=1e-12)


def test_certificate_of_a_chain_ends_at_its_limit():
    theta, h = 2.0, 1e-3
    ticks = int(sampled_high_gain.limit("predictor", 3) / theta / h)
    below, above = (design(Case(CHAIN, te, 0, h=h), theta).certificate for te in (ticks - 1, ticks + 2))
    assert is_certified(below._asdict())
    assert not is_certified(above._asdict())
    rate = sampled_high_gain.decay_rate("predictor", 3, theta * (ticks - 1) * h) * theta
    assert below.rate == pytest.approx(rate, rel=1e-9)


def test_the_default_does_not_slow_a_fast_mode():
    """With 4 1/s the error on the cart, whose velocity decays at 122 1/s, grows by 1e9 and more from sample to sample."""
    assert design(Case(CART, 200, 0, h=1e-3), None).certificate.numbers["theta"] == pytest.approx(122)
    assert design(Case(CART, 200, 0, h=1e-3), None).certificate.numbers["radius"] < 1e-9
    assert design(Case(CART, 200, 0, h=1e-3), 4.0).certificate.numbers["radius"] > 1e9
    assert design(Case(CHAIN, 20, 0, h=0.01), None).certificate.numbers["theta"] == 4


def test_it_bears_longer_periods_than_the_held_innovation_with_the_same_gain():
    theta, h, te = 2.0, 0.01, 70
    known = context_of(Case(CHAIN, te, 0, h=h))
    predictor = high_gain_predictor.design(known, high_gain_predictor.Options(theta=theta))
    assert is_certified(predictor.certificate._asdict())
    assert sampled_high_gain.radius("hold", 3, theta * te * h) > 1


def test_run_tends_to_the_continuous_observer_as_the_period_goes_to_0():
    """Without noise, at a sample every tick, the error is that of e' = (A - L C) e to first order of the tick."""
    apart = []
    for h in (0.01, 0.001):
        case = Case(ONE, 1, 0, ticks=300, h=h, xhat0=[0.5, -1.0, 2.0])
        got = trace(case, {"high-gain-predictor": {"theta": 3.0}})
        e = got.x - got.estimates["high-gain-predictor"]
        L = design(case, 3.0).gains.L
        over = linear.discretise(ONE.A - L @ ONE.C, ONE.B, 300 * h)[0]
        apart.append(np.abs(e[-1] - over @ e[0]).max() / np.abs(e[0]).max())
    assert apart[0] < 0.05
    assert apart[1] < 0.01


def test_run_of_the_flexible_joint_follows_its_definition():
    """One Runge-Kutta step a tick of (xhat, w), with w set to y at each sample."""

    def motion(x, u):
        motor = -48.6 * x[0] - 1.25 * x[1] + 48.6 * x[2] + 21.6 * u
        return np.array([x[1], motor, x[3], 19.5 * x[0] - 19.5 * x[2] - 3.33 * np.sin(x[2])])

    h, ticks = 0.005, 200
    scenario = {"base": "flexible-joint/sampled", "duration": ticks * h, "steady_start": 0.5}
    study = {"name": "t", "scenario": scenario, "options": {"high-gain-predictor": {"theta": 5.0}}}
    got = pcbench.simulate(study, ["high-gain-predictor"], seed=6)
    _, cell = parse.one_cell({"name": "t", "scenario": scenario}, ["high-gain-predictor"], [])
    made = high_gain_predictor.design(planning.context_of(cell), high_gain_predictor.Options(theta=5.0))
    assert not is_certified(made.certificate._asdict())
    L, state, want = made.gains.L[:, 0], np.zeros(5), []
    for k in range(ticks + 1):
        if k % 20 == 0:
            state[4] = got["y1"][k]
        want.append(state[:4].copy())
        u = np.sin(4 * h * k)

        def rate(s, u=u):
            f = motion(s[:4], u)
            return np.append(f + L * (s[4] - s[0]), f[0])

        state = held.rk4(rate, state, h)
    names = [f"high-gain-predictor.{name}" for name, _ in flexible_joint.SIGNALS]
    np.testing.assert_allclose(got[names], want, rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize(
    ("model", "sentence"),
    [
        (ODD, "got 2 outputs, expected one"),
        (Model(np.diag([-1.0, -2.0]), np.ones((2, 1)), np.array([[1.0, 0.0]])), "unobservable"),
        (CART._replace(discrete=True), "discrete time"),
    ],
)
def test_plant_that_does_not_fit_is_refused(model, sentence):
    with pytest.raises(UserError, match=sentence):
        design(Case(model, 10, 0), 3.0)


def test_output_predictor_and_held_innovation_share_their_functions():
    assert high_gain_predictor.OBSERVER is lmi_sampled.OBSERVER
