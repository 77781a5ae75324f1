"""Check the reference itself on plants other than the cart: `python -m tests.reference.check_linear`.

Each function prints a largest difference which must be of the order of rounding.
"""

import numpy as np

from . import linear, moments

Array = np.ndarray


def plant(seed: int, n: int = 3, m: int = 2, q: int = 2) -> tuple[linear.Model, np.random.Generator]:
    """Return a random plant, neither symmetric nor square, with a tick of 0.05 s."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((n, n)) - 0.5 * np.eye(n)
    return linear.Model(A, rng.standard_normal((n, m)), rng.standard_normal((q, n)), 0.05), rng


def perfect_start(te: int, d: int) -> None:
    """Show the largest error from the true initial state without noise (kfbo's is not 0: it holds Y)."""
    model, rng = plant(1)
    u = rng.standard_normal((121, 2))
    x0 = rng.standard_normal(3)
    x, samples = linear.simulate(model, u, x0, [te, te], [d, d])
    L, K = rng.standard_normal((3, 2)) * 0.1, rng.standard_normal((3, 2)) * 0.1
    xhats = {
        "pccebo": linear.pccebo(model, u, samples, x0, L),
        "dkf": linear.dkf(model, u, samples, x0, np.eye(3), np.ones(2)),
        "open-loop": linear.open_loop(model, u, x0),
        "kfbo, sampled innovation": linear.kfbo(model, u, samples, x0, K, te, d, sampled_innovation=True),
        "kfbo": linear.kfbo(model, u, samples, x0, K, te, d),
    }
    scale = np.abs(x).max()
    for name, xhat in xhats.items():
        print(f"perfect start, te {te}, d {d}, {name}: {np.abs(x - xhat).max() / scale:.1e}")


def error_recursion(te: int, d: int) -> None:
    """Compare pccebo with e(t) = e^{A(t - t_m)} e_m, e_m = (I - L C) Phi e_{m-1} (17), (22)."""
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
    print(f"pccebo's error, te {te}, d {d}: {np.abs(e - expected).max() / np.abs(e).max():.1e}")


def batch_conditioning(te: list[int], d: list[int], intensity: float) -> None:
    """Compare dkf and posterior_covariance with Gaussian conditioning on all the measurements at once."""
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
    mean = linear.open_loop(model, u, xhat0)

    def joint(a: int, b: int) -> Array:
        """Return cov(x(t_a), x(t_b)) before any measurement."""
        return Phi[a - b] @ prior[b] if a >= b else prior[a] @ Phi[b - a].T

    xhat = linear.dkf(model, u, samples, xhat0, P0, R, W)
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
    print(f"dkf against batch conditioning, te {te}, d {d}, q {intensity}: {worst[0]:.1e}, {worst[1]:.1e}")


def monte_carlo(seeds: int = 4000) -> None:
    """Compare the moments of kfbo, lag-aware, with random draws; the last figure is in standard errors."""
    model, rng = plant(4)
    model = model._replace(A=model.A - 2 * np.eye(3))
    N, te, d = 60, 8, 11
    u, K = rng.standard_normal((N + 1, 2)), rng.standard_normal((3, 2)) * 0.3

    def error_of(u: Array, x0: Array, xhat0: Array, noise: list[Array]) -> Array:
        x, samples = linear.simulate(model, u, x0, [te, te], [d, d], noise)
        return x - linear.kfbo(model, u, samples, xhat0, K, te, d, lag_aware=True)

    counts = moments.sample_counts(N, [te, te], [d, d])
    response = moments.error_map(error_of, u, np.ones(3), np.zeros(3), counts)
    var = np.diagonal(moments.covariance(response, 0.5, np.eye(3)), axis1=1, axis2=2)
    draws = []
    for _ in range(seeds):
        noise = [0.5 * rng.standard_normal(count) for count in counts]
        e = error_of(u, np.ones(3) + rng.standard_normal(3), np.zeros(3), noise)
        draws.append([np.mean(np.abs(e[:-1])), np.mean(e[:-1] ** 2)])
    got, se = np.mean(draws, axis=0), np.std(draws, axis=0) / np.sqrt(seeds)
    mae = np.mean(moments.expected_mae(response.base, var))
    mse = np.mean(moments.root_expected_mse(response.base, var) ** 2)
    print(f"moments against {seeds} draws: E[MAE] {mae:.4f}, E[MSE] {mse:.4f}; off by", (got - [mae, mse]) / se)


if __name__ == "__main__":
    for period, late in ((7, 7), (7, 0), (4, 10), (9, 3), (1, 0)):
        perfect_start(period, late)
        error_recursion(period, late)
    for q in (0.0, 0.5):
        batch_conditioning([6, 6], [6, 6], q)
        batch_conditioning([4, 4], [9, 9], q)
        batch_conditioning([4, 8], [5, 5], q)
    monte_carlo()
