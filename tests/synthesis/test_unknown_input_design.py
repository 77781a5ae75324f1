"""Gains for plants with an unknown input: the coordinates, the error equations they give, and the optima."""

from functools import partial
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag

from pcbench.dynamics.linear import Model
from pcbench.errors import DesignError, UserError
from pcbench.synthesis import pi_lmi, sliding_mode
from pcbench.synthesis.solvers import minimise
from pcbench.synthesis.unknown_input import (
    injection,
    proven_rate,
    require_movable,
    require_rate,
    split,
    unmovable,
)

A = np.array([[0, 1, 0, 0], [-3.75, -0.0015, 3.75, 0], [0, 0, 0, 1], [3.75, 0, -3.75, -0.00125]])
B, D = np.array([[0, 0, 0, 0.25]]).T, np.array([[0, 1.0, 0, 0]]).T
C = np.array([[0, 1.0, 0, 0], [0, 0, 1.0, 0]])
MODEL = Model(A, B, C, E=D)
ARM = split(MODEL, "arm")
LINK = split(MODEL._replace(C=np.eye(2, 4)), "arm")  # link angle and velocity are measured instead

PRINTED = sliding_mode.SlidingModeGains(
    np.array([[0.8148], [2.4893]]),
    np.array([[13.5959, -4.2094], [-4.2094, 2.4078]]),
    np.array([[1.0070, 0.0021], [0.0021, 1.0024]]),
    np.array([[-2.5881, 0.0141], [0.0141, -2.6187]]),
    np.nan,
    "printed",
    "paper",
)
PRINTED_PI = pi_lmi.PIGains(
    np.array([[21.7396, 0.0278], [0.0283, 21.8043]]),
    np.array([[22.2876, 0.0272], [0.0288, 22.3538]]),
    pi_lmi.form(np.array([[0.9163, -0.2602], [-0.2602, 0.1860]]), *(np.full(2, v) for v in (0.8261, 0.3339, 0.3328))),
    np.nan,
    "printed",
    "paper",
)
BEST_L1 = np.array([[0.8118669227], [2.4844686145]])


def plant(seed, hidden=2, clean=1, reached=1, stable=0.0):
    """A plant of p = clean + reached outputs, `reached` unknown inputs and `hidden` states more; observable as it is random."""
    rng = np.random.default_rng(seed)
    p, n = clean + reached, clean + reached + hidden
    matrices = [rng.normal(size=shape) for shape in ((n, n), (n, p), (p, n), (n, reached))]
    return Model(matrices[0] - stable * np.eye(n), *matrices[1:3], E=matrices[3])


SIZES = list(product((1, 2, 3), (1, 2), (1, 2)))  # hidden, clean, reached
random_plants = st.builds(lambda size, seed: plant(seed, *size), st.sampled_from(SIZES), st.integers(0, 2**31 - 1))


def test_the_arm_comes_out_as_the_permutation_of_the_page():
    """No special case: to the bit, so that the printed gains belong to it."""
    np.testing.assert_array_equal(ARM.T, np.eye(4)[[0, 3, 2, 1]])
    np.testing.assert_array_equal(ARM.Tp, [[0, 1], [1, 0]])
    np.testing.assert_array_equal(ARM.A11, [[0, 0], [3.75, -0.00125]])
    np.testing.assert_array_equal(ARM.A12, [[0, 1], [-3.75, 0]])
    np.testing.assert_array_equal(ARM.A21, [[0, 1], [-3.75, 0]])
    np.testing.assert_array_equal(ARM.A22, [[0, 0], [3.75, -0.0015]])
    np.testing.assert_array_equal(ARM.A211, [[0, 1]])
    np.testing.assert_array_equal(ARM.E222, [[1]])


