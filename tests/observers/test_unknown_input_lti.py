"""An unknown input on a plant of one's own: feedthrough, two known inputs, no symmetry, gains by LMI.

The plant moves by exact exponentials, the observers by Runge-Kutta: they part by |A h|^5 / 120 of the state's size a tick,
2e-14 here, which is what a perfect start is held to. Against the oracles below, 1e-10 of the signals' size.
"""

from functools import cache
from itertools import product

import jax
import numpy as np
import pytest
from harness import PUSHED
from reference import irregular, linear
from reference import unknown_input as ui

import pcbench
from pcbench import planning
from pcbench.simulation import trajectory
from pcbench.study import parse

TICK, TICKS = 1e-3, 300
D = np.array([[0.7, -0.3], [0.0, 1.1]])
X0, XHAT0, NOISE, SIZE = [1.0, -2.0, 0.5], [0.4, -1.0, 0.0], [0.02, 0.05], 2.0
FINDERS = ("smo", "pio")
VARIANTS = {
    "predict": {},
    "hold, reconstruct": {"measurement": "hold", "reconstruct": True},
    "carry": {"reconstruct": True},
}
TIMES = [(te, d) for te in (1, 12) for d in (0, 30)]  # sampling period and delay, in ticks


def study(**changes):
    own = {name: getattr(PUSHED, name).tolist() for name in "ABCE"} | {"D": D.tolist(), "unknown_std": [SIZE]}
    own |= {"sampling_period": TICK, "delay": 0.0, "noise_std": NOISE, "duration": TICKS * TICK, "tick": TICK}
    return {
        "name": "own",
        "lti": own | {"input": "sine, square", "unknown_input": "rising", "x0": X0, "xhat0": XHAT0} | changes,
    }


@cache
def planned(variant="predict", observers=FINDERS, **changes):
    """The cells of TIMES, by (te, d), all of one shape."""
    axes = {"sampling_period": [TICK, 12 * TICK], "delay": [0.0, 30 * TICK]}
    options = {name: VARIANTS[variant] for name in observers if name in FINDERS}
    given = {key: list(v) if isinstance(v, tuple) else v for key, v in changes.items()}
    raw = study(**given) | {"axes": axes, "observers": list(observers), "options": options}
    return dict(zip(TIMES, planning.plan(parse.parse(raw, "own")), strict=True))


def record(p, seed=0, problem=None):
    """One run, arrays [N+1, ...]."""
    out = trajectory.jit_record()(p.layout, problem or p.problem, np.asarray(0), np.asarray(seed))
    return jax.tree.map(np.asarray, out)


def known_input(ticks=TICKS):
    t = np.arange(ticks + 1) * TICK
    return np.stack([np.sin(4 * t), np.where(t < 1, 1.0, -1.0)], 1)


@pytest.mark.ci
def test_the_plant_moves_as_a_loop_of_exact_ticks_with_the_unknown_input_held():
    Phi, Gamma = linear.discretise(PUSHED.A, PUSHED.B, TICK)
    push = linear.discretise(PUSHED.A, PUSHED.E, TICK)[1]
    u, f = known_input(), 10 * (2 * np.arange(TICKS + 1)[:, None] * TICK / np.pi - 1)
    x = [np.array(X0)]
    for k in range(TICKS):
        x.append(Phi @ x[k] + Gamma @ u[k] + push @ f[k])
    got = record(planned()[1, 0])
    np.testing.assert_allclose(got.x, np.hstack([x, f]), rtol=0, atol=1e-12 * np.abs(x).max())


def observer_of(name, p):
    """The reference's observer with the gains that the library has designed, and its coordinates."""
    numbers = p.certificates[name].numbers
    T, Tp = coordinates()
    parts = ui.blocks(T, Tp, ui.System(PUSHED.A, PUSHED.B, PUSHED.C, PUSHED.E))
    if name == "smo":
        return parts, ui.smo(parts, numbers["L1"], numbers["A22s"], numbers["P2"])
    return parts, ui.pio(parts, numbers["L1"], numbers["KP"], numbers["KI"])


def coordinates():
    """T and Tp by hand: with one hidden state and one unknown input both are unique but for signs, first entries positive."""
    c = PUSHED.C @ PUSHED.E[:, 0] / np.linalg.norm(PUSHED.C @ PUSHED.E)
    Tp = np.array([[c[1], -c[0]], c])
    hidden = np.cross(*PUSHED.C) / np.linalg.norm(np.cross(*PUSHED.C))
    reached = hidden @ PUSHED.E[:, 0] / np.linalg.norm(PUSHED.C @ PUSHED.E)
    T = np.vstack([hidden - reached * c @ PUSHED.C, Tp @ PUSHED.C])
    sign = np.sign(T[:, 0])
    return sign[:, None] * T, sign[1:, None] * Tp


def follow(parts, observer, u, y, d, xhat0, option):
    """What an observer of samples estimates, [N+1, n + r], by hand: one Runge-Kutta step of (xd, w, wy) a tick.

    y [N+1, p] as taken at each tick, NaN where nothing was; u [N+1, m]. Nothing moves before tick d.
    """
    (A, B, C, *_), E = PUSHED, PUSHED.E
    (Phi, Gamma), push = linear.discretise(A, B, TICK), linear.discretise(A, E, TICK)[1]
    predict, carry = option.get("measurement") != "hold", option.get("reconstruct", False)
    n, p = len(A), len(C)
    z, out = np.concatenate([xhat0, np.zeros(p), C @ xhat0]), []

    def field(z, u):
        xd, w, e = z[:n], z[n : n + p], z[n + p :] - C @ z[:n]
        s, model = observer.Tp @ e, A @ xd + B @ u
        rate = model + observer.Gx @ e + observer.Lx @ observer.v(s, w)
        return np.concatenate([rate, observer.w_rate(s), predict * C @ model])

    for k in range(len(u)):
        if k >= d and not np.isnan(y[k - d]).any():
            z[n + p :] = y[k - d] - D @ u[k - d]
        f = ui.lumped(parts, observer.v(observer.Tp @ (z[n + p :] - C @ z[:n]), z[n : n + p]))
        now = z[:n]
        for j in range(max(k - d, 0), k):
            now = Phi @ now + Gamma @ u[j] + carry * push @ f
        out.append(np.concatenate([now, f]))
        z = ui.rk4(field, z, [u[k - d]] * 3, TICK) if k >= d else z
    return np.array(out)


