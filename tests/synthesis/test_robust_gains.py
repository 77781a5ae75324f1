"""Robust gains: promises hold over the whole range, are the optimum where that is known, and are refused where wrong."""

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of
from scipy.linalg import expm, solve_discrete_are

from pcbench.errors import DesignError, UserError
from pcbench.observers import OBSERVERS
from pcbench.synthesis import (
    common_lyapunov,
    current_gains,
    current_lmi,
    error_bounds,
    parameter_ranges,
    robust_lmi,
    solvers,
)
from pcbench.synthesis.certificate import Certificate
from pcbench.synthesis.parameter_ranges import Maps

PLANTS = {"cart": (CART, 200, 200), "odd": (ODD, 300, 100)}  # period and delay in ms


def design_context(name, noise_std=0.3):
    model, te, d = PLANTS[name]
    return context_of(Case(model, te, d, noise_std=noise_std))


def design_gains(name, **options):
    found = OBSERVERS["pccebo"].design(design_context(name), OBSERVERS["pccebo"].options(**options))
    return np.asarray(found.gains.L), found.certificate


def noise_over(model, q, te):
    """Process noise over te by a sum over small steps of exact maps: slow and plain."""
    steps = 4000
    h, Q = te / steps, np.zeros_like(model.A)
    E = expm(model.A * h / 2)
    middle = h * q * E @ model.B @ model.B.T @ E.T  # midpoint rule
    whole = expm(model.A * h)
    for _ in range(steps):
        Q = whole @ Q @ whole.T + middle
    return Q


def stationary(F, N):
    """X = F X F' + N by doubling."""
    X, E = N.copy(), F.copy()
    for _ in range(60):
        X, E = E @ X @ E.T + X, E @ E
    return X


@pytest.mark.parametrize("name", PLANTS)
def test_h2_without_a_rate_is_the_kalman_filter(name):
    model, te, d = PLANTS[name]
    Phi, ahead = expm(model.A * te * 1e-3), expm(model.A * d * 1e-3)
    L, certificate = design_gains(name, gain="h2", q=0.05)
    C, Q, R = model.C, noise_over(model, 0.05, te * 1e-3), 0.09 * np.eye(len(model.C))
    prior = solve_discrete_are(Phi.T, C.T, Q, R)
    K = np.linalg.solve(C @ prior @ C.T + R, C @ prior).T
    W = ahead / np.arange(1.0, len(Phi) + 1)[:, None]
    best = np.sqrt(np.trace(W @ (np.eye(len(Phi)) - K @ C) @ prior @ W.T))
    assert certificate.numbers["rms_bound"] == pytest.approx(best, rel=2e-4)
    keep = np.eye(len(Phi)) - L @ C
    mine = stationary(keep @ Phi, keep @ Q @ keep.T + L @ R @ L.T)
    assert best * (1 - 1e-5) < np.sqrt(np.trace(W @ mine @ W.T)) <= certificate.numbers["rms_bound"] * (1 + 1e-6)


@pytest.mark.ci
@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("gain", ["h2", "hinf", "decay"])
def test_a_rate_that_is_asked_for_is_kept_in_whatever_order_intervals_come(name, gain):
    """Errors are multiplied by random maps of the range; the bound of a norm by P has at most its condition as a factor."""
    model, te, _ = PLANTS[name]
    rng, low, high = np.random.default_rng(3), te - 50, te + 80
    L, certificate = design_gains(name, gain=gain, decay=0.8, period_range=[low * 1e-3, high * 1e-3])
    assert certificate.rate >= 0.8 * (1 - 1e-5)
    assert certificate.numbers["maps"] == high - low + 1
    room = np.sqrt(np.linalg.cond(certificate.numbers["P"]))
    for _ in range(20):
        E, seconds = np.eye(len(L)), 0.0
        for tick in rng.choice([low, te, high, rng.integers(low, high + 1)], 12):
            E = (np.eye(len(L)) - L @ model.C) @ expm(model.A * tick * 1e-3) @ E
            seconds += tick * 1e-3
            assert np.linalg.norm(E, 2) <= room * np.exp(-certificate.rate * seconds) * (1 + 1e-6)


@pytest.mark.parametrize("name", PLANTS)
def test_the_energy_gain_is_the_peak_over_frequencies(name):
    model, te, d = PLANTS[name]
    L, certificate = design_gains(name, gain="hinf", q=0.05)
    Phi, ahead = expm(model.A * te * 1e-3), expm(model.A * d * 1e-3)
    keep, n = np.eye(len(Phi)) - L @ model.C, len(Phi)
    values, vectors = np.linalg.eigh(noise_over(model, 0.05, te * 1e-3))
    B = np.hstack([keep @ (vectors * np.sqrt(np.maximum(values, 0))), -0.3 * L])
    W = ahead / np.arange(1.0, n + 1)[:, None]
    grid = np.concatenate([np.geomspace(1e-5, np.pi, 600), [np.pi]])
    peak = max(np.linalg.norm(W @ np.linalg.solve(np.exp(1j * w) * np.eye(n) - keep @ Phi, B), 2) for w in grid)
    assert peak <= certificate.numbers["g"] * (1 + 1e-6)
    assert peak >= 0.98 * certificate.numbers["g"]


