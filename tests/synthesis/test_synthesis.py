"""Gains: the LMI's optimum, Riccati equations, and certificates that refuse what is wrong."""

import json
from functools import partial

import numpy as np
import pytest
from harness import CART, ODD, Case, context_of
from reference import cart as reference_cart
from scipy.linalg import expm, solve_discrete_are

from pcbench.dynamics import linear, observability
from pcbench.errors import DesignError, UserError
from pcbench.observers import OBSERVERS
from pcbench.runtime import cache
from pcbench.synthesis import common_lyapunov, current_gains, current_lmi, error_bounds, riccati, solvers
from pcbench.synthesis.certificate import Certificate, require_certified

PERIODS = [0.05, 0.2, 0.6, 1.0]


def phi(model, te):
    return expm(model.A * te)


@pytest.mark.parametrize("te", PERIODS)
@pytest.mark.parametrize("solver", ["CLARABEL", "SCS"])
def test_two_solvers_find_the_closed_forms_optimum(te, solver):
    """t = 1 - ||(I - L C) Phi||; L itself has ties of size e^{-122 te} in that norm, so it is compared to that only."""
    Phi = phi(CART, te)
    found = current_lmi.solve(Phi, CART.C, "test", solver)
    L = current_lmi.closed_form(Phi, CART.C)
    loose = 1e-6 if solver == "CLARABEL" else 1e-3
    assert found.t == pytest.approx(1 - np.linalg.norm((np.eye(2) - L @ CART.C) @ Phi, 2), abs=loose)
    np.testing.assert_allclose(found.L, L, atol=loose + 2 * 122 * np.exp(-122 * te))
    sharp = current_lmi.sharpen(found, Phi, CART.C)
    np.testing.assert_array_equal(sharp.L, L if solver == "CLARABEL" else sharp.L)


def test_where_the_closed_form_is_not_optimal_the_lmi_still_finds_a_gain():
    """A growing plant: no L makes the norm less than 1, so P = I proves nothing, yet the LMI finds and certifies a gain."""
    Phi, C = np.array([[1.2, 5.0], [0.0, 0.9]]), np.array([[1.0, 0.0]])
    assert np.linalg.norm((np.eye(2) - current_lmi.closed_form(Phi, C) @ C) @ Phi, 2) < 1  # one output sees it
    slow = np.array([[0.9, 5.0, 0.0], [0.0, 0.8, 3.0], [0.0, 0.0, 0.7]])
    C = np.array([[1.0, 0.0, 0.0]])
    L = current_lmi.closed_form(slow, C)
    assert np.linalg.norm((np.eye(3) - L @ C) @ slow, 2) > 1
    found = current_lmi.solve(slow, C, "test")
    sharp = current_lmi.sharpen(found, slow, C)
    np.testing.assert_allclose(sharp.P, found.P, rtol=1e-12)
    assert current_lmi.lmi_margin(sharp, slow, C) > found.t - 1e-9
    assert current_lmi.certify(sharp, slow, C, 1.0).margin > 0


