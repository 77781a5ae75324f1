"""Print the page's numbers for the cart beside the reference's: `python -m tests.reference.check_numbers`.

Each line: what, page, computed, difference, and `ok` or `NO` at the tolerance which the page's digits allow.
"""

import numpy as np
from scipy.integrate import solve_ivp

from . import cart, linear, moments

Array = np.ndarray

TRAJECTORIES = {  # scenario: {t [s]: (x1, pccebo, kfbo)}, noise off
    "cart/nominal": {
        0.3: (12.7863665308, 12.7043993177, 8.4002266794),
        1.0: (24.8393019978, 24.8393019978, 22.0972268138),
        5.0: (27.2345425155, 27.2345425155, 26.5793827825),
        10.0: (18.6113648114, 18.6113648114, 18.3263872039),
    },
    "cart/gaussian": {
        1.0: (24.8393019978, 24.7573347846, 19.7488547221),
        10.0: (18.6113648114, 18.6113648114, 17.3411568810),
    },
    "cart/drift": {
        1.0: (25.0722136002, 25.3130643063, 22.4652716251),
        10.0: (12.3145190137, 12.1338263435, 12.0922824663),
    },
}
HORIZON = {  # (scenario, observer): MAE, RMSE of position, noise off
    ("cart/nominal", "pccebo"): (0.103207320611, 0.718289573851),
    ("cart/nominal", "kfbo"): (1.24159579664, 1.64144588764),
    ("cart/drift", "pccebo"): (0.404416848, 0.832434884),
    ("cart/drift", "kfbo"): (1.520568139, 1.992617586),
    ("cart/drift", "dkf"): (0.401954, 0.831066),
}
EXPECTED = {  # (scenario, observer): E[MAE], sqrt E[MSE] over noise, x(0) fixed
    ("cart/gaussian", "pccebo"): (1.05501888, 1.57774025),
    ("cart/gaussian", "kfbo"): (3.41228, 3.62855),
    ("cart/gaussian", "dkf"): (0.619924, 1.323049),
    ("cart/white", "pccebo"): (0.56425262, 0.92679011),
}
RATIO = {"cart/gaussian": 3.03, "cart/gaussian-fast": 5.12, "cart/white": 5.34}
RICCATI = {  # R: (K), (P11, P12, P22)
    0.004: ((2.04050070296576, 2.08182155940188), (0.00816200281186, 0.00832728623761, 1.03292075440975)),
    0.3: ((0.237356226506586, 0.028168989130723), (0.0712068679520, 0.00845069673922, 1.03299082767383)),
}


def line(what: str, page: float, computed: float, tolerance: float) -> None:
    """Print one comparison."""
    verdict = "ok" if abs(computed - page) <= tolerance else "NO"
    print(f"{what:52s} {page:>18.13g} {computed:>18.13g} {computed - page:>10.1e}  {verdict}")


def check_gains() -> None:
    """Compare K, P, L, and the residual of (27) with Q = 0.002 B B'."""
    A, B, C, _ = cart.MODEL
    for R, (gain, cov) in RICCATI.items():
        K, P = cart.kfbo_gain(R)
        for i in range(2):
            line(f"R = {R}: K{i + 1}", gain[i], K[i, 0], 2e-14)
        for name, page, got in zip(("P11", "P12", "P22"), cov, P[[0, 0, 1], [0, 1, 1]], strict=True):
            line(f"R = {R}: {name}", page, got, 5e-14)
        residual = A @ P + P @ A.T - P @ C.T @ C @ P / R + cart.INTENSITY * B @ B.T
        line(f"R = {R}: residual of (27), relative to Q22", 0.0, np.abs(residual).max() / 252.05, 1e-13)
    L = cart.pccebo_gain(200)
    line("L1 at te = 0.2", 1.0, L[0, 0], 1e-12)
    line("L2 at te = 0.2", 2.07408e-13, L[1, 0], 1e-18)


def check_runs() -> None:
    """Compare the noise-free runs."""
    for scenario, table in TRAJECTORIES.items():
        tolerance = 1e-7 if scenario == "cart/drift" else 6e-11
        runs = {name: cart.run(scenario, name) for name in ("pccebo", "kfbo")}
        for t, (x1, pccebo, kfbo) in table.items():
            k = round(t / cart.TICK)
            line(f"{scenario} t = {t:g}: x1", x1, runs["pccebo"][0][k, 0], tolerance)
            line(f"{scenario} t = {t:g}: pccebo", pccebo, runs["pccebo"][1][k, 0], tolerance)
            line(f"{scenario} t = {t:g}: kfbo", kfbo, runs["kfbo"][1][k, 0], tolerance)
    for (scenario, observer), (mae, rmse) in HORIZON.items():
        e = np.subtract(*cart.run(scenario, observer))
        tolerance = 5e-7 if observer == "dkf" else 1e-7 if scenario == "cart/drift" else 6e-12
        line(f"{scenario} {observer}: MAE", mae, cart.mae(e)[0], tolerance)
        line(f"{scenario} {observer}: RMSE", rmse, cart.rmse(e)[0], tolerance)
        if scenario == "cart/nominal":
            line(f"{scenario} {observer}: velocity MAE", 0.0087068855, cart.mae(e)[1], 6e-11)
            line(f"{scenario} {observer}: velocity RMSE", 0.2149110012, cart.rmse(e)[1], 6e-11)
    e = np.subtract(*cart.run("cart/nominal", "dkf"))
    line("cart/nominal dkf: MAE", 0.1032073206, cart.mae(e)[0], 6e-11)
    e = np.subtract(*cart.run("cart/nominal", "kfbo", lag_aware=True))
    line("cart/nominal kfbo lag-aware: MAE", 0.4553, cart.mae(e)[0], 5e-5)
    line("cart/nominal kfbo lag-aware: tail RMSE", 0.0933, cart.rmse(e, cart.TAIL)[0], 5e-5)
    e = np.subtract(*cart.run("cart/nominal", "kfbo"))
    line("cart/nominal kfbo: tail RMSE (bias on the sawtooth)", 1.0414, cart.rmse(e, cart.TAIL)[0], 5e-5)
    with_last = np.sqrt(np.mean(e[cart.TAIL :, 0] ** 2))  # against the rule of ticks 0 .. N-1
    line("    the same with tick N counted", 1.0414, with_last, 5e-5)