@pytest.mark.parametrize("name", PLANTS)
def test_noise_in_the_estimate_is_the_sum_over_past_samples(name):
    model, te, d = PLANTS[name]
    for options in ({}, {"gain": "riccati"}, {"gain": "h2", "decay": 2.0}):
        L, certificate = design_gains(name, **options)
        F = (np.eye(len(L)) - L @ model.C) @ expm(model.A * te * 1e-3)
        X = stationary(F, 0.09 * L @ L.T)
        ahead = expm(model.A * d * 1e-3)
        want = np.sqrt(np.diag(ahead @ X @ ahead.T))
        np.testing.assert_allclose(certificate.numbers["noise_rms"], want, rtol=1e-8, atol=1e-14)


def test_faster_decay_costs_noise():
    noise = [design_gains("cart", gain="h2", decay=rate)[1].numbers["noise_rms"][0] for rate in (0.5, 1.0, 2.0, 5.0)]
    assert noise == sorted(noise)
    assert noise[-1] > 1.5 * noise[0]


TASKS = {"h2": ("h2", 1.0), "hinf": ("hinf", 1.0), "decay": ("decay", 1.0)}


def task(name):
    s = design_context(name)
    maps = parameter_ranges.maps(s, [0.15, 0.25], None, 0.05, "test")
    return robust_lmi.RobustTask(
        maps, s.model.C, np.diag(s.noise_variance), np.eye(len(s.model.A)), np.ones(len(s.model.A))
    )


@pytest.mark.nightly
@pytest.mark.parametrize("kind", TASKS)
def test_a_second_solver_agrees_and_is_certified_alike(kind):
    what, rate = TASKS[kind]
    both = [robust_lmi.solve(task("odd"), what, rate, "test", solver) for solver in solvers.SOLVERS]
    proofs = [robust_lmi.certify(found, task("odd"), what) for found in both]
    assert all(proof.margin >= rate * (1 - robust_lmi.RATE_TOL) for proof in proofs)
    assert both[1].cost == pytest.approx(both[0].cost, rel=1e-3)
    for name in ("rms_bound", "g"):
        if name in proofs[0].numbers:
            assert proofs[1].numbers[name] == pytest.approx(proofs[0].numbers[name], rel=1e-3)


@pytest.mark.parametrize("H", [None, np.array([[[0.3, 1.0]], [[0.5, 0.2]]])], ids=["given", "sought"])
def test_a_second_solver_agrees_on_one_lyapunov_matrix_for_a_range(H):
    J = np.array([[[0.9, 0.3], [-0.2, 0.6]], [[0.7, -0.1], [0.4, 0.8]]])
    seen = common_lyapunov.ErrorMaps(J, np.array([0.2, 0.5]), H)
    both = [common_lyapunov.solve(seen, 0.2, "test", solver) for solver in solvers.SOLVERS]
    assert both[1].t == pytest.approx(both[0].t, rel=1e-4)
    for found in both:
        closed = J if H is None else J - found.G @ H
        proof = common_lyapunov.certify(found, common_lyapunov.ErrorMaps(closed, seen.seconds), 0.2, "test")
        assert proof.margin == pytest.approx(found.t, rel=1e-3)
        assert proof.rate > 0.2


@pytest.mark.ci
def test_certificates_refuse_what_is_wrong():
    found = robust_lmi.solve(task("odd"), "h2", 1.0, "test")
    wrong = {
        "gain": found._replace(L=found.L * 3 + 0.5),
        "sign": found._replace(L=-found.L),
        "P": found._replace(P=-found.P),
        "shape": found._replace(P=np.eye(2)),
        "nan": found._replace(L=found.L * np.nan),
    }
    for name, each in wrong.items():
        margin = robust_lmi.certify(each, task("odd"), "h2").margin
        assert not margin >= 1.0 * (1 - robust_lmi.RATE_TOL), name
    assert robust_lmi.certify(found, task("odd"), "h2").margin >= 1.0 * (1 - robust_lmi.RATE_TOL)


def broken(*names):
    real = solvers.minimise

    def minimise(objective, rules, unknowns, where, solver, advice):
        if solver in names:
            raise DesignError(
                f"{where}: the LMI was not solved ({solver} said 'broken'), expected a solution; {advice}."
            )
        return real(objective, rules, unknowns, where, solver, advice)

    return minimise


FALLBACKS = {
    "pccebo": {"gain": "lmi"},
    "h2": {"gain": "h2"},
    "hinf": {"gain": "hinf"},
    "decay": {"gain": "decay", "decay": 1.0},
    "pco": {"Kp": "lmi"},
    "pi-pco": {"Kp": "lmi", "Ki": "lmi"},
}