@settings(max_examples=60)
@given(model=random_plants)
def test_the_unknown_input_reaches_the_last_outputs_only(model):
    got, (p, n), r = split(model, "test"), model.C.shape, model.E.shape[1]
    T, back, size = got.T, np.linalg.inv(got.T), np.linalg.cond(got.T)
    close = partial(np.testing.assert_allclose, rtol=0, atol=1e-11 * size)
    close(T @ model.E, np.vstack([np.zeros((n - r, r)), got.E222]))
    close(model.C @ back, np.hstack([np.zeros((p, n - p)), got.Tp.T]))
    close(got.Tp @ got.Tp.T, np.eye(p))
    hidden = T[: n - p] @ (np.eye(n) - np.linalg.pinv(model.C) @ model.C)
    close(hidden @ hidden.T, np.eye(n - p))
    close(np.block([[got.A11, got.A12], [got.A21, got.A22]]), T @ model.A @ back)
    assert got.A211.shape == (p - r, n - p)
    assert np.linalg.matrix_rank(got.E222) == r
    assert (T[:, 0] > 0).all()


@settings(max_examples=20)
@given(model=random_plants)
def test_units_of_the_unknown_inputs_change_nothing_else(model):
    """Each in its own: two of them 18 decades apart, beyond what a pseudo-inverse would keep."""
    units = np.array([1e-9, 1e9])[: model.E.shape[1]]
    one, other = split(model, "test"), split(model._replace(E=model.E * units), "test")
    np.testing.assert_allclose(other.T, one.T, rtol=0, atol=1e-9 * np.abs(one.T).max())
    np.testing.assert_allclose(other.E222 / units, one.E222, rtol=0, atol=1e-9 * np.abs(one.E222).max())


EVEN = np.kron(np.eye(2), [[1.0, 1.0]]) / np.sqrt(2)  # [1 1 0 0; 0 0 1 1]: each axis is as close to it as the others
SPACES = {"axes": np.eye(6)[[0, 2, 5]], "pairs": EVEN, "axes late": np.eye(5)[[3, 4]], "one": np.ones((1, 3)) / 3**0.5}


@pytest.mark.parametrize("name", SPACES)
def test_the_basis_belongs_to_the_null_space_and_not_to_the_outputs(name):
    """Axes are axes, in their order, and of equally close ones the first is taken: rounding decides nothing."""
    space = SPACES[name]
    k, n = space.shape
    seen = np.linalg.svd(space)[2][k:]
    for seed in range(20):
        rng = np.random.default_rng(seed)
        C, E = rng.normal(size=(n - k, n - k)) @ seen, (rng.normal(size=(1, n - k)) @ seen).T
        got = split(Model(rng.normal(size=(n, n)), E, C, E=E), "test")
        np.testing.assert_allclose(got.T[:k], space, atol=1e-11)


def apart(model, got, L1, A22s, gains, rng):
    """How far the error, moved by the gains in the plant's own coordinates, is from (13), (14); relative."""
    Gx, Lx = gains
    (p, n), r = model.C.shape, model.E.shape[1]
    x, xhat, u, f, v = (rng.normal(size=k) for k in (n, n, p, r, p))
    x_rate = model.A @ x + model.B @ u + model.E @ f
    xhat_rate = model.A @ xhat + model.B @ u + Gx @ (model.C @ (x - xhat)) + Lx @ v
    L = np.hstack([L1, np.zeros((n - p, r))])
    e, e_rate = got.T @ (x - xhat), got.T @ (x_rate - xhat_rate)
    k = n - p
    ebar1, s = e[:k] - L @ e[k:], e[k:]
    np.testing.assert_allclose(s, got.Tp @ model.C @ (x - xhat), atol=1e-9 * np.abs(got.T).max())
    want1 = (got.A11 - L1 @ got.A21[: p - r]) @ ebar1
    want2 = got.A21 @ ebar1 + A22s @ s + np.concatenate([np.zeros(p - r), got.E222 @ f]) - v
    off = np.concatenate([e_rate[:k] - L @ e_rate[k:] - want1, e_rate[k:] - want2])
    return np.abs(off).max() / max(np.abs(x_rate).max(), np.abs(xhat_rate).max(), 1.0) / np.linalg.cond(got.T)


@settings(max_examples=60)
@given(model=random_plants, seed=st.integers(0, 2**31 - 1), sliding=st.booleans())
def test_the_error_moves_as_the_page_says_whatever_f_and_v(model, seed, sliding):
    got, rng = split(model, "test"), np.random.default_rng(seed)
    p, r = len(model.C), model.E.shape[1]
    L1, A22s = rng.normal(size=(len(got.A11), p - r)), sliding * rng.normal(size=(p, p))
    assert apart(model, got, L1, A22s, injection(got, L1, A22s), rng) < 1e-11