def check_moments() -> None:
    """Compare expectations over the noise, and the ratios to the bound with x(0) fixed and random."""
    for scenario, ratio in RATIO.items():
        case = cart.SCENARIOS[scenario]
        R = np.array([case.noise_std**2])
        bound = moments.posterior_covariance(cart.MODEL, cart.TICKS, [case.te], [case.d], R, cart.P0)
        floor = np.sqrt(np.mean(bound[cart.TAIL : -1, 0, 0]))
        for observer in ("pccebo", "kfbo", "dkf"):
            response = moments.cart_map(scenario, observer)
            mean, var = moments.cart_moments(response, case.noise_std)
            tail = moments.root_expected_mse(mean, var, cart.TAIL)[0]
            spread = moments.cart_moments(response, case.noise_std, random_start=True)
            random_tail = moments.root_expected_mse(*spread, cart.TAIL)[0]
            full = moments.expected_mae(mean, var)[0], moments.root_expected_mse(mean, var)[0]
            if (scenario, observer) in EXPECTED:
                mae, rmse = EXPECTED[scenario, observer]
                tolerance = 6e-9 if observer == "pccebo" else 5e-6 if observer == "kfbo" else 5e-7
                line(f"{scenario} {observer}: E[MAE]", mae, full[0], tolerance)
                line(f"{scenario} {observer}: sqrt E[MSE]", rmse, full[1], tolerance)
            else:
                print(f"{scenario} {observer}: E[MAE] {full[0]:.9f}, sqrt E[MSE] {full[1]:.9f} (no page)")
            if scenario == "cart/gaussian" and observer != "kfbo":
                line(f"{scenario} {observer}: tail rms", {"pccebo": 1.0, "dkf": 0.3308}[observer], tail, 5e-5)
            print(f"  tail rms {tail:.6f} (x0 fixed), {random_tail:.6f} (x0 random); bound {floor:.6f}")
            if observer == "pccebo":
                line(f"{scenario} pccebo: times the bound, x0 random", ratio, random_tail / floor, 5e-3)
            else:
                print(f"  times the bound: x0 fixed {tail / floor:.4f}, x0 random {random_tail / floor:.4f}")
            if observer == "dkf":
                gap = np.abs(spread[1] - np.diagonal(bound, axis1=1, axis2=2)).max()
                line(f"{scenario} dkf: variance less the bound, x0 random", 0.0, gap, 1e-12)


def accurate_drift() -> Array:
    """Return x [N+1, 2] of the drifting plant by an eighth-order method started anew at every tick."""
    u = cart.sawtooth()
    x = [cart.X0]
    for k in range(cart.TICKS):

        def field(t: float, y: Array, u_k: float = u[k, 0]) -> tuple[float, float]:
            A22, B21 = cart.drifting(t, 1.0, 1.0)
            return y[1], A22 * y[1] + B21 * u_k

        span = (k * cart.TICK, (k + 1) * cart.TICK)
        x.append(solve_ivp(field, span, x[-1], method="DOP853", rtol=1e-13, atol=1e-14).y[:, -1])
    return np.stack(x)


def check_drift() -> None:
    """Compare RK4 with 1 and 20 steps a tick, and an accurate solution, with each other and with the page."""
    case, u = cart.SCENARIOS["cart/drift"], cart.sawtooth()
    exact = accurate_drift()
    plants = {
        "RK4, 1 step a tick": cart.drift_step(1.0, 1.0, 1),
        "RK4, 20 steps a tick": cart.drift_step(1.0, 1.0, 20),
        "accurate": lambda k, x, u_k: exact[k + 1],
    }
    for name, step in plants.items():
        x, samples = linear.simulate(cart.MODEL, u, cart.X0, [case.te], [case.d], plant_step=step)
        off = np.abs(x - exact).max(axis=0)
        print(f"{name}: largest difference from the accurate x: {off[0]:.2e} m, {off[1]:.2e} m/s")
        for k in (1000, 10000):
            line(f"  x1 at t = {k * cart.TICK:g}", TRAJECTORIES["cart/drift"][k * cart.TICK][0], x[k, 0], 1e-7)
        for observer in ("pccebo", "kfbo"):
            e = x - cart.observe(case, observer, u, samples)
            page = HORIZON["cart/drift", observer]
            line(f"  {observer}: MAE", page[0], cart.mae(e)[0], 1e-7)
            line(f"  {observer}: RMSE", page[1], cart.rmse(e)[0], 1e-7)


if __name__ == "__main__":
    check_gains()
    check_runs()
    check_drift()
    check_moments()
