"""Cascade predictors: the delay that a link bears, what more links add, and perfect starts."""

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, problem, recorder, trace
from reference import field_observers
from reference import linear as reference
from reference.linear import Sample
from scipy.linalg import expm
from scipy.optimize import brentq

import pcbench
from pcbench import planning
from pcbench.dynamics import linear
from pcbench.errors import DesignError, UserError
from pcbench.observers import OBSERVERS
from pcbench.study import parse
from pcbench.synthesis import cascade
from pcbench.synthesis.certificate import is_certified

SCALAR = linear.Model(np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)))  # x' = x + u
ONE = np.ones((1, 1))


def link(k, h, a=1.0):
    """Phi and K of a link x' = a x - k x(t - d), a tick of h seconds."""
    Phi = np.exp(a * h)
    return Phi * ONE, k / a * (Phi - 1) * ONE


def longest(k):
    """The largest a d of a scalar link of gain k a, by its characteristic equation."""
    return np.arccos(1 / k) / np.sqrt(k**2 - 1)


def errors(k, delay, m, h=5e-3, seconds=200.0):
    """Errors [m, N+1] of m links without sampling, all 1 until t = 0, by their recursion."""
    Phi, K = (float(M[0, 0]) for M in link(k, h))
    d, e = cascade.divide(round(delay / h), m), np.ones((m, round(seconds / h) + 1))
    for i in range(e.shape[1] - 1):
        for j in range(m):
            before = e[j - 1, i] if j else 0.0
            e[j, i + 1] = Phi * e[j, i] - K * (e[j, max(i - d[j], 0)] - before)
    return e


@pytest.mark.ci
@pytest.mark.parametrize(("k", "printed"), [(1.5, 0.7523), (2.0, 0.6046), (3.0, 0.4352)])
def test_longest_delay_of_a_scalar_link_has_the_printed_digits(k, printed):
    """The radius crosses 1 within half a unit of the last digit; an input held over a tick delays by half a tick more."""
    assert longest(k) == pytest.approx(printed, abs=5e-5)
    for delay, decays in ((printed - 7e-5, True), (printed + 7e-5, False)):
        Phi, K = link(k, delay / 300.5)
        assert (cascade.radius(Phi, ONE, K, 300, 0) < 1) == decays


def test_a_gain_exists_for_a_delay_below_1_over_a_only():
    gains = 1 + np.geomspace(1e-3, 10, 400)
    bears = np.array([longest(k) for k in gains])
    assert (np.diff(bears) < 0).all()
    assert 0.999 < bears.max() < 1
    for k in (1.05, 1.2, 1.5, 3.0):  # the map of the errors agrees on both sides of 1/a
        Phi, K = link(k, 0.01)
        assert cascade.radius(Phi, ONE, K, 101, 0) > 1
    Phi, K = link(1.05, 0.01)
    assert cascade.radius(Phi, ONE, K, 90, 0) < 1


@pytest.mark.ci
@pytest.mark.parametrize("m", [1, 2])
def test_links_of_more_than_1_over_a_diverge_with_every_gain(m):
    h = 0.025
    for k in 1 + np.geomspace(1e-3, 10, 12):
        Phi, K = link(k, h)
        assert cascade.radius(Phi, ONE, K, round(2.5 / h / m), 0) > 1
    assert np.abs(errors(1.1, 2.5, m)[-1, -1]) > 1e10


def test_gains_of_three_links_over_2_5_seconds_end_at_the_printed_one():
    found = brentq(lambda k: longest(k) - 2.5 / 3, 1.01, 2.0)
    assert found == pytest.approx(1.3025, abs=5e-5)


@pytest.mark.ci
def test_errors_of_three_four_and_six_links_have_the_printed_size():
    three = np.abs(errors(1.1, 2.5, 3, h=1 / 1200)[-1])
    assert three[-6000:].max() == pytest.approx(3.6e-7, rel=0.1)  # the largest of the last 5 s: the error oscillates
    four, six = (errors(1.5, 2.5, m)[-1, round(80 / 5e-3)] for m in (4, 6))
    assert four == pytest.approx(3e-4, abs=5e-5)
    assert abs(six) < 1e-30


