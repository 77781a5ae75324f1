"""The reference itself is right: perfect start, the closed error recursion, Gaussian conditioning, and random draws.

Plants here are random, with three states, two inputs and two outputs.
"""

import numpy as np
import pytest

from reference import linear, moments


def plant(seed, n=3, m=2, q=2):
    """Return a random plant, neither symmetric nor square, with a tick of 0.05 s."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) - 0.5 * np.eye(n)
    return linear.Model(A, rng.standard_normal((n, m)), rng.standard_normal((q, n)), 0.05), rng


TIMES = [(7, 7), (7, 0), (4, 10), (9, 3), (1, 0)]


@pytest.mark.parametrize(("te", "d"), TIMES)
def test_perfect_start_is_zero_but_for_kfbo_on_held_data(te, d):
    model, rng = plant(1)
    u = rng.standard_normal((121, 2))
    x0 = rng.standard_normal(3)
    x, samples = linear.simulate(model, u, x0, [te, te], [d, d])
    L, K = rng.standard_normal((3, 2)) * 0.1, rng.standard_normal((3, 2)) * 0.1
    xhats = {
        "pccebo": linear.pccebo(model, u, samples, x0, L),
        "kf": linear.kf(model, u, samples, x0, np.eye(3), np.ones(2)),
        "model-only": linear.model_only(model, u, x0),
        "kfbo, sampled innovation": linear.kfbo(model, u, samples, x0, K, te, d, sampled_innovation=True),
        "kfbo": linear.kfbo(model, u, samples, x0, K, te, d),
    }
    scale = np.abs(x).max()
    worst = {name: np.abs(x - xhat).max() / scale for name, xhat in xhats.items()}
    assert worst.pop("kfbo") > 1e-3, "it holds Y"
    assert max(worst.values()) < 1e-13


@pytest.mark.parametrize(("te", "d"), TIMES)
def test_pccebo_error_follows_its_recursion(te, d):
    """e(t) = e^{A(t - t_m)} e_m, e_m = (I - L C) Phi e_{m-1} (17), (22)."""
    model, rng = plant(2)
    u, x0, xhat0 = rng.standard_normal((121, 2)), rng.standard_normal(3), rng.standard_normal(3)
    x, samples = linear.simulate(model, u, x0, [te, te], [d, d])
    L = rng.standard_normal((3, 2)) * 0.2
    e = x - linear.pccebo(model, u, samples, xhat0, L)
    Phi = linear.powers(linear.discretise(model.A, model.B, model.h)[0], 400)
    expected, e_m = np.zeros_like(e), (np.eye(3) - L @ model.C) @ (x0 - xhat0)
    for k in range(121):
        if k < d:
            expected[k] = Phi[k] @ (x0 - xhat0)
            continue
        last = (k - d) // te * te
        expected[k] = Phi[k - last] @ e_m
        if (k + 1 - d) % te == 0:
            e_m = (np.eye(3) - L @ model.C) @ Phi[te] @ e_m
    np.testing.assert_allclose(e, expected, rtol=0, atol=1e-13 * np.abs(e).max())


@pytest.mark.ci
@pytest.mark.parametrize("intensity", [0.0, 0.5])
@pytest.mark.parametrize(("te", "d"), [([6, 6], [6, 6]), ([4, 4], [9, 9]), ([4, 8], [5, 5])])
def test_kf_is_gaussian_conditioning_on_all_measurements_at_once(te, d, intensity):
    model, rng = plant(3)
    model = model._replace(A=model.A - np.eye(3))  # unstable priors would cost the batch its digits
    N, n = 80, 3
    u, xhat0 = rng.standard_normal((N + 1, 2)), rng.standard_normal(n)
    root = rng.standard_normal((n, n))
    P0, R, W = root @ root.T, np.array([0.3, 0.7]), intensity * model.B @ model.B.T
    noise = [rng.standard_normal(N + 1) for _ in te]
    _, samples = linear.simulate(model, u, rng.standard_normal(n), te, d, noise)
    Ad, _ = linear.discretise(model.A, model.B, model.h)
    Qd, Phi = linear.process_noise(model.A, W, model.h), linear.powers(Ad, N + 1)
    prior = [P0]
    for _ in range(N):
        prior.append(Ad @ prior[-1] @ Ad.T + Qd)
    mean = linear.model_only(model, u, xhat0)

    def joint(a, b):
        """Return cov(x(t_a), x(t_b)) before any measurement."""
        return Phi[a - b] @ prior[b] if a >= b else prior[a] @ Phi[b - a].T

    xhat = linear.kf(model, u, samples, xhat0, P0, R, W)
    P = moments.posterior_covariance(model, N, te, d, R, P0, W)
    worst = np.zeros(2)
    for k in range(N + 1):
        known = [s for s in samples if s.arrival <= k]
        rows = [model.C[s.channel] for s in known]
        if not known:
            best, cov = mean[k], prior[k]
        else:
            S = np.array(
                [
                    [a @ joint(s.taken, r.taken) @ b for b, r in zip(rows, known, strict=True)]
                    for a, s in zip(rows, known, strict=True)
                ]
            )
            S += np.diag([R[s.channel] for s in known])
            cross = np.stack([joint(k, s.taken) @ c for c, s in zip(rows, known, strict=True)], axis=1)
            gap = np.array([s.value - c @ mean[s.taken] for c, s in zip(rows, known, strict=True)])
            best = mean[k] + cross @ np.linalg.solve(S, gap)
            cov = prior[k] - cross @ np.linalg.solve(S, cross.T)
        worst = np.maximum(worst, [np.abs(xhat[k] - best).max(), np.abs(P[k] - cov).max()])
    assert worst.max() < 1e-11


@pytest.mark.nightly
def test_moments_agree_with_random_draws():
    """Those of kfbo, lag-aware, within four standard errors."""
    model, rng = plant(4)
    model = model._replace(A=model.A - 2 * np.eye(3))
    N, te, d = 60, 8, 11
    u, K = rng.standard_normal((N + 1, 2)), rng.standard_normal((3, 2)) * 0.3

    def error_of(u, x0, xhat0, noise):
        x, samples = linear.simulate(model, u, x0, [te, te], [d, d], noise)
        return x - linear.kfbo(model, u, samples, xhat0, K, te, d, lag_aware=True)

    counts = moments.sample_counts(N, [te, te], [d, d])
    response = moments.error_map(error_of, u, np.ones(3), np.zeros(3), counts)
    var = np.diagonal(moments.covariance(response, 0.5, np.eye(3)), axis1=1, axis2=2)
    draws = []
    seeds = 4000
    for _ in range(seeds):
        noise = [0.5 * rng.standard_normal(count) for count in counts]
        e = error_of(u, np.ones(3) + rng.standard_normal(3), np.zeros(3), noise)
        draws.append([np.mean(np.abs(e[:-1])), np.mean(e[:-1] ** 2)])
    got, se = np.mean(draws, axis=0), np.std(draws, axis=0) / np.sqrt(seeds)
    mae = np.mean(moments.expected_mae(response.base, var))
    mse = np.mean(moments.root_expected_mse(response.base, var) ** 2)
    assert (np.abs(got - [mae, mse]) < 4 * se).all()
