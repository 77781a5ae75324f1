"""The digester: its equilibria, its step by an integrator for stiff systems, and a run with its extended filter by hand."""

import jax.numpy as jnp
import numpy as np
import pytest
from reference import nonlinear, threefry
from scipy.integrate import solve_ivp

import pcbench
from pcbench.plants import digester
from pcbench.protocols import Now
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS

SIGNALS = [name for name, _ in digester.SIGNALS]
A1, A2 = np.array([0.2482, 0.2482, 0.3221, 0.6393]), np.array([0.6809, 0.6809, 0.7954, 0.5817])
A3, A4 = np.array([0.0207, 0.0207, -0.1689, 0.0344]), np.array([0.0456, 0.0456, 0.4588, 0.4152])
A9 = np.array([0.1372, 0.1372, 0.1723, 0.2286])
HYDROLYSIS = np.array([0.25, 0.025, 0.2, 0.1])
KCH4, KCO2, R, T, KLA, KP, P0, VL, VG = 0.0011, 0.025, 0.08315, 273.15, 200.0, 5e4, 1.013, 100.0, 10.0
H = 1 / 48 / 4  # d


def gas(x):
    p4, p2 = R * T * x[10] / 16, R * T * x[11] / 44
    return KP / P0 * (p4 + p2 - P0) * (p4 + p2), p4, p2


def rate(x, u):
    """dx/dt in g/(L d), as the source's program has it."""
    d, r, dead = u / VL, HYDROLYSIS * x[4:8], 0.02 * x[8]
    q = gas(x)[0]
    m4, m2 = KLA * (x[0] - KCH4 * R * T * x[10]), KLA * (x[1] - KCO2 * R * T * x[11])
    return np.array(
        [
            -d * x[0] + A1 @ r - m4,
            -d * x[1] + A2 @ r - m2,
            d * (0.592 - x[2]) - A3 @ r,
            d * (960.512 - x[3]) - A4 @ r,
            d * (11.699 - x[4]) - r[0] + 0.18 * dead,
            d * (11.699 - x[5]) - r[1],
            d * (4.75 - x[6]) - r[2] + 0.77 * dead,
            d * (1.381 - x[7]) - r[3] + 0.05 * dead,
            -d * x[8] + A9 @ r - dead,
            d * (17 - x[9]),
            m4 * VL / VG - q * x[10] / VG,
            m2 * VL / VG - q * x[11] / VG,
        ]
    )


def output(x):
    return np.array([*gas(x), x[2], 1 - x[3] / 1000, 1 - x[9] / (1000 - x[3])])


def slopes(f, x):
    """df/dx by complex steps."""
    return np.array([f(x + 1e-30j * e).imag / 1e-30 for e in np.eye(len(x))]).T


def fast_slopes(x):
    """The slopes of the rates of the fast states in the fast states, [12, 12]."""
    q, p4, p2 = gas(x)
    dq = KP / P0 * (2 * (p4 + p2) - P0) * np.array([R * T / 16, R * T / 44])
    out = np.zeros((12, 12), x.dtype)
    for i, (liquid, vapour, k) in enumerate([(0, 10, KCH4), (1, 11, KCO2)]):
        out[liquid, [liquid, vapour]] = -KLA, KLA * k * R * T
        out[vapour, liquid], out[vapour, vapour] = KLA * VL / VG, -KLA * VL / VG * k * R * T - q / VG
        out[vapour, 10:] -= x[10 + i] * dq / VG
    return out


def move(x, u):
    """A tick: four steps of ROS2 with gamma = 1 + 1/sqrt(2)."""
    for _ in range(4):
        W = np.eye(12) - (1 + np.sqrt(0.5)) * H * fast_slopes(x)
        k1 = np.linalg.solve(W, rate(x, u))
        k2 = np.linalg.solve(W, rate(x + H * k1, u) - 2 * k1)
        x = x + H * (3 * k1 + k2) / 2
    return x


def plant_step(x, u):
    """The same by pcbench, of concentrations."""
    with config.float64():
        p = digester.prepare(digester.Numbers(), 1800.0, 1)
        now = Now(*map(jnp.asarray, (0.0, 0, 1800.0)), jnp.array([u - float(p.feed)]), lambda age: jnp.zeros(1))
        return np.asarray(digester.step(p, now, jnp.asarray(x - p.level))) + p.level


@pytest.mark.parametrize(
    ("feed", "q", "pressures", "some"),
    [
        (133.71, 240.97, (0.5954, 0.4224), {0: 0.0155, 3: 960.094, 4: 9.857, 8: 0.4048, 11: 0.8183}),
        (5.0, 70.4, (0.544,), {8: 2.03}),
    ],
)
def test_it_rests_where_an_independent_program_found(feed, q, pressures, some, monkeypatch):
    monkeypatch.setitem(digester.FEEDS, "here", feed)
    x, _ = digester.operating_point("here")
    digester.operating_point.cache_clear()
    np.testing.assert_allclose(rate(x, feed), 0, atol=1e-10)
    found, *p = gas(x)
    assert found == pytest.approx(q, abs=0.05)
    np.testing.assert_allclose(p[: len(pressures)], pressures, rtol=0, atol=5e-4)
    for i, value in some.items():
        assert x[i] == pytest.approx(value, rel=3e-3)