def turn(gains):
    return gains[0], -gains[1]


MISREADINGS = {
    "L turned": lambda got, L1, A22s: injection(got, -L1, A22s),
    "Lx turned": lambda got, L1, A22s: turn(injection(got, L1, A22s)),
    "A22s turned": lambda got, L1, A22s: injection(got, L1, -A22s),
    "Tp with its rows swapped": lambda got, L1, A22s: injection(got._replace(Tp=got.Tp[::-1]), L1, A22s),
    "Tp transposed": lambda got, L1, A22s: injection(got._replace(Tp=got.Tp.T), L1, A22s),
    "T inverted": lambda got, L1, A22s: injection(got._replace(T=np.linalg.inv(got.T)), L1, A22s),
}


@pytest.mark.parametrize("name", MISREADINGS)
def test_a_misread_injection_does_not_pass(name):
    """The check above can fail: each of these differs from them on a plant without symmetry."""
    model, rng = plant(4, 2, 2, 1), np.random.default_rng(0)
    got, L1, A22s = split(model, "test"), rng.normal(size=(2, 2)), rng.normal(size=(3, 3))
    assert apart(model, got, L1, A22s, injection(got, L1, A22s), np.random.default_rng(1)) < 1e-12
    assert apart(model, got, L1, A22s, MISREADINGS[name](got, L1, A22s), np.random.default_rng(1)) > 1e-3


def test_optimum_of_the_sliding_mode_observer():
    found = sliding_mode.solve(ARM, 1.0, "arm")
    assert found.r == pytest.approx(2.6245619646, rel=1e-7)
    np.testing.assert_allclose(found.L1, BEST_L1, rtol=1e-4)
    np.testing.assert_allclose(found.P1, [[13.6226948, -4.2097973], [-4.2097973, 2.4040103]], rtol=1e-4)
    np.testing.assert_allclose(found.P2, np.eye(2), atol=1e-4)
    np.testing.assert_allclose(found.A22s, -2.6245619646 * np.eye(2), atol=1e-4)
    certificate = require_rate(sliding_mode.certify(found, ARM), 1.0, "arm")
    assert certificate.margin == pytest.approx(1, abs=1e-7)
    assert certificate.numbers["r"] == pytest.approx(found.r, rel=1e-7)
    assert certificate.numbers["rate_asked"] == 1


