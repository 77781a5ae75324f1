"""The falling body: its path by an adaptive integrator, and a run with its extended and cubature filters by hand."""

import numpy as np
import pytest
from reference import nonlinear, threefry
from reference.ekf import rk4
from scipy.integrate import solve_ivp

import pcbench
from pcbench.papers import field
from pcbench.plants import falling_body

GAMMA, M, H, DT = 5e-5, 1e5, 1e5, 1 / 64
SIGNALS = [name for name, _ in falling_body.SIGNALS]


def motion(x, u=0.0):
    return np.array([-x[1], -np.exp(-GAMMA * x[0]) * x[1] ** 2 * x[2], 0 * x[2]])


def distance(x):
    return np.array([np.sqrt(M**2 + (x[0] - H) ** 2)])


def test_linear_model_is_the_slope_at_the_start():
    model = falling_body.nominal(falling_body.Numbers())
    for j, size in enumerate(falling_body.START):
        moved = np.array(falling_body.START, complex)
        moved[j] += 1e-30j * size
        np.testing.assert_allclose(model.A[:, j] * size, motion(moved).imag / 1e-30, rtol=1e-12, atol=1e-12)
        np.testing.assert_allclose(model.C[:, j] * size, distance(moved).imag / 1e-30, rtol=1e-12, atol=1e-12)


def test_body_has_its_altitudes():
    times = [10, 20, 30, 60]
    path = solve_ivp(lambda t, x: motion(x), (0, 60), falling_body.START, t_eval=times, rtol=1e-11, atol=1e-9)
    np.testing.assert_allclose(path.y[0], [102455, 39453, 32592, 26732], atol=0.5)


@pytest.mark.ci
def test_run_and_its_filters_are_the_references():
    """From 100,000 ft on, in dense air, for 2 s: one Runge-Kutta step a tick, with the draws of the run."""
    seed, ticks, x = 3, 128, np.array([1e5, 2e4, 1e-3])
    first = {
        "x0": x.tolist(),
        "xhat0": [1.01e5, 1.9e4, 9e-4],
        "prior_std": [1e3, 2e3, 1e-4],
        "duration": 2.0,
        "steady_start": 1.0,
    }
    frame = pcbench.simulate(
        {"name": "body", "scenario": {"base": "falling-body/radar"} | first}, ["ekf", "ukf"], seed=seed
    )
    path = [x]
    for _ in range(ticks):
        path.append(rk4(motion, path[-1], 0.0, DT))
    v = [100 * threefry.normal(0, seed, "measurement", 0, i) for i in range(2)]
    samples = [nonlinear.Sample(64 * i, 64 * i, (0,), (float(distance(path[64 * i])[0] + v[i - 1]),)) for i in (1, 2)]
    model = nonlinear.Model(
        motion, distance, DT, np.zeros((3, 3)), np.array([1e4]), np.full(3, -np.inf), np.full(3, np.inf)
    )
    start, P0, u = np.array(first["xhat0"]), np.diag([1e6, 4e6, 1e-8]), np.zeros(ticks + 1)
    for prefix, want in (
        ("", path),
        ("ekf.", [z for z, _ in nonlinear.by_slopes(model, start, P0, samples, u)[0]]),
        ("ukf.", [z for z, _ in nonlinear.by_points(model, start, P0, samples, u, cubature=True)[0]]),
    ):
        for j, name in enumerate(SIGNALS):
            theirs = np.array(want)[:, j]
            got = frame[prefix + name].to_numpy()
            np.testing.assert_allclose(got, theirs, rtol=0, atol=1e-10 * np.abs(theirs).max())


def medians(every, runs=400):
    """The median errors of altitude at 10, 20, 30 and 60 s, and of drag at 60 s.

    The cubature filter draws its points every so many ticks.
    """
    draws = np.random.default_rng(7)
    x = np.tile([3e5, 2e4, 1e-3], (runs, 1))
    m, P = np.tile([3e5, 2e4, 3e-5], (runs, 1)), np.tile(np.diag([1e6, 4e6, 1e-4]), (runs, 1, 1))

    def advanced(X):
        return np.moveaxis(rk4(motion, np.moveaxis(X, -1, 0), 0.0, DT), 0, -1)

    def points(m, P):
        L = np.linalg.cholesky(P).swapaxes(1, 2) * np.sqrt(3)
        return np.concatenate([m[:, None] + L, m[:, None] - L], 1)

    def moments(X):
        d = X - X.mean(1)[:, None]
        return X.mean(1), np.einsum("nki,nkj->nij", d, d) / 6

    out = []
    for second in range(1, 61):
        X = points(m, P)
        for tick in range(1, 65):
            x, X = advanced(x), advanced(X)
            if tick % every == 0:
                X = points(*moments(X))
        m, P = moments(X)
        Z = distance(np.moveaxis(X, -1, 0))[0]
        d = Z - Z.mean(1)[:, None]
        S, across = (d**2).mean(1) + 1e4, np.einsum("nki,nk->ni", X - m[:, None], d) / 6
        y = distance(x.T)[0] + 100 * draws.normal(size=runs)
        m, P = (
            m + across * ((y - Z.mean(1)) / S)[:, None],
            P - np.einsum("ni,nj->nij", across, across) / S[:, None, None],
        )
        if second in (10, 20, 30, 60):
            out.append(np.median(np.abs(x[:, 0] - m[:, 0])))
    return np.array([*out, np.median(np.abs(x[:, 2] - m[:, 2]))])


@pytest.mark.nightly
def test_medians_are_those_of_points_drawn_at_every_tick():
    """Medians of 400 runs have standard errors of about 5 %; points drawn once a second have smaller errors."""
    altitude, drag = (row.reproduced.split(", ") for row in field.falling_body.rows() if row.claim.startswith("ukf"))
    found = np.array([float(text) for text in [*altitude[:4], drag[0]]])
    np.testing.assert_allclose(found, medians(every=1), rtol=0.2)
    assert (medians(every=64)[1:] < 0.8 * found[1:]).all()