def test_it_rests_at_the_printed_digits_under_the_mean_feed_of_the_program():
    x, feed = digester.operating_point("printed")
    assert feed == pytest.approx((1008 / 2 + 432) / 7, rel=1e-12)
    np.testing.assert_allclose(rate(x, feed), 0, atol=1e-10)
    printed = [
        "0.0155",
        "0.4745",
        "0.6506",
        "960.094",
        "9.857",
        "11.484",
        "4.136",
        "1.2852",
        "0.4048",
        "17",
        "0.4195",
        "0.8183",
        "240.97",
        "0.5954",
        "0.4224",
    ]
    for text, value in zip(printed, [*x, *gas(x)], strict=True):
        assert f"{value:.{len(text.partition('.')[2])}f}" == text


@pytest.mark.parametrize("point", digester.FEEDS)
def test_linear_model_is_the_slope_at_rest(point):
    model, (x, feed) = digester.nominal(digester.Numbers(point=point)), digester.operating_point(point)
    np.testing.assert_allclose(model.A * 86400, slopes(lambda z: rate(z, feed), x), rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(model.B[:, 0] * 86400, rate(x, feed + 1.0) - rate(x, feed), rtol=1e-7, atol=1e-9)
    np.testing.assert_allclose(model.C, slopes(output, x), rtol=1e-10, atol=1e-12)
    assert not digester.residual(digester.Numbers(point=point)).any()
    assert digester.residual(digester.Numbers(point=point, kF=0.3)).any()


@pytest.mark.parametrize("feed", [0.0, 42.0])
def test_a_tick_is_the_flow_of_half_an_hour(feed):
    """Of ROS2 from a state far off rest, and from rest of an integrator for stiff systems."""
    x = digester.operating_point("slow")[0] * np.linspace(0.8, 1.1, 12)
    np.testing.assert_allclose(plant_step(x, feed) / x, move(x, feed) / x, rtol=1e-11)
    x = digester.operating_point("slow")[0]
    want = solve_ivp(lambda t, z: rate(z, feed), (0, 1 / 48), x, method="Radau", rtol=1e-10, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(plant_step(x, feed), want, rtol=0, atol=2e-5)


@pytest.mark.ci
def test_run_and_its_filter_are_the_references():
    """Laboratory values each 6 h, 2.5 to 4 h late, for 30 h."""
    seed, ticks, level = 4, 60, digester.operating_point("slow")[0]
    base = SCENARIOS["digester/multirate"]
    tick, every = 1800.0, (1, 1, 1, 12, 12, 12)
    given = {
        "sampling_period": [k * tick for k in every],
        "sampling_phase": [0.0] * 3 + [2 * tick] * 3,
        "delay": [0.0] * 3 + [5 * tick] * 3,
        "delay_jitter": [0.0] * 3 + [3 * tick] * 3,
        "duration": ticks * tick,
        "steady_start": 0.0,
        "input": "zero",
    }
    frame = pcbench.simulate({"name": "short", "scenario": {"base": "digester/multirate"} | given}, ["ekf"], seed=seed)
    mean = digester.FEEDS["slow"]
    path = [level]
    for _ in range(ticks):
        path.append(move(path[-1], mean))
    std, together = np.array(base.sampling.noise_std), {}
    for j in range(6):
        for i, taken in enumerate(range(0 if j < 3 else 2, ticks + 1, every[j])):
            late = (
                int(threefry.uniform(0, seed, "jitter", 3, i, 3)[2] * 4) + 5 if j > 2 else 0
            )  # drawn under the first channel of the clock
            y = output(path[taken])[j] + std[j] * threefry.normal(0, seed, "measurement", j, i)
            together.setdefault((taken + late, taken), []).append((j, y))
    samples = [
        nonlinear.Sample(arrival, taken, *zip(*found, strict=True)) for (arrival, taken), found in together.items()
    ]
    Q, R = np.diag(np.square(base.belief.assumed_process_std)), np.square(std)

    def ahead(state, u):
        z, P = state
        F = slopes(lambda x: move(x, mean), z)
        return move(z, mean), F @ P @ F.T + Q

    def update(state, s):
        (z, P), some = state, list(s.channels)
        C = slopes(output, z)[some]
        K = np.linalg.solve(C @ P @ C.T + np.diag(R[some]), C @ P).T
        return (z + K @ (np.array(s.values) - output(z)[some]), P - K @ C @ P), 0.0

    first = level + np.array(base.belief.xhat0), np.eye(12)
    found = [z for z, _ in nonlinear.run(first, ahead, update, samples, np.zeros(ticks + 1))[0]]
    for prefix, want in (("", path), ("ekf.", found)):
        for j, name in enumerate(SIGNALS):
            theirs = np.array(want)[:, j] - level[j]
            got = frame[prefix + name].to_numpy()
            np.testing.assert_allclose(got, theirs, rtol=0, atol=1e-10 * max(1.0, np.abs(theirs).max()), err_msg=name)