GROWING = [  # (A, C), sampled every 0.1 s: two solvers' own gains differ by up to 8
    ([[0.0, 1.0], [-2.0, -1.0]], [[1.0, 0.0]]),
    ([[0.3, 2.0], [-1.0, 0.1]], [[1.0, 0.5]]),
    ([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [-1.0, -2.0, 0.5]], [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
]


@pytest.mark.parametrize(("A", "C"), GROWING)
def test_the_gain_depends_neither_on_the_solver_nor_on_rounding(A, C):
    Phi, C = expm(0.1 * np.array(A)), np.array(C)
    rounded = Phi * (1 + 1e-15 * np.random.default_rng(0).standard_normal(Phi.shape))
    answers = [current_lmi.solve(F, C, "test", s) for F, s in ((Phi, "CLARABEL"), (rounded, "CLARABEL"), (Phi, "SCS"))]
    gains = [current_lmi.sharpen(found, Phi, C).L for found in answers]
    for L in gains[1:]:
        np.testing.assert_allclose(L, gains[0], atol=1e-4)
    np.testing.assert_allclose(C @ gains[0], np.eye(len(C)), atol=1e-9)  # the measured outputs are taken as they are


def test_of_all_gains_that_attain_the_optimum_it_is_the_least():
    """Brute force: gains beside it that attain t with the same P have a larger norm of D^-1/2 P (I - L C) Phi D^-1/2."""
    Phi, C = expm(0.1 * np.array(GROWING[1][0])), np.array(GROWING[1][1])
    found = current_lmi.sharpen(current_lmi.solve(Phi, C, "test"), Phi, C)
    t = current_lmi.lmi_margin(found, Phi, C)
    size, V = np.linalg.eigh(found.P - t * np.eye(2))
    root = V @ np.diag(1 / np.sqrt(size)) @ V.T

    def norm(L):
        return np.linalg.norm(root @ found.P @ (np.eye(2) - L @ C) @ Phi @ root)

    rng, tried = np.random.default_rng(1), 0
    for _ in range(400):
        L = found.L + 10.0 ** rng.uniform(-4, 0) * rng.standard_normal((2, 1))
        if current_lmi.lmi_margin(found._replace(L=L), Phi, C) > t - 1e-6:
            tried += 1
            assert norm(L) > norm(found.L)
    assert tried > 5


def test_the_closed_form_is_the_least_norm():
    """Brute force around it, on a plant with two outputs, in the Frobenius norm (the spectral one has ties)."""
    Phi = phi(ODD, 0.3)
    L = current_lmi.closed_form(Phi, ODD.C)

    def size(L):
        return np.linalg.norm((np.eye(3) - L @ ODD.C) @ Phi)

    rng = np.random.default_rng(0)
    assert all(size(L + 1e-3 * rng.normal(size=L.shape)) > size(L) for _ in range(200))


@pytest.mark.parametrize("te", PERIODS)
def test_the_gain_is_deadbeat_and_equals_the_reference(te):
    design = OBSERVERS["pccebo"].design(context_of(Case(CART, round(te * 1000), 0)), OBSERVERS["pccebo"].options())
    closed = (np.eye(2) - design.gains.L @ CART.C) @ phi(CART, te)
    assert np.abs(np.linalg.eigvals(closed)).max() <= np.exp(-122 * te) * (1 + 1e-6) + 1e-15
    np.testing.assert_allclose(design.gains.L, reference_cart.pccebo_gain(round(te * 1000)), atol=1e-12)


def test_a_gain_outside_the_lmi_is_refused_with_margin_and_status():
    Phi = phi(CART, 0.2)
    wrong = current_lmi.CurrentGain(np.eye(2), np.array([[2.5], [0.0]]), 0.0, "optimal", "CLARABEL")
    certificate = current_lmi.certify(wrong, Phi, CART.C, 0.2)
    assert certificate.margin < 0
    with pytest.raises(DesignError, match=r"margin -.*CLARABEL said 'optimal'"):
        require_certified(certificate, "pccebo in test")


def test_a_gain_that_is_not_finite_is_refused():
    with pytest.raises(DesignError, match="nan"):
        require_certified(Certificate("x > 0", float("nan"), "s", "solved"), "somewhere")


def test_a_damaged_cache_cannot_enter_a_table(tmp_path, monkeypatch):
    """What is remembered is judged anew: a foreign answer is not the optimum, an unreadable one is solved again."""
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    case = context_of(Case(CART, 200, 200))

    def design():
        current_gains.at_the_mean.cache_clear()
        return OBSERVERS["pccebo"].design(case, OBSERVERS["pccebo"].options()).gains.L

    good = design()
    (entry,) = tmp_path.rglob("*.json")
    text = entry.read_text()
    entry.write_text("{ half")
    np.testing.assert_array_equal(design(), good)
    for foreign in ({"L": [[7.0], [0.0]], "t": 2.0}, {"L": [[0.5], [0.0]], "t": 2.0}, {"L": [[0.5]]}, {"t": None}):
        entry.write_text(json.dumps(json.loads(text) | foreign))
        np.testing.assert_array_equal(design(), good)
    assert cache.folder() == tmp_path


def test_every_problem_has_its_own_place_in_the_cache(tmp_path, monkeypatch):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    slow = np.array([[0.9, 5.0, 0.0], [0.0, 0.8, 3.0], [0.0, 0.0, 0.7]])
    C = np.array([[1.0, 0.0, 0.0]])

    def gain(Phi):
        solve = partial(current_lmi.solve, Phi, C, "test")
        return solvers.solve_or_load(current_lmi.CurrentGain, "lmi23", (Phi, C), solve, "CLARABEL").L

    kept = [gain(Phi) for Phi in (slow, 0.9 * slow, slow)]
    assert not np.allclose(kept[0], kept[1])
    np.testing.assert_array_equal(kept[0], kept[2])
    assert len(list(tmp_path.rglob("*.json"))) == 2


def test_matrices_of_the_same_numbers_in_another_shape_are_another_problem(tmp_path, monkeypatch):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    kind, shapes = current_lmi.CurrentGain, [(2, 3), (3, 2), (1, 6)]
    for shape in shapes:
        found = solvers.solve_or_load(
            kind, "shape", (np.ones(shape),), partial(kind, np.eye(2), np.ones(shape), 0.0, ""), "SCS"
        )
        assert found.L.shape == shape
    assert len(list(tmp_path.rglob("*.json"))) == len(shapes)


def test_a_proof_over_a_range_holds_at_every_map_of_it_at_its_own_interval():
    found = common_lyapunov.CommonLyapunov(np.eye(2), np.zeros((0, 0)), 0.1, "optimal", "none")

    def certify(factors, rate):
        maps = np.array(factors)[:, None, None] * np.eye(2)
        return common_lyapunov.certify(found, common_lyapunov.ErrorMaps(maps, np.array([0.1, 0.2])), rate, "test")

    assert certify((0.5, 0.5), 0.0).margin == pytest.approx(0.5)
    assert certify((0.5, 0.5), 0.0).rate == pytest.approx(np.log(2) / 0.2)
    for factors in ((0.5, 1.1), (1.1, 0.5)):
        assert certify(factors, 0.0).margin == pytest.approx(-0.1)
    for rate, holds in ((3.4, True), (3.5, False)):  # log 2 over 0.2 s is 3.466
        assert (certify((0.5, 0.5), rate).margin > 0) == holds


@pytest.mark.parametrize(
    ("mode", "discrete", "decays"),
    [
        (0.5, True, True),
        (-0.5, True, True),
        (1.0, True, False),
        (-1.2, True, False),
        (-1.2, False, True),
        (0.0, False, False),
    ],
)
def test_a_mode_decays_inside_the_circle_or_left_of_the_axis(mode, discrete, decays):
    blind = linear.Model(np.diag([0.3, mode]), np.ones((2, 1)), np.array([[1.0, 0.0]]), None, discrete)
    if decays:
        observability.require_detectable(blind, "test")
    else:
        with pytest.raises(UserError, match=f"mode {mode:g} is undetectable"):
            observability.require_detectable(blind, "test")


def test_riccati_solution_solves_the_equation_and_its_closed_form():
    for R in (0.004, 0.3, 1.0):
        found = riccati.continuous(CART, 0.002 * CART.B @ CART.B.T, R * np.eye(1), "test")
        K, P = reference_cart.kfbo_gain(R)
        np.testing.assert_allclose(found.K, K, rtol=1e-10)
        np.testing.assert_allclose(found.P, P, rtol=1e-10)
        assert found.certificate.margin > 0


def test_an_undetectable_plant_has_no_kfbo():
    blind = linear.Model(np.diag([1.0, -1.0]), np.ones((2, 1)), np.array([[0.0, 1.0]]))
    with pytest.raises(DesignError, match=r"Riccati|not certified"):
        OBSERVERS["kfbo"].design(context_of(Case(blind, 10, 10)), OBSERVERS["kfbo"].options())


def test_recursion_converges_to_the_discrete_riccati_equation():
    E, Q, R = expm(ODD.A * 0.1), np.diag([0.1, 0.2, 0.05]), np.diag([0.3, 0.1])
    run = riccati.multirate(E[None], Q[None], ODD.C, np.diag(R), np.eye(3), (1, 1), 1)
    for _ in range(400):
        prior = E @ run.P @ E.T + Q
        run = riccati.multirate(E[None], Q[None], ODD.C, np.diag(R), prior, (1, 1), 0)
    np.testing.assert_allclose(prior, solve_discrete_are(E.T, ODD.C.T, Q, R), rtol=1e-9, atol=1e-12)


def test_held_noise_through_the_input_of_a_discrete_plant_has_its_intensity_over_the_tick():
    """White noise of intensity q, averaged over h seconds, has the variance q / h; a state that walks adds its own a second."""
    h, q, walk = 0.05, 0.3, np.array([0.7])
    model = ODD._replace(discrete=True)
    np.testing.assert_allclose(linear.input_noise(model, q, h), q / h * ODD.B @ ODD.B.T, rtol=1e-14)
    wide = linear.with_unknown_input(model._replace(E=np.array([[1.0], [0.3], [0.2]])))
    Q = linear.input_noise(wide, q, h, walk)
    np.testing.assert_allclose(Q[3:, 3:], [[0.7 * h]], rtol=1e-14)
    np.testing.assert_allclose(Q[:3, :3], q / h * ODD.B @ ODD.B.T, rtol=1e-14)
    still = linear.input_noise(linear.with_unknown_input(ODD._replace(E=np.array([[1.0], [0.3], [0.2]]))), 0.0, h, walk)
    np.testing.assert_allclose(still[3:, 3:], [[0.7 * h]], rtol=1e-12)


@pytest.mark.parametrize("discrete", [False, True])
def test_a_model_with_an_input_bias_moves_and_measures_as_one_under_that_much_more_input(discrete):
    D, b, u = np.array([[0.4, -1.0], [0.2, 0.7]]), np.array([0.3, -2.0]), np.array([1.5, 0.5])
    model = ODD._replace(D=D, discrete=discrete)
    wide = linear.with_input_bias(model)
    (Phi, Gamma), (F, G) = (linear.one_tick(each, 0.1) for each in (model, wide))
    x = np.array([1.0, -2.0, 0.5])
    for _ in range(3):
        z = np.append(x, b)
        np.testing.assert_allclose(wide.C @ z + wide.feedthrough @ u, ODD.C @ x + D @ (u + b), rtol=1e-13)
        np.testing.assert_allclose(F @ z + G @ u, np.append(Phi @ x + Gamma @ (u + b), b), rtol=1e-12)
        x = Phi @ x + Gamma @ (u + b)


def test_a_rate_is_of_seconds_and_not_of_samples():
    """A factor of e^{-0.6} a sample of 0.2 s is a decay of 3 a second."""
    assert error_bounds.rate_of(np.exp(-0.6), 0.2) == pytest.approx(3.0)
    F = np.exp(-0.6) * np.array([[[0.0, 1.0], [-1.0, 0.0]]])
    assert error_bounds.rate(F, np.eye(2), np.array([0.2])) == pytest.approx(3.0)
    assert error_bounds.rate(F[[0, 0]], np.eye(2), np.array([0.2, 0.5])) == pytest.approx(0.6 / 0.5), (
        "the slowest counts"
    )
    with pytest.raises(UserError, match=r"expected 24 at most over intervals of 0\.5 s"):
        error_bounds.require_slower(25.0, np.array([0.2, 0.5]), "test")


@pytest.mark.parametrize("ticks", [1, 2, 3, 200, 600, 1000])
def test_doublings_reach_any_age(ticks):
    doubled = linear.doublings(CART, 1e-3, 10)
    np.testing.assert_allclose(
        linear.over(doubled, ticks), reference_cart.transition(ticks * 1e-3), rtol=1e-13, atol=1e-16
    )


@pytest.mark.parametrize("bit", range(10))
def test_process_noise_over_long_intervals_keeps_its_digits(bit):
    """Van Loan's exponential over 0.6 s overflows silently; doubling one tick does not."""
    Q = linear.noise_doublings(CART, linear.input_noise(CART, 0.002, 1e-3), 1e-3, 10)[bit]
    np.testing.assert_allclose(Q, reference_cart.process_covariance(2**bit * 1e-3), rtol=1e-11)


@pytest.mark.parametrize("seconds", [0.05, 0.2, 0.6])
def test_process_noise_over_a_tick_in_which_a_mode_dies_keeps_its_digits(seconds):
    Q = linear.input_noise(CART, 0.002, seconds)
    np.testing.assert_allclose(Q, reference_cart.process_covariance(seconds), rtol=1e-11)


def test_a_table_of_process_noise_holds_what_so_many_ticks_add():
    tick = linear.input_noise(ODD, 0.3, 0.01)
    doubled = linear.doublings(ODD, 0.01, 8)
    noise, table = linear.noise_doublings(ODD, tick, 0.01, 8), linear.noise_powers(ODD, tick, 0.01, 200)
    assert table.shape[:2] == (2, 16)
    for level in range(2):
        for i in range(16):
            want = linear.noise_over(doubled, noise, i * 16**level)
            np.testing.assert_allclose(table[level, i], want, rtol=0, atol=1e-13 * np.abs(noise[-1]).max())