@pytest.mark.parametrize("name", FALLBACKS)
def test_scs_is_asked_where_clarabel_has_no_answer(name, monkeypatch, tmp_path):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    entry = OBSERVERS["pccebo" if name not in OBSERVERS else name]

    def design():
        current_gains.at_the_mean.cache_clear()
        return entry.design(design_context("cart"), entry.options(**FALLBACKS[name])).certificate

    first = design()
    assert (first.solver, first.fallback) == ("CLARABEL", "")
    monkeypatch.setattr(solvers, "minimise", broken("CLARABEL"))
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path / "other"))
    second = design()
    assert (second.solver, second.fallback) == ("SCS", "CLARABEL had no answer")
    assert second.rate >= 0.99 * (1.0 if name == "decay" else 0.0)
    monkeypatch.setattr(solvers, "minimise", broken(*solvers.SOLVERS))
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path / "third"))
    with pytest.raises(DesignError, match="SCS said 'broken'"):
        design()


def test_an_answer_that_does_not_stand_is_not_taken_whatever_its_solver_says():
    """Clarabel calls a wrong answer optimal: SCS' is taken. Both do: the larger margin is named."""
    answers = {"CLARABEL": -2.0, "SCS": 0.5}

    def certify(margin):
        return Certificate("x > 0", margin, "some", "optimal")

    found, proof = solvers.solve_certified(answers.get, certify, "test")
    assert (found, proof.margin) == (0.5, 0.5)
    assert proof.fallback == "CLARABEL's ('optimal') had margin -2"
    answers["SCS"] = -3.0
    with pytest.raises(DesignError, match="x > 0 has margin -2"):
        solvers.solve_certified(answers.get, certify, "test")
    answers["SCS"] = float("nan")
    with pytest.raises(DesignError, match="x > 0 has margin -2"):
        solvers.solve_certified(answers.get, certify, "test")


def test_a_gain_that_is_good_at_the_mean_may_be_refused_over_a_range():
    """On an oscillator a gain may be stable at one interval and not at another; a common P is refused there."""
    gains, options = OBSERVERS["pccebo"], OBSERVERS["pccebo"].options
    L = np.zeros((3, 2)) + 0.01
    good = gains.design(design_context("odd"), options(gain="riccati"))
    L = np.asarray(good.gains.L).tolist()
    assert gains.design(design_context("odd"), options(L=L, period_range=[0.25, 0.35])).certificate.margin > 0
    with pytest.raises(DesignError, match=r"decay at .* over some interval|not certified"):
        gains.design(design_context("odd"), options(L=L, period_range=[0.05, 3.0], decay=1.0))


def test_ranges_hold_every_tick_and_both_ends_of_a_parameter():
    s = design_context("cart")._replace(variant=lambda p: CART._replace(A=np.array([[0.0, 1.0], [0.0, -p["lam"]]])))
    maps = parameter_ranges.maps(s, [0.1, 0.103], {"lam": [100.0, 150.0]}, 0.0, "test")
    assert len(maps.Phi) == 4 * parameter_ranges.VALUES
    for lam, ms in ((100.0, 100), (150.0, 103), (150.0, 100)):
        gap = np.abs(maps.Phi - expm(np.array([[0.0, 1.0], [0.0, -lam]]) * ms * 1e-3)).max((1, 2))
        (where,) = np.flatnonzero(gap < 1e-15)
        assert maps.seconds[where] == ms * 1e-3
        assert where in maps.corners
    with pytest.raises(UserError, match="expected one with a multiple of the tick"):
        parameter_ranges.maps(s, [0.1001, 0.1009], None, 0.0, "test")
    with pytest.raises(UserError, match="maps to check"):
        parameter_ranges.maps(s, [0.1, 1.0], {"lam": [1.0, 2.0], "mu": [1.0, 2.0]}, 0.0, "test")


@pytest.mark.ci
def test_the_fastest_decay_over_a_range_leaves_little_to_gain():
    """Asked for a tenth more, no P is found."""
    maps = parameter_ranges.maps(design_context("odd"), [0.1, 0.9], None, 0.05, "test")
    t = robust_lmi.RobustTask(maps, ODD.C, 0.09 * np.eye(2), np.eye(3), np.ones(3))
    found, proof = robust_lmi.design(t, "decay", None, "test")
    assert proof.rate > 0.5
    F = error_bounds.errors(np.asarray(found.L), ODD.C, maps.Phi)
    assert proof.rate <= (-np.log(np.abs(np.linalg.eigvals(F)).max(1)) / maps.seconds).min() * (1 + 1e-9)
    with pytest.raises(DesignError):
        robust_lmi.design(t, "decay", 1.1 * proof.rate, "test", solvers.SOLVERS[:1])


def test_a_promise_of_the_papers_gain_is_its_own():
    """(23) at the closed form's P = I: the norm of (I - L C) Phi, as a rate."""
    Phi = expm(CART.A * 0.2)
    L = current_lmi.closed_form(Phi, CART.C)
    _, certificate = current_gains.find(design_context("cart"), "lmi", None, 0.002, None, None, "test")
    size = np.linalg.norm((np.eye(2) - L @ CART.C) @ Phi, 2)
    assert certificate.rate == pytest.approx(-np.log(size) / 0.2, rel=1e-9)
    assert isinstance(parameter_ranges.maps(design_context("cart"), None, None, 0.0, "test"), Maps)