def measurements(got, d):
    """What was measured at each tick, from what arrives d ticks later; NaN of what is still on its way at the end."""
    return np.concatenate([got.newest[d:], np.full((d, got.newest.shape[1]), np.nan)])


@pytest.mark.ci
@pytest.mark.parametrize(
    ("variant", "times"), [*product(["predict"], TIMES), *product([*VARIANTS][1:], TIMES[3:])], ids=str
)
def test_smo_and_pio_with_designed_gains_equal_a_loop_in_numpy(times, variant):
    p = planned(variant)[times]
    got = record(p, seed=times[0] + times[1])
    for name in FINDERS:
        assert p.certificates[name].margin > 0.99
        want = follow(
            *observer_of(name, p),
            known_input(),
            measurements(got, times[1]),
            times[1],
            np.array(XHAT0),
            VARIANTS[variant],
        )
        np.testing.assert_allclose(got.estimates[name], want, rtol=0, atol=1e-10 * np.abs(want).max(), err_msg=name)


@pytest.mark.nightly
@pytest.mark.parametrize("times", TIMES, ids=str)
def test_kf_with_the_input_as_a_random_walk_equals_the_reference(times):
    te, d = times
    got = record(planned(observers=("kf",))[times], seed=te)
    n, A = 3, np.zeros((4, 4))
    A[:n, :n], A[:n, n:] = PUSHED.A, PUSHED.E
    model = linear.Model(A, np.vstack([PUSHED.B, np.zeros((1, 2))]), np.hstack([PUSHED.C, np.zeros((2, 1))]), TICK)
    sent = measurements(got, d)
    y = [linear.Sample(k + d, k, j, k // te, sent[k, j]) for k in range(0, TICKS - d + 1, te) for j in range(2)]
    P0, W = np.diag([*np.square(np.subtract(X0, XHAT0)), SIZE**2]), np.diag([0, 0, 0, SIZE**2])
    want = irregular.kf(model, known_input(), y, np.array([*XHAT0, 0.0]), P0, np.square(NOISE), W, None, D)
    np.testing.assert_allclose(got.estimates["kf"], want, rtol=0, atol=1e-10 * np.abs(want).max())


# ---------------------------------------------------------------- perfect start

PERFECT = {"unknown_input": "zero", "xhat0": tuple(X0), "noise_std": 0.0}


def without_sign(p):
    """PIO's xi is taken out: it would turn a rounding error of s into xi h."""
    pio = p.problem.gains["pio"]
    gains = p.problem.gains | {"pio": pio._replace(law=pio.law._replace(xi=np.asarray(0.0)))}
    return p.problem._replace(gains=gains)


def errors(got):
    return {name: np.abs(got.x - got.estimates[name]).max() / np.abs(got.x).max() for name in got.estimates}


@pytest.mark.ci
@pytest.mark.parametrize("times", TIMES, ids=str)
def test_perfect_start_is_zero_but_for_what_a_runge_kutta_step_leaves_out(times):
    p = planned("carry", **PERFECT)[times]
    a_tick = np.linalg.norm(PUSHED.A * TICK, 2) ** 5 / 120
    assert a_tick < 2.5e-14
    worst = errors(record(p, problem=without_sign(p)))
    assert max(worst.values()) < 3 * TICKS * a_tick


@pytest.mark.parametrize("slip", [-1, 1])
def test_one_tick_of_slip_in_the_age_is_caught_by_the_feedthrough(slip):
    p = planned("carry", **PERFECT)[12, 30]
    whole, plan = without_sign(p), p.problem.schedule
    got = record(p, problem=whole._replace(schedule=plan._replace(timestamp=plan.timestamp - slip)))
    assert min(errors(got).values()) > 1e-4


def test_a_known_input_that_is_one_tick_late_is_caught():
    """Late for the plant: what is missing of the first known input comes in as an unknown one, along the same column."""
    p = planned("carry", **PERFECT)[12, 30]
    whole, u = without_sign(p), known_input()[:, :1]
    late = np.vstack([[[0.0]], u[:-1]]) - u
    params = whole.params._replace(Gamma_f=whole.params.Gamma[:, :1], f=late)
    got = record(p, problem=whole._replace(params=params))
    assert min(errors(got).values()) > 1e-4


@pytest.mark.nightly
def test_a_table_and_a_trace_hold_the_unknown_input_of_a_plant_of_ones_own():
    raw = study(sampling_period=0.012, delay=0.03) | {"observers": ["smo", "kf"], "seeds": 2}
    runs = pcbench.run(raw).runs.set_index(["observer", "seed", "signal"])
    for seed in (0, 1):
        frame = pcbench.simulate(raw, ["smo", "kf"], seed=seed)
        for name in ("smo", "kf"):
            e = (frame["input"] - frame[f"{name}.input"])[:-1]
            assert runs.loc[(name, seed, "input")].rmse == pytest.approx(np.sqrt((e**2).mean()), rel=1e-9)
