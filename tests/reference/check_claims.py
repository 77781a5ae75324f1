"""Check the page's sentences on the cart, one function each: `python -m tests.reference.check_claims`."""

from collections.abc import Callable

import numpy as np
from scipy.linalg import solve_continuous_are

from . import cart, linear, moments

Array = np.ndarray


def claim(text: str, *values: float) -> None:
    """Print a sentence of the page and what the reference computes for it."""
    print(f"{text}\n    -> {', '.join(f'{value:.10g}' for value in values)}")


def errors_after_two_periods() -> None:
    """Show e = 10/122 m on [d, d + te), and its largest value after that."""
    e = np.subtract(*cart.run("cart/nominal", "pccebo"))[:, 0]
    claim("pccebo error 0.0819672 m on [d, d+te); then below 3e-12", e[200:400].min(), e[200:400].max())
    claim("    the second part", np.abs(e[400:]).max())


def literal_gamma() -> None:
    """Run (8a) with Gamma u_{m-1}, the input held over te, in place of the exact integral."""
    u, te = cart.sawtooth(), 200
    x, samples = linear.simulate(cart.MODEL, u, cart.X0, [te], [te])
    coarse = u[(np.arange(len(u)) // te) * te]
    Ad, Bd = linear.discretise(*cart.MODEL[:2], cart.TICK)
    Phi = linear.powers(Ad, 2 * te)
    L, xbar, e = cart.pccebo_gain(te), cart.XHAT0, []
    for i, sample in enumerate(samples):
        xhat_m = xbar + L[:, 0] * (sample.value - xbar[0])
        for k in range(te if i + 1 < len(samples) else 0):
            t = sample.arrival + k
            xhat = Phi[te + k] @ xhat_m + linear.held_response(Phi @ Bd, u, sample.taken, t)
            e.append(x[t, 0] - xhat[0])
        xbar = Phi[te] @ xhat_m + linear.held_response(Phi @ Bd, coarse, i * te, (i + 1) * te)
    claim("Gamma u_{m-1} leaves up to 0.45 m for ever: largest |e| after 3 s", np.abs(e[2800:]).max())


def frozen_drift() -> None:
    """A22, B21 frozen at the tick's start."""
    u = cart.sawtooth()
    x = cart.run("cart/drift", "open-loop", substeps=4)[0]
    y = [cart.X0]
    for k in range(cart.TICKS):
        A22, B21 = cart.drifting(k * cart.TICK, 1.0, 1.0)
        Ad, Bd = linear.discretise(np.array([[0, 1], [0, A22]]), np.array([[0], [B21]]), cart.TICK)
        y.append(Ad @ y[-1] + Bd @ u[k])
    off = np.abs(x - np.stack(y)).max(axis=0)
    claim("drift frozen at the tick's start: 6e-3 off", *off)


def runge_kutta() -> None:
    """RK4 of the nominal cart against the exact exponential."""
    step = cart.drift_step(0.0, 1.0, 1)
    u = cart.sawtooth()
    x, _ = linear.simulate(cart.MODEL, u, cart.X0, [200], [200])
    y, _ = linear.simulate(cart.MODEL, u, cart.X0, [200], [200], plant_step=step)
    off = np.abs(x - y)[:, 1]
    claim("RK4 differs by 6e-7 in velocity: largest, rms, mean |dv|", off.max(), cart.rmse(off), cart.mae(off))
    rest = np.zeros((201, 1))
    one, _ = linear.simulate(cart.MODEL, rest, np.array([0.0, 1.0]), [200], [200])
    two, _ = linear.simulate(cart.MODEL, rest, np.array([0.0, 1.0]), [200], [200], plant_step=step)
    claim("    from unit velocity, no input", np.abs(one - two)[:, 1].max())


def printed_q() -> None:
    """Solve (27) for the printed Q = 0.001 I, and for Q = 0.002 B B'."""
    A, _, C, _ = cart.MODEL
    P = solve_continuous_are(A.T, C.T, 0.001 * np.eye(2), np.array([[0.004]]))
    claim("K from Q = 0.001 I is [0.5002, 8e-6]", *(P @ C.T / 0.004)[:, 0])
    P = solve_continuous_are(A.T, C.T, cart.INTENSITY * cart.MODEL.B @ cart.MODEL.B.T, np.array([[0.004]]))
    claim("K from Q = 0.002 B B' (general Riccati solver)", *(P @ C.T / 0.004)[:, 0])


def sampled_innovation() -> None:
    """Spectral radius over one period of z' = A z + K (Y_i - C z(t_i))."""
    for te, R in ((0.2, 0.004), (1.0, 0.3), (1.0, 0.004)):
        K = cart.kfbo_gain(R)[0]
        E, G = linear.discretise(cart.MODEL.A, K, te)
        radius = np.abs(np.linalg.eigvals(E - G @ cart.MODEL.C)).max()
        claim(f"sampled innovation, te = {te}, R = {R}: spectral radius (page: > 1 at 1, 0.004)", radius)


def integer_ticks() -> None:
    """floor((0.2 i - 0.2)/0.2) against i - 1."""
    claim("floor wrong at", *[i for i in range(1, 31) if int(np.floor((0.2 * i - 0.2) / 0.2)) != i - 1])


def discrete_noise() -> None:
    """Closed-form Qd against a sum over ticks and against Van Loan's exponential over the whole of te."""
    A, B, _, h = cart.MODEL
    W = cart.INTENSITY * B @ B.T
    Ad, Qd = linear.discretise(A, B, h)[0], linear.process_noise(A, W, h)
    for te in (0.001, 0.2, 0.6, 1.0, 4.0):
        Q, closed = np.zeros((2, 2)), cart.process_covariance(te)
        for _ in range(round(te / h)):
            Q = Ad @ Q @ Ad.T + Qd
        with np.errstate(all="ignore"):
            whole = linear.process_noise(A, W, te)
        scale = np.abs(closed)
        claim(
            f"Qd at te = {te}: relative difference of closed form from ticks, Van Loan from closed form",
            np.max(np.abs(closed - Q) / scale),
            np.max(np.abs(whole - closed) / scale),
        )


def feasibility() -> None:
    """(23) is feasible iff (I - L C) Phi is Schur; the page: iff 0 < l1 + l2/122 < 2."""
    for te in (0.2, 0.01):
        Phi = cart.transition(te)
        for L in (
            [1e-6, 0.0],
            [-1e-6, 0.0],
            [2 - 1e-3, 0.0],
            [2 - 1e-13, 0.0],
            [3.0, -122 * 1.5],
            [0.0, 243.0],
        ):
            M = (np.eye(2) - np.outer(L, [1.0, 0.0])) @ Phi
            radius = np.abs(np.linalg.eigvals(M)).max()
            claim(f"te = {te}, L = {L}: l1 + l2/122, spectral radius", L[0] + L[1] / 122, radius)


def argmin_not_unique() -> None:
    """Show that ||(I - L C) Phi||_2 has many minimisers L; the Frobenius norm has one, their centre."""
    for te in (200, 100, 20):
        Phi = cart.transition(te * cart.TICK)
        L = cart.pccebo_gain(te)
        for shift in (0.0, 0.9, 1.1):  # along e1, which is orthogonal to the rest Phi - L c' = p c_perp'
            other = L + shift * np.array([[Phi[1, 1]], [0.0]])
            norm = np.linalg.norm(Phi - other @ Phi[:1], 2)
            claim(
                f"te = {te} ticks, l1 moved by {shift} eps: l1, spectral norm / eps",
                other[0, 0],
                norm / Phi[1, 1],
            )


def seeds(count: int = 2048) -> None:
    """Count the seeds on which pccebo beats kfbo in position over 10 s."""
    rng = np.random.default_rng(0)
    for scenario in ("cart/gaussian", "cart/gaussian-fast", "cart/white"):
        maps = {name: moments.cart_map(scenario, name) for name in ("pccebo", "kfbo")}
        std = cart.SCENARIOS[scenario].noise_std
        wins = np.zeros(2, int)
        for _ in range(count):
            v = std * rng.standard_normal(len(maps["kfbo"].noise))
            e = {name: (m.base + np.tensordot(v, m.noise, 1))[:, 0] for name, m in maps.items()}
            wins += [
                cart.mae(e["pccebo"]) < cart.mae(e["kfbo"]),
                cart.rmse(e["pccebo"]) < cart.rmse(e["kfbo"]),
            ]
        claim(f"{scenario}: of {count} seeds pccebo is better in MAE, RMSE", *wins)
    for scenario in ("cart/nominal", "cart/drift", "cart/slow"):
        runs = [np.subtract(*cart.run(scenario, name)) for name in ("pccebo", "kfbo")]
        claim(f"{scenario}: MAE, RMSE of pccebo, kfbo", *[f(e)[0] for e in runs for f in (cart.mae, cart.rmse)])


def steady_state(ticks: int = 50_000) -> None:
    """Kfbo's rms over one sawtooth period with variance 1, R = 1, te = d = 0.6."""
    response = moments.cart_map("cart/gaussian", "kfbo", ticks=ticks)
    mean, var = moments.cart_moments(response, 1.0)
    square = mean[:, 0] ** 2 + var[:, 0]
    period = round(np.pi / cart.TICK)
    total = np.concatenate([[0.0], np.cumsum(square)])
    rms = np.sqrt((total[period:] - total[:-period]) / period)  # over the ticks k .. k + period - 1
    below = np.nonzero(rms >= 1.0)[0].max() + 1
    claim("kfbo's rms over a period is below 1 for windows from, to [s]", below * 1e-3, (below + period) * 1e-3)
    claim("kfbo's rms over windows from 37, 40, 46 s on (page 0.33)", *rms[[37_000, 40_000, 46_000]])
    claim(
        "    of which bias, spread in the last",
        np.sqrt(np.mean(mean[-period:, 0] ** 2)),
        var[-period:, 0].mean() ** 0.5,
    )


CLAIMS: tuple[Callable[[], None], ...] = (
    errors_after_two_periods,
    literal_gamma,
    frozen_drift,
    runge_kutta,
    printed_q,
    sampled_innovation,
    integer_ticks,
    discrete_noise,
    feasibility,
    argmin_not_unique,
    seeds,
    steady_state,
)

if __name__ == "__main__":
    for check in CLAIMS:
        check()