@pytest.mark.ci
@pytest.mark.parametrize("te", [1, 20])
@pytest.mark.parametrize(("model", "d"), [(CART, 60), (ODD, 47)], ids=["cart", "odd"])
def test_radius_is_the_decay_of_the_errors_of_a_run(model, d, te):
    """Errors of a run with the true model and no input, after the slowest mode alone is left."""
    case = Case(model, te, d, ticks=900, h=1e-3 if model is CART else 0.02, xhat0=np.zeros(len(model.A)))
    design = OBSERVERS["cascade-predictor"].design(context_of(case), OBSERVERS["cascade-predictor"].options(links=1))
    got = trace(case, {"cascade-predictor": {"links": 1}})
    error = np.linalg.norm((got.x - got.estimates["cascade-predictor"])[d::te], axis=1)
    bound = (1 - design.certificate.margin) ** np.arange(len(error))
    assert 0 < design.certificate.margin < 1
    assert (error / bound).max() < 50 * error[0]
    late = error[len(error) // 2 :] / bound[len(error) // 2 :]
    assert late.max() > 1e-3 * error[0], "it does not decay faster than its radius"


@pytest.mark.ci
@pytest.mark.parametrize(("te", "d", "m"), [(40, 95, 3), (7, 60, 2), (50, 0, 1), (30, 200, None)])
@pytest.mark.parametrize("odd", [False, True])
def test_perfect_start_leaves_no_error(te, d, m, odd):
    start = [1.0, -2.0, 0.5] if odd else [5.0, 10.0]
    case = Case(ODD if odd else CART, te, d, ticks=400, h=0.005 if odd else 1e-3, x0=start, xhat0=start)
    got = trace(case, {"cascade-predictor": {"links": m}})
    assert np.abs(got.x - got.estimates["cascade-predictor"]).max() < 1e-12 * np.abs(got.x).max()


@pytest.mark.ci
@pytest.mark.parametrize("slip", [-1, 1])
def test_design_for_a_delay_of_one_tick_more_or_less_is_seen(slip):
    start = [5.0, 10.0]
    case = Case(CART, 40, 60, ticks=400, x0=start, xhat0=start)
    layout, p = problem(case, {"cascade-predictor": {"links": 2}})
    entry = OBSERVERS["cascade-predictor"]
    other = entry.design(context_of(case._replace(d=60 + slip)), entry.options(links=2)).gains
    got = recorder()(layout, p._replace(gains={"cascade-predictor": other}), np.asarray(0), np.asarray(0))
    error = np.abs(np.asarray(got.x) - np.asarray(got.estimates["cascade-predictor"])).max()
    assert error > 1e-4 * np.abs(np.asarray(got.x)).max()


@pytest.mark.parametrize(("d", "te"), [(0, 5), (3, 1), (20, 7), (170, 30), (170, 0)])
def test_radius_is_that_of_the_map_written_out(d, te):
    """[e(k), .., e(k-d), r(k)] moves by one matrix a tick; d = 170 is found without all eigenvalues."""
    Phi, C = expm(ODD.A * 0.005), ODD.C
    K = cascade.gain(Phi, C, np.exp(-1 / max(3 * d, 1.5 * te, 2)), "here")
    n, size = 3 * d, 3 * (d + 1) + 2
    F = np.eye(size, k=-3)
    F[:3, :3], F[:3, -2:], F[-2:, : size - 2] = Phi, K, 0.0
    F[:3, n : n + 3] -= K @ C
    F[-2:, n : n + 3], F[-2:, -2:] = C @ Phi - C, np.eye(2)
    whole = np.linalg.matrix_power(F, te) if te else F
    eigenvalues = np.linalg.eigvals(whole[: size - 2, : size - 2])  # r is 0 after a sample, or always
    assert cascade.radius(Phi, C, K, d, te) == pytest.approx(np.abs(eigenvalues).max(), rel=1e-9)


def test_unstable_plant_gets_as_many_links_as_its_delay_needs():
    """The plant stays at 0, so that the error is not lost in the rounding of a state that grows."""
    case = Case(SCALAR, 10, 250, ticks=8000, h=0.01, x0=[0.0], xhat0=[1.0], u=np.zeros((8001, 1)))
    design = OBSERVERS["cascade-predictor"].design(context_of(case), OBSERVERS["cascade-predictor"].options())
    assert len(design.gains.d) == 4
    error = np.abs(trace(case, {"cascade-predictor": {}}).estimates["cascade-predictor"])[:, 0]
    assert error[-1] < 1e-2 * error[250]


@pytest.mark.parametrize("links", [1, 2])
def test_too_few_links_are_refused(links):
    with pytest.raises(
        DesignError, match=rf"got errors that do not decay with {links} links over a delay of 250 ticks"
    ):
        OBSERVERS["cascade-predictor"].design(
            context_of(Case(SCALAR, 10, 250, h=0.01)), OBSERVERS["cascade-predictor"].options(links=links)
        )


def test_more_links_than_ticks_are_refused():
    with pytest.raises(UserError, match="got links = 4, expected at most 3, one per tick"):
        OBSERVERS["cascade-predictor"].design(
            context_of(Case(CART, 10, 3)), OBSERVERS["cascade-predictor"].options(links=4)
        )


def test_delay_is_divided_into_parts_that_differ_by_a_tick():
    assert cascade.divide(10, 3) == (3, 3, 4)
    assert cascade.divide(0, 1) == (0,)


def joint(x, u):
    motor = -48.6 * x[0] - 1.25 * x[1] + 48.6 * x[2] + 21.6 * u[0]
    return np.array([x[1], motor, x[3], 19.5 * x[0] - 19.5 * x[2] - 3.33 * np.sin(x[2])])


def tick(x, u, h=0.005):
    """One Runge-Kutta step of the flexible joint."""
    a = joint(x, u)
    b = joint(x + h / 2 * a, u)
    c = joint(x + h / 2 * b, u)
    d = joint(x + h * c, u)
    return x + h / 6 * (a + 2 * b + 2 * c + d)


def plan_and_design(options, **changes):
    scenario = {"base": "flexible-joint/sampled", "duration": 3.0, "steady_start": 1.0, "delay": 0.2, **changes}
    study = {"name": "t", "scenario": scenario, "options": {"cascade-predictor": options}}
    _, cell = parse.one_cell({"name": "t", "scenario": scenario}, ["cascade-predictor"], [])
    entry = OBSERVERS["cascade-predictor"]
    return study, entry.design(planning.context_of(cell), entry.options(**options))


@pytest.mark.parametrize("links", [3, 5])
def test_links_of_a_nonlinear_plant_equal_the_reference(links):
    """With noise, from a wrong start, far from the point of the linear model."""
    study, made = plan_and_design({"links": links})
    got = pcbench.simulate(study, ["cascade-predictor"], seed=3)
    assert not is_certified(made.certificate._asdict())
    N, g = len(got) - 1, made.gains
    y = got.y1.to_numpy()
    samples = [Sample(k + 40, k, 0, k // 20, y[k + 40]) for k in range(0, N - 39, 20)]
    model = reference.Model(np.zeros((4, 4)), np.zeros((4, 1)), np.eye(4)[:1], 0.005)
    u = np.sin(4 * 0.005 * np.arange(N + 1))[:, None]
    want = field_observers.cascade(model, u, samples, np.zeros(4), g.K, g.d, tick)
    states = [f"cascade-predictor.{name}" for name in ("motor_angle", "motor_velocity", "link_angle", "link_velocity")]
    np.testing.assert_allclose(got[states].to_numpy(), want, rtol=0, atol=1e-10 * np.abs(want).max())


def test_perfect_start_on_a_nonlinear_plant_stays_perfect():
    """Links behind the present stay at xhat(0) until their time has come: so without delay."""
    quiet = {"noise_std": 0.0, "process_std": [0.0] * 4, "xhat0": [1.0, 0.0, 1.0, 0.0], "delay": 0.0}
    study, _ = plan_and_design({}, **quiet)
    got = pcbench.simulate(study, ["cascade-predictor"], seed=3)
    assert np.abs(got["link_angle"] - got["cascade-predictor.link_angle"]).max() < 1e-12


def test_errors_on_a_nonlinear_plant_vanish_without_noise():
    study, _ = plan_and_design({}, noise_std=0.0, process_std=[0.0] * 4, duration=60.0)
    got = pcbench.simulate(study, ["cascade-predictor"], seed=3)
    error = np.abs(got["link_angle"] - got["cascade-predictor.link_angle"])
    size = [error[(got.t > t) & (got.t <= t + 10)].max() for t in range(0, 60, 10)]
    assert size[-1] < 0.01 * size[0]
    assert np.all(np.diff(size) < 0)


def test_a_nonlinear_output_is_refused():
    with pytest.raises(UserError, match="got a nonlinear output, expected one that is linear in the state; use ekf"):
        pcbench.run("falling-body/radar", observers=["cascade-predictor"], seeds=1)