@pytest.mark.parametrize(("L1", "g", "KP", "KI"), [
    (PRINTED.L1, 64.4553068045, 21.9150897, 22.3963895),
    (BEST_L1, 64.90574, 22.0655, 22.5468),
], ids=["printed L1", "designed L1"])  # fmt: skip
def test_optimum_of_the_pi_observer(L1, g, KP, KI):
    found = pi_lmi.solve(ARM, L1, 1.0, "arm")
    assert found.g == pytest.approx(g, rel=1e-7)
    np.testing.assert_allclose(found.KP, KP * np.eye(2), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(found.KI, KI * np.eye(2), rtol=1e-4, atol=1e-4)
    certificate = require_rate(pi_lmi.certify(found, ARM, L1), 1.0, "arm")
    assert certificate.margin == pytest.approx(1, abs=1e-7)
    assert certificate.numbers["g"] == pytest.approx(found.g, rel=1e-7)


def test_a_second_solver_finds_the_sliding_mode_optimum():
    found = sliding_mode.solve(ARM, 1.0, "arm", "SCS")
    assert found.r == pytest.approx(2.6245619646, rel=1e-6)
    np.testing.assert_allclose(found.L1, BEST_L1, rtol=1e-4)


@pytest.mark.nightly
def test_a_second_solver_finds_the_pi_optimum():
    """Ten seconds of a first-order method."""
    found = pi_lmi.solve(ARM, PRINTED.L1, 1.0, "arm", "SCS")
    assert found.g == pytest.approx(64.4553068045, rel=1e-6)
    np.testing.assert_allclose(found.KP, 21.9150897 * np.eye(2), atol=5e-3)
    np.testing.assert_allclose(found.KI, 22.3963895 * np.eye(2), atol=5e-3)


def test_printed_sliding_mode_gains_are_strictly_feasible():
    L1, P1, P2, A22s = PRINTED[:4]
    k1, k2, low = P1 @ L1, -P2 @ A22s, np.array([[0, 1], [-3.75, 0]])
    up, A211 = np.array([[0, 0], [3.75, -0.00125]]), low[:1]
    first = up.T @ P1 + P1 @ up - k1 @ A211 - A211.T @ k1.T + 2 * P1
    M = np.block([[first, low.T @ P2], [P2 @ low, -k2 - k2.T + 2 * P2]])
    assert np.linalg.eigvalsh((M + M.T) / 2)[-1] < 0
    assert np.linalg.eigvalsh(block_diag(P1, P2))[0] > 1
    certificate = sliding_mode.certify(PRINTED, ARM)
    assert 1 < certificate.margin < 1.001
    assert certificate.numbers["r"] == pytest.approx(2.6245619646, rel=4e-3)  # 0.3 % above the optimum
    assert require_rate(certificate, 1.0, "arm").solver == "paper"


def test_printed_pi_gains_are_feasible_to_their_rounding():
    certificate = pi_lmi.certify(PRINTED_PI, ARM, PRINTED.L1)
    assert 0.998 < certificate.margin < 1
    closed, P = pi_lmi.closed_loop(ARM, PRINTED.L1, PRINTED_PI.KP, PRINTED_PI.KI), PRINTED_PI.P
    assert 0 < np.linalg.eigvalsh(closed.T @ P + P @ closed + 2 * P)[-1] < 5e-3
    assert certificate.numbers["g"] == pytest.approx(64.4553068045, rel=3e-3)  # 0.2 % above the optimum
    with pytest.raises(DesignError, match=r"arm: .* margin 0\.999, expected above 0\.99999; .*paper said 'printed'"):
        require_rate(certificate, 1.0, "arm")


def test_the_pi_loop_is_the_error_with_its_integral():
    """[ebar1; s; s'] against a finite difference along v = KP s + w, w' = KI s, with f held."""
    rng = np.random.default_rng(2)
    KP, KI, L1 = rng.normal(size=(2, 2)), rng.normal(size=(2, 2)), PRINTED.L1
    ebar1, s, w, f = (rng.normal(size=2) for _ in range(4))
    A11b = ARM.A11 - L1 @ ARM.A21[:1]

    def s_rate(ebar1, s, w):
        return ARM.A21 @ ebar1 - KP @ s - w + f

    first, h = s_rate(ebar1, s, w), 1e-6
    later = s_rate(ebar1 + h * A11b @ ebar1, s + h * first, w + h * KI @ s)
    want = np.concatenate([A11b @ ebar1, first, (later - first) / h])
    got = pi_lmi.closed_loop(ARM, L1, KP, KI) @ np.concatenate([ebar1, s, first])
    np.testing.assert_allclose(got, want, atol=1e-8)


@pytest.mark.ci
@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", [(2, 1, 1), (3, 2, 1), (1, 1, 2)], ids=str)
def test_every_plant_has_gains_whose_proof_holds(size, seed):
    """Also where P1 may grow for ever, as A11 has a mode left of -alpha. What is proven is no more than what decays."""
    got = split(plant(seed, *size), "test")
    found = sliding_mode.solve(got, 1.0, "test")
    certificate = require_rate(sliding_mode.certify(found, got), 1.0, "test")
    closed = sliding_mode.closed_loop(got, found.L1, found.A22s)
    assert certificate.margin <= -np.linalg.eigvals(closed).real.max() + 1e-6
    for P in (found.P1, found.P2):
        assert np.linalg.eigvalsh(P)[0] > 1 - 1e-5  # the solver's rounding
    integral = pi_lmi.solve(got, found.L1, 0.9, "test")
    proof = require_rate(pi_lmi.certify(integral, got, found.L1), 0.9, "test")
    closed = pi_lmi.closed_loop(got, found.L1, integral.KP, integral.KI)
    assert proof.margin <= -np.linalg.eigvals(closed).real.max() + 1e-6
    assert np.linalg.eigvalsh(np.linalg.inv(integral.P))[0] > 1 - 1e-5


def test_a_proof_that_would_grow_for_ever_is_bounded():
    """The larger P1 may be, the smaller r: no minimum is attained, and the first bound is taken."""
    got = split(plant(0, 3, 2, 1, stable=1.0), "test")
    assert np.linalg.eigvals(got.A11).real.min() < -1
    found = sliding_mode.solve(got, 1.0, "test")
    assert np.linalg.norm(found.P1, 2) == pytest.approx(sliding_mode.BOUNDS[0], rel=1e-6)
    wider = sliding_mode._solve_with_bound(got, 1.0, 4 * sliding_mode.BOUNDS[0], "test", "CLARABEL")
    assert np.linalg.norm(wider.P1, 2) > 3 * sliding_mode.BOUNDS[0]
    assert wider.r < found.r
    assert sliding_mode._solve_with_bound(ARM, 1.0, 1e2, "arm", "CLARABEL").r == pytest.approx(2.6245619646, rel=1e-7)


def test_modes_that_no_gain_moves_are_named():
    """-0.000625 +- 1.9365j; -0.006 in print. At a rate below them there are gains."""
    np.testing.assert_allclose(sorted(unmovable(LINK), key=np.imag), [-0.000625 - 1.9364916j, -0.000625 + 1.9364916j])
    assert unmovable(ARM) == []
    said = r"arm: .* no gain L1 moves, -0\.000625[+-]1\.936j, -0\.000625[+-]1\.936j, expected .* left of -1 1/s; .*0\.000625"
    with pytest.raises(UserError, match=said):
        sliding_mode.solve(LINK, 1.0, "arm")
    with pytest.raises(UserError, match="no gain"):
        require_movable(LINK, 0.000625, "arm")
    require_movable(LINK, 0.0006, "arm")
    grows = LINK._replace(A11=-LINK.A11)
    with pytest.raises(UserError, match=r"left of -0\.0001 1/s; measure other outputs"):
        require_movable(grows, 1e-4, "arm")


def test_a_pi_observer_is_no_faster_than_what_l1_leaves():
    with pytest.raises(UserError, match=r"arm: got a rate beta of 1\.3 1/s, expected less than the 1\.245 1/s"):
        pi_lmi.solve(ARM, PRINTED.L1, 1.3, "arm")


def test_a_solver_without_an_answer_is_quoted():
    import cvxpy as cp

    x = cp.Variable()
    with pytest.raises(DesignError, match=r"arm: .*CLARABEL said 'infeasible'"):
        minimise(x, [x >= 1, x <= 0], (x,), "arm", "CLARABEL", "ask for less")
    with pytest.raises(DesignError, match=r"arm: .*HEARSAY said '.*HEARSAY"):
        minimise(x, [x >= 1], (x,), "arm", "HEARSAY", "ask for less")


def test_foreign_answers_prove_nothing():
    """What a damaged cache may bring: wrong shapes, wrong signs, a P that is not positive, or not of its form."""
    good = PRINTED
    wrong = [good._replace(P1=-good.P1), good._replace(P2=np.eye(3)), good._replace(P1=np.full((2, 2), np.nan))]
    assert all(np.isnan(sliding_mode.certify(one, ARM).margin) for one in wrong)
    assert sliding_mode.certify(good._replace(L1=-good.L1), ARM).margin < 0
    assert sliding_mode.certify(good._replace(A22s=-good.A22s), ARM).margin < 0
    pi = PRINTED_PI
    mixed = pi.P.copy()
    mixed[2, 3] = mixed[3, 2] = 1e-3
    turned = pi_lmi.form(pi.P[:2, :2], *(np.full(2, v) for v in (0.8261, -0.3339, 0.3328)))
    wrong = [pi._replace(P=P) for P in (mixed, turned, -pi.P, np.eye(5))] + [pi._replace(KP=np.eye(3))]
    assert all(np.isnan(pi_lmi.certify(one, ARM, PRINTED.L1).margin) for one in wrong)
    assert pi_lmi.certify(pi._replace(KI=-pi.KI), ARM, PRINTED.L1).margin < 0
    assert pi_lmi.certify(pi._replace(KP=pi.KI, KI=-pi.KP), ARM, PRINTED.L1).margin < 0
    with pytest.raises(DesignError, match="nan"):
        require_rate(pi_lmi.certify(wrong[0], ARM, PRINTED.L1), 1.0, "arm")


def test_a_proven_rate_is_the_largest_that_p_proves():
    """Against the inequality itself, on either side; an asymmetric P stands for its symmetric part."""
    rng = np.random.default_rng(3)
    closed, root, skew = rng.normal(size=(4, 4)), rng.normal(size=(4, 4)), rng.normal(size=(4, 4))
    P = root @ root.T + np.eye(4)
    rate = proven_rate(closed, P)
    for step, sign in ((1e-6, -1), (-1e-6, 1)):
        worst = np.linalg.eigvalsh(closed.T @ P + P @ closed + 2 * (rate - step) * P)[-1]
        assert np.sign(worst) == sign
    assert proven_rate(closed, P + skew - skew.T) == pytest.approx(rate)


BROKEN = {
    "C": (
        MODEL._replace(C=C[[0, 0]]),
        r"Assumption 2, rank C = p, .* got rank 1, expected 2; leave a repeated output out",
    ),
    "E": (MODEL._replace(E=D[:, [0, 0]]), r"Assumption 1, rank E = r, .* got rank 1, expected 2"),
    "C E": (MODEL._replace(E=np.eye(4)[:, [0]]), r"Assumption 1, rank\(C E\) = r, .* got rank 0, expected 1; measure"),
    "rounding": (
        MODEL._replace(C=np.array([[0.1, 0.1, -0.2, 0], [0, 0, 0, 1.0]]), E=np.array([[0.1, 0.2, 0.15, 0]]).T),
        r"Assumption 1, rank\(C E\) = r, .* got rank 0, expected 1",
    ),
    "n > p": (MODEL._replace(C=np.eye(4)), r"Assumption 2, n > p, .* got 4 states and 4 outputs"),
    "p >= m": (MODEL._replace(B=np.eye(4)[:, :3]), r"Assumption 2, p >= m, .* got 2 outputs and 3 inputs"),
    "p > r": (MODEL._replace(E=np.eye(4)[:, 1:3]), r"Assumption 2, p > r, .* got 2 outputs and 2 unknown inputs"),
    "observable": (
        MODEL._replace(A=A * np.array([1, 1, 1, 0]), C=C),
        r"Assumption 2, \(C, A\) observable, .* got rank 3 of .* at the mode lam = -?0, expected 4",
    ),
    "discrete": (MODEL._replace(discrete=True), "got a discrete model, expected x' = A x"),
    "no E": (MODEL._replace(E=None), "the plant has no unknown input, .* use another observer"),
    "empty E": (MODEL._replace(E=np.zeros((4, 0))), "the plant has no unknown input"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_an_assumption_that_is_not_met_is_named_with_the_rank_found(name):
    model, said = BROKEN[name]
    with pytest.raises(UserError, match=r"^cell: .*" + said) as caught:
        split(model, "cell")
    assert str(caught.value).count(". ") == 0
    assert str(caught.value).endswith(".")


def test_answers_are_remembered(tmp_path, monkeypatch):
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    first = [sliding_mode.solve(ARM, 1.0, "arm"), pi_lmi.solve(ARM, PRINTED.L1, 1.0, "arm")]
    for module in (sliding_mode, pi_lmi):
        monkeypatch.setattr(module, "_solve", lambda *_: pytest.fail("nothing is solved"))
    again = [sliding_mode.solve(ARM, 1.0, "arm"), pi_lmi.solve(ARM, PRINTED.L1, 1.0, "arm")]
    for one, other in zip(first, again, strict=True):
        for left, right in zip(one, other, strict=True):
            np.testing.assert_array_equal(left, right)
    assert len(list(tmp_path.rglob("*.json"))) == 2
