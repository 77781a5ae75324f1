"""The reference for unknown inputs is right, by itself: digits worked out beforehand, Table 2, oracles in the test.

Table 2 of the paper: max and mean absolute errors of x1 .. x4 and d over 6 <= t <= 10. `joint` at dt = 1e-4 s;
the sampled observers at ticks of 5e-4 s, root mean squares of the x2 error over 6 <= t <= 10.
"""

from functools import cache

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import block_diag, expm

from reference import unknown_input as ui

OBSERVERS = {"smo": ui.SMO, "pio": ui.PIO}
NEARBY = 4  # runs from x(0) (1 + 1e-6 N(0, 1)), beside the nominal one, for each disturbance
TICK, TICKS = 5e-4, 20_000
A11B = np.array([[0, -0.8148], [3.75, -0.00125 - 2.4893]])  # A11 - L1 A211, by hand

PRINTED = {  # x1, x2, x3, x4, d as in Table 2
    ("d1", "smo", "max"): "5.3352e-4 .0027 5.2854e-6 5.1507e-4 .0170",
    ("d1", "smo", "mean"): "1.4163e-4 .0012 2.1532e-6 1.8376e-4 .0077",
    ("d2", "smo", "max"): "5.3181e-4 .0032 5.8621e-6 5.1517e-4 .3389",
    ("d2", "smo", "mean"): "1.4173e-4 .0013 1.9428e-6 1.8237e-4 .0068",
    ("d1", "pio", "max"): "5.3233e-4 1.0138e-6 1.3686e-6 5.1937e-4 .0048",
    ("d1", "pio", "mean"): "1.4084e-4 9.3354e-8 2.1170e-7 1.8101e-4 .0017",
    ("d2", "pio", "max"): "5.3245e-4 .0103 8.7710e-7 5.1956e-4 .3517",
    ("d2", "pio", "mean"): "1.4084e-4 8.6742e-4 1.4003e-7 1.8100e-4 .0126",
}
REPRODUCED = {  # what the recovered set-up gives; nan: chatter
    ("d1", "smo", "max"): [5.33524563e-4, 2.70942874e-3, 5.28292158e-6, 5.15076519e-4, 1.70221535e-2],
    ("d1", "smo", "mean"): [1.41614448e-4, 1.16258194e-3, 2.15286747e-6, 1.83755786e-4, 7.72465471e-3],
    ("d2", "smo", "max"): [5.31806411e-4, 3.15149679e-3, 5.86286101e-6, 5.15176932e-4, 0.338907868],
    ("d2", "smo", "mean"): [1.41717335e-4, 1.25554685e-3, 1.94246659e-6, 1.82361096e-4, 6.83939510e-3],
    ("d1", "pio", "max"): [5.3226e-4, np.nan, np.nan, 5.2009e-4, 0.0028],
    ("d1", "pio", "mean"): [1.40827e-4, np.nan, np.nan, 1.80996e-4, 0.00065],
    ("d2", "pio", "max"): [5.3231e-4, 0.0102866, np.nan, 5.1922e-4, 0.351612],
    ("d2", "pio", "mean"): [1.40827e-4, 8.66685e-4, np.nan, 1.80996e-4, 0.0126098],
}


def unit(text):
    """Return one unit of the last digit of a decimal number."""
    mantissa, _, exponent = text.partition("e")
    return 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))


def assert_digits(values, texts):
    """Check that each value is the decimal number printed, to half a unit of its last digit."""
    for value, text in zip(np.ravel(values), texts.split(), strict=True):
        assert abs(value - float(text)) <= 0.5001 * unit(text) + 1e-12, (value, text)


def simulate(name, seed, nearby):
    """Return trace and errors of runs d1, d2, d1, d2, ...: the first pair from X0, `nearby` pairs from near it."""
    t = ui.stage_times(ui.STEPS, ui.DT)
    shift = np.random.default_rng(seed).standard_normal((nearby + 1, 1, 4))
    shift[0] = 0
    x0 = np.broadcast_to(ui.X0 * (1 + 1e-6 * shift), (nearby + 1, 2, 4)).reshape(-1, 4)
    d = np.tile(np.stack([ui.d1(t), ui.d2(t)], axis=1), (1, nearby + 1))
    trace = ui.joint(OBSERVERS[name], d, x0)
    return trace, ui.errors(trace, d)


@cache
def long_run(name):
    """Return trace and errors [N+1, runs, 5] over 10 s."""
    return simulate(name, 0, NEARBY if name == "pio" else 0)


def entries(key):
    """Return the five numbers of one row of Table 2."""
    d, name, which = key
    return ui.table(long_run(name)[1])[("max", "mean").index(which)][("d1", "d2").index(d)]


# ---------------------------------------------------------------- the arm and its disturbances


def test_blocks_of_the_arm_are_those_printed():
    split = ui.arm_split()
    assert np.array_equal(split.T @ [1, 2, 3, 4], [1, 4, 3, 2])
    assert np.array_equal(split.A11, [[0, 0], [3.75, -0.00125]])
    assert np.array_equal(split.A12, [[0, 1], [-3.75, 0]])
    assert np.array_equal(split.A21, [[0, 1], [-3.75, 0]])
    assert np.array_equal(split.A22, [[0, 0], [3.75, -0.0015]])
    assert np.array_equal(split.T @ ui.ARM.D, [[0], [0], [0], [1]])
    assert np.array_equal(split.T @ ui.ARM.B, [[0], [0.25], [0], [0]])
    assert np.isclose(ui.DELTA, 0.11025, rtol=1e-14, atol=0)


def test_sawtooth_is_right_continuous_at_grid_times():
    d = ui.d2(ui.stage_times(ui.STEPS, ui.DT))
    jumps = 2 * np.arange(0, ui.STEPS + 1, 20_000)
    assert np.allclose(d[jumps], 0, atol=1e-15)  # what the fourth stage of the step before reads
    assert np.allclose(d[jumps[1:] - 1], 0.35, atol=1e-4)
    assert abs(d).max() <= 0.35
    assert d.min() == pytest.approx(-0.325)


def test_margin_over_the_lumped_input():
    t = ui.stage_times(ui.STEPS, ui.DT)
    margins = [1 - ui.DELTA - abs(d).max() for d in (0 * t, ui.d1(t), ui.d2(t))]
    assert np.round(margins, 2).tolist() == [0.89, 0.64, 0.54]


def test_plant_matches_an_adaptive_solver_under_drift():
    h, w = 1e-3, 1.3

    def factors(t):
        return 1 + 0.05 * np.sin(w * t + np.array([0.4, 1.0, 2.0]))

    def rate(t, x):
        k, gravity, friction = factors(t) * [15 / 4, 0.15 * 9.8 * 0.3 / 4, 1.0]
        twist = k * (x[0] - x[2])
        link = -twist - friction * 0.006 / 4 * x[1] - gravity * np.sin(x[0]) + ui.d1(t)
        return [x[1], link, x[3], twist - friction * 0.005 / 4 * x[3]]

    t = ui.stage_times(2000, h)
    x = ui.plant(ui.d1(t)[:, None], ui.X0[None], h, np.stack([factors(s) for s in t]))
    expected = solve_ivp(rate, (0, 2), ui.X0, rtol=1e-11, atol=1e-12).y[:, -1]
    assert np.allclose(x[-1, 0], expected, rtol=0, atol=1e-9)


@pytest.mark.nightly
def test_joint_run_carries_the_plant():
    d = ui.d2(ui.stage_times(3000, 1e-3))[:, None]
    assert np.allclose(ui.joint(ui.PIO, d, ui.X0[None], 1e-3).x, ui.plant(d, ui.X0[None], 1e-3), rtol=0, atol=1e-13)


def test_joint_rates_match_the_field_written_out():
    rng = np.random.default_rng(1)
    h = 1e-7
    d = ui.d1(ui.stage_times(2, h))[:, None]
    x0 = rng.standard_normal((1, 4))
    for name, observer in OBSERVERS.items():
        trace = ui.joint(observer, d, x0, h)
        s = x0[0, [2, 1]]  # err x3, err x2
        P2 = np.array([[1.0070, 0.0021], [0.0021, 1.0024]])
        KP = np.array([[21.7396, 0.0278], [0.0283, 21.8043]])
        v = P2 @ s / (np.linalg.norm(P2 @ s) + 0.005) if name == "smo" else KP @ s
        rate = observer.Gx @ s[[1, 0]] + observer.Lx @ v
        assert np.allclose(trace.v[0, 0], v, rtol=1e-14)
        assert np.allclose(trace.xhat[1, 0] / h, rate, rtol=1e-4)


# ---------------------------------------------------------------- Table 2


@pytest.mark.nightly
@pytest.mark.parametrize("key", [key for key in PRINTED if key[1] == "smo"], ids="-".join)
def test_smo_rows_of_table_2(key):
    assert np.allclose(entries(key), REPRODUCED[key], rtol=1e-6, atol=0)
    for value, text in zip(entries(key), PRINTED[key].split(), strict=True):
        assert abs(value - float(text)) <= max(1e-3 * float(text), unit(text))


@pytest.mark.nightly
@pytest.mark.parametrize("key", [key for key in PRINTED if key[1] == "pio"], ids="-".join)
def test_smooth_pio_entries_of_table_2(key):
    smooth = [0, 3] if key[0] == "d1" else [0, 1, 3, 4]
    # 0.2 %; what rounding alone can move (bands of 64 runs from 1e-6 apart): x4 max 0.4 %, x2, d under d2 1.1 %
    loose = 6e-3 if key[2] == "max" else 2e-3
    rtol = np.array([2e-3, 6e-3, np.nan, loose, 1.2e-2])
    printed = np.array([float(text) for text in PRINTED[key].split()])
    for expected in (printed, np.array(REPRODUCED[key])):
        assert (np.abs(entries(key) / expected - 1) <= rtol)[smooth].all()


@pytest.mark.nightly
@pytest.mark.parametrize(("which", "low", "high"), [("max", 2.5e-3, 4e-3), ("mean", 6e-4, 7.3e-4)])
def test_pio_disturbance_under_the_sine_differs_from_print(which, low, high):
    key = ("d1", "pio", which)
    assert low < entries(key)[4] < high < float(PRINTED[key].split()[4])  # the bands of 64 runs, and a little
    assert low < REPRODUCED[key][4] < high


@pytest.mark.nightly
def test_pio_chatter_is_a_band_not_a_number():
    largest, mean = ui.table(long_run("pio")[1])
    for d, column in [(0, 1), (0, 2), (1, 2)]:  # x2, x3 under d1; x3 under d2
        for values, which in [(largest, "max"), (mean, "mean")]:
            band = values[d::2, column]
            printed = float(PRINTED[("d1", "d2")[d], "pio", which].split()[column])
            assert 1e-8 < band.min() < band.max() < 3e-6
            assert band.max() - band.min() > 1e-4 * band.min()  # runs 1e-6 apart in x(0)
            assert printed / 3 < band.min() < band.max() < 3 * printed


@pytest.mark.nightly
def test_largest_disturbance_error_under_the_sawtooth_is_the_jump_itself():
    for name in OBSERVERS:
        late = np.abs(long_run(name)[1][ui.TAIL :, 1, 4])
        assert np.argmax(late) in (0, 20_000)  # t = 6 or t = 8
        assert late[0] == pytest.approx(late.max(), rel=1e-2)


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "seconds"), [("smo", 10.5e-3), ("pio", 42e-3)])
def test_recovery_after_a_jump(name, seconds):
    after = np.abs(long_run(name)[1][ui.TAIL : ui.TAIL + 10_000, 1, 4])
    assert (np.flatnonzero(after >= 0.1)[-1] + 1) * ui.DT == pytest.approx(seconds, abs=2e-4)


# ---------------------------------------------------------------- goldens and the free decay


def test_golden_decay_of_the_reduced_error():
    split = ui.arm_split()
    A11b = split.A11 - ui.L1_PAPER @ split.A21[:1]
    assert np.array_equal(A11b, A11B)
    assert_digits(expm(6 * A11b), "7.78287149e-4 -3.32787941e-4 1.531608714e-3 -2.38925673e-4")
    assert np.linalg.eigvals(A11b).real.max() == pytest.approx(-1.245, abs=5e-4)


@pytest.mark.nightly
def test_golden_smo():
    trace, e = long_run("smo")
    assert_digits(e[10_000, 0, :4], "-.30934764616 .062219271073 .0048433197700 .034746338006")
    assert_digits(trace.x[10_000, 0], "-1.0596069529 -.98420459216 -.37593055431 1.5433114858")
    assert_digits(e[-1, 0, :4], "5.5610703928e-6 -6.7067271606e-4 1.5151976782e-6 1.7083586380e-5")


@pytest.mark.nightly
def test_golden_pio():
    e = long_run("pio")[1]
    assert_digits(e[5000, 0, :4], "-.080768389829 .011462509784 .048295092679 1.2070130178")


def reduced_error(e):
    """Return ebar1 = [err x1, err x4] - L1 err x3 [..., 2]."""
    return e[..., [0, 3]] - e[..., 2:3] * ui.L1_PAPER[:, 0]


@pytest.mark.nightly
@pytest.mark.parametrize("name", OBSERVERS)
def test_reduced_error_decays_freely(name):
    ebar = reduced_error(long_run(name)[1])
    for i in [1, 777, 10_000, 20_001, 60_000, ui.STEPS]:
        assert np.allclose(ebar[i], ebar[0] @ expm(A11B * i * ui.DT).T, rtol=0, atol=1e-9)


@pytest.mark.nightly
def test_reduced_error_decays_freely_whatever_d_and_v_do():
    rng = np.random.default_rng(2)
    steps, h = 2000, 1e-3
    d, x0 = 10 * rng.standard_normal((2 * steps + 1, 3)), rng.standard_normal((3, 4))
    wild = ui.PIO._replace(v=lambda s, w: 5 * np.sign(s[..., ::-1]) + 3 * w)
    trace = ui.joint(wild, d, x0, h)
    ebar = reduced_error(trace.x - trace.xhat)
    assert np.abs((trace.x - trace.xhat)[-1, :, 1]).max() > 0.01  # x2 is not free
    assert np.allclose(ebar[-1], ebar[0] @ expm(A11B * steps * h).T, rtol=0, atol=1e-9)


@pytest.mark.nightly
def test_x1_and_x4_columns_are_the_initial_error():
    t = ui.DT * np.arange(ui.TAIL, ui.STEPS + 1, 100)
    ebar0 = ui.X0[[0, 3]] - ui.L1_PAPER[:, 0] * ui.X0[2]
    free = np.abs([expm(A11B * s) @ ebar0 for s in t])
    for name in OBSERVERS:
        largest, mean = ui.table(long_run(name)[1])
        assert np.allclose(largest[:2, [0, 3]], free.max(axis=0), rtol=0.02)
        assert np.allclose(mean[:2, [0, 3]], free.mean(axis=0), rtol=0.02)


# ---------------------------------------------------------------- the transform


def random_system(n, m, p, q, seed):
    """Return a random system: it meets the assumptions with probability one if the dimensions do."""
    rng = np.random.default_rng(seed)
    return ui.System(*(rng.standard_normal(shape) for shape in [(n, n), (n, m), (p, n), (n, q)]))


SIZES = [(4, 1, 2, 1), (5, 1, 3, 2), (6, 2, 4, 1), (7, 3, 4, 3)]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("size", SIZES)
def test_transform_isolates_the_unknown_input(size, seed):
    system = random_system(*size, seed)
    n, _, p, q = size
    split = ui.transform(system)
    inverse = np.linalg.inv(split.T)
    assert np.allclose(split.T @ system.D, np.vstack([np.zeros((n - q, q)), split.D222]), atol=1e-12)
    assert np.linalg.matrix_rank(split.D222) == q
    assert np.allclose(split.Tp @ split.Tp.T, np.eye(p), atol=1e-12)
    assert np.allclose(system.C @ inverse, np.hstack([np.zeros((p, n - p)), split.Tp.T]), atol=1e-10)
    blocks = np.block([[split.A11, split.A12], [split.A21, split.A22]])
    assert np.allclose(blocks @ split.T, split.T @ system.A, atol=1e-9)
    assert all(row[np.flatnonzero(np.abs(row) > 1e-12)[0]] > 0 for row in split.T)
    f = np.arange(1.0, q + 1)
    assert np.allclose(ui.lumped(split, split.Tp @ system.C @ system.D @ f), f)


@pytest.mark.parametrize("size", SIZES)
def test_injection_gives_the_error_system_13(size):
    system = random_system(*size, 5)
    n, _, p, q = size
    rng = np.random.default_rng(6)
    L1, A22s = rng.standard_normal((n - p, p - q)), rng.standard_normal((p, p))
    split = ui.transform(system)
    Gx, Lx = ui.injection(split, L1, A22s)
    L = np.hstack([L1, np.zeros((n - p, q))])
    to_bar = np.block([[np.eye(n - p), -L], [np.zeros((p, n - p)), np.eye(p)]]) @ split.T
    expected = np.block([[split.A11 - L1 @ split.A21[: p - q], np.zeros((n - p, p))], [split.A21, A22s]])
    assert np.allclose(to_bar @ (system.A - Gx @ system.C) @ np.linalg.inv(to_bar), expected, atol=1e-9)
    assert np.allclose(to_bar @ Lx, np.vstack([np.zeros((n - p, p)), np.eye(p)]), atol=1e-10)
    assert np.allclose((to_bar @ system.D)[: n - p], 0, atol=1e-10)


def test_transform_of_the_arm_is_a_permutation_up_to_order():
    split = ui.transform(ui.ARM)
    assert np.allclose(np.abs(split.T) @ np.abs(split.T).T, np.eye(4), atol=1e-12)
    assert np.allclose(np.sort(split.T.ravel())[-4:], 1)
    assert np.allclose(split.T[2:], ui.arm_split().T[2:])  # the measured rows have no choice but the sign


I4, E = np.eye(4), np.eye(4)[:, [1]]
REFUSED = {
    "rank C": (ui.ARM._replace(C=ui.C_ARM[[0, 0]]), "Assumption 1: rank C = 1, want p = 2"),
    "rank D": (ui.ARM._replace(D=0 * ui.D_ARM), "Assumption 1: rank D = 0, want q = 1"),
    "rank C D": (ui.ARM._replace(C=I4[[0, 2]]), r"Assumption 1: rank\(C D\) = 0, want q = 1"),
    "n > p": (ui.ARM._replace(C=I4), "Assumption 2: want n > p >= m, got n = 4, p = rank C = 4, m = 1"),
    "p >= m": (ui.ARM._replace(B=I4[:, :3]), "Assumption 2: want n > p >= m, got n = 4, p = rank C = 2, m = 3"),
    "p > q": (ui.ARM._replace(D=I4[:, 1:3]), "Assumption 2: want p > q, got p = rank C = 2, q = rank D = 2"),
    "observable": (
        ui.System(np.diag([-1.0, -2.0, -3.0, -4.0]), ui.B_ARM, ui.C_ARM, ui.D_ARM),
        "Assumption 2: observability matrix of rank 2, want n = 4",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_transform_refuses_by_name_and_rank(name):
    system, message = REFUSED[name]
    with pytest.raises(ValueError, match=message):
        ui.transform(system)


def test_link_sensors_leave_slow_modes():
    split = ui.transform(ui.ARM._replace(C=np.eye(4)[:2]))
    modes = ui.unmovable_modes(split.A11, split.A21[:1])
    assert np.allclose(np.sort_complex(modes), [-0.000625 - 1.9365j, -0.000625 + 1.9365j], atol=5e-5)
    assert ui.unmovable_modes(ui.arm_split().A11, ui.arm_split().A21[:1]) == []


# ---------------------------------------------------------------- samples

CASES = [(20, 0), (400, 0), (40, 40), (1, 0)]  # (te, d) in ticks
SAMPLED = {  # rms of the x2 error; te, d, measurement: SMO, PIO
    (20, 0, "hold"): (".0168", ".0170"),
    (20, 0, "predict"): (".0025", ".0012"),
    (400, 0, "hold"): (".331", ".318"),
    (400, 0, "predict"): (".026", ".026"),
}


@cache
def arm():
    """Return x [N+1, 1, 4] under d1 at ticks of 5e-4 s."""
    return ui.plant(ui.d1(ui.stage_times(TICKS, TICK))[:, None], ui.X0[None], TICK)


@cache
def sampled(name, measurement):
    """Return xd, fhat of all CASES, in one batch."""
    late = [ui.deliver(ui.samples_of(arm(), te, d), TICKS, te, d) for te, d in CASES]
    return ui.sampled(OBSERVERS[name], np.concatenate(late, axis=1), TICK, measurement)


def rms(e):
    """Return the root mean square over the tail."""
    return np.sqrt(np.mean(e[12_000:] ** 2, axis=0))


def assert_about(value, text):
    """Check a value against a rounded one: within 1 %, or it rounds to it."""
    assert abs(value - float(text)) <= max(0.01 * float(text), 0.5 * unit(text)), (value, text)


@pytest.mark.nightly
@pytest.mark.parametrize("name", OBSERVERS)
@pytest.mark.parametrize("case", SAMPLED, ids=str)
def test_sampled_without_delay(case, name):
    te, d, measurement = case
    xd, _ = sampled(name, measurement)
    error = arm()[:, 0] - xd[:, CASES.index((te, d))]
    assert_about(rms(error)[1], SAMPLED[case][name == "pio"])


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "without", "carried"), [("smo", ".0078", ".0044"), ("pio", ".0066", ".0026")])
def test_delayed_estimate_predicted_to_now(name, without, carried):
    xd, fhat = (part[:, [2]] for part in sampled(name, "predict"))
    assert_about(rms(arm() - ui.to_now(xd, fhat, 0.02))[0, 1], without)
    assert_about(rms(arm() - ui.to_now(xd, fhat, 0.02, reconstruct=True))[0, 1], carried)


def test_prediction_to_now_solves_the_plant_with_a_constant_input():
    x, f, delay = ui.X0, 0.7, 0.3
    solved = solve_ivp(lambda t, x: ui.ARM.A @ x + ui.ARM.D[:, 0] * f, (0, delay), x, rtol=1e-11, atol=1e-12)
    ahead = ui.to_now(x[None, None], np.full((1, 1), f), delay, reconstruct=True)
    assert np.allclose(ahead[0, 0], solved.y[:, -1], rtol=0, atol=1e-9)


@pytest.mark.nightly
@pytest.mark.parametrize("name", OBSERVERS)
def test_a_sample_every_tick_is_near_the_continuous_measurement(name):
    xd, _ = sampled(name, "predict")
    continuous = long_run(name)[1][::5, 0, :4]
    assert np.allclose(arm()[:, 0] - xd[:, 3], continuous, rtol=0, atol=2e-3)


@pytest.mark.nightly
def test_nothing_arrives_before_the_delay():
    y = ui.samples_of(arm()[:101], 10, 25)
    arrivals = ui.deliver(y, 100, 10, 25)
    assert len(y) == 8  # taken at 0, 10, .. 70, at hand at 25, 35, .. 95
    assert np.flatnonzero(~np.isnan(arrivals[:, 0, 0])).tolist() == list(range(25, 100, 10))
    assert np.array_equal(arrivals[45, 0], ui.C_ARM @ arm()[20, 0])
    for measurement in ("hold", "predict"):
        xd, fhat = ui.sampled(ui.PIO, arrivals, TICK, measurement)
        assert not xd[:26].any()  # the value at tick 25 has a new e_y, not yet a new xd
        assert not fhat[:25].any()
        assert xd[26].any()
        assert fhat[25].any()


@pytest.mark.nightly
def test_an_unknown_measurement_option_is_refused():
    with pytest.raises(ValueError, match="want 'hold' or 'predict'"):
        ui.sampled(ui.PIO, np.zeros((2, 1, 2)), TICK, "innovation")


# ---------------------------------------------------------------- kf


@pytest.mark.nightly
def test_kf_with_noise():
    noise = 1e-3 * np.random.default_rng(3).standard_normal((501, 64, 2))
    y = ui.samples_of(np.repeat(arm(), 64, axis=1), 40, 40, noise)
    xhat, _ = ui.kf(y, TICKS, 40, 40, TICK, 1e-6)
    assert rms(arm() - xhat)[:, 1].mean() == pytest.approx(0.0025, rel=0.06)  # worked out beforehand: about .0025


@pytest.mark.nightly
def test_kf_is_the_conditional_mean():
    te, d, h, R, q, count = 30, 45, 1e-2, 0.04, 1.7, 5
    A = np.block([[ui.ARM.A, ui.ARM.D], [np.zeros((1, 5))]])
    C = np.hstack([ui.C_ARM, np.zeros((2, 1))])
    middles = (np.arange(3000) + 0.5) * te * h / 3000
    Q = sum(q * np.outer(g, g) for g in (expm(A * s)[:, 4] for s in middles)) * te * h / 3000
    Phi = expm(A * te * h)
    # x(t_i) = sum_j Phi^(i-j) w_j with w_0 ~ N(0, I), w_j ~ N(0, Q): condition the last on all samples at once
    G = np.block(
        [
            [np.linalg.matrix_power(Phi, i - j) if i >= j else np.zeros((5, 5)) for j in range(count)]
            for i in range(count)
        ]
    )
    X = G @ block_diag(np.eye(5), *[Q] * (count - 1)) @ G.T
    CC = block_diag(*[C] * count)
    y = np.random.default_rng(4).standard_normal((count, 1, 2))
    last = X[-5:] @ CC.T @ np.linalg.solve(CC @ X @ CC.T + R * np.eye(2 * count), y.ravel())
    steps = (count - 1) * te + d + 7
    xhat, fhat = ui.kf(y, steps, te, d, h, R, q)
    expected = expm(A * (d + 7) * h) @ last
    assert np.allclose([*xhat[-1, 0], fhat[-1, 0]], expected, rtol=1e-5, atol=1e-6)
    assert not xhat[:d].any()


# ---------------------------------------------------------------- minutes


@pytest.mark.nightly
def test_bands_of_64_nearby_runs_against_print():
    """Chatter and the d2 entries are within reach of print, the d entries under the sine are not."""
    parts = [ui.table(simulate("pio", seed, 16)[1][:, 2:]) for seed in range(1, 5)]
    bands = {}
    for which, values in zip(["max", "mean"], zip(*parts, strict=True), strict=True):
        for d, name in enumerate(["d1", "d2"]):
            band = np.concatenate(values)[d::2]
            assert len(band) == 64
            bands[name, "pio", which] = band.min(axis=0), band.max(axis=0)
            print(name, which, *bands[name, "pio", which], sep="\n")
    for key, (low, high) in bands.items():
        printed = np.array([float(text) for text in PRINTED[key].split()])
        columns = [0, 1, 2, 3] if key[0] == "d1" else [0, 1, 2, 3, 4]
        assert (0.75 * low < printed)[columns].all()
        assert (printed < 1.25 * high)[columns].all()
        assert (high[[0, 3]] < 1.006 * low[[0, 3]]).all()
        assert high[2] > 1.001 * low[2]
    for which in ("max", "mean"):
        key = ("d1", "pio", which)
        assert bands[key][1][4] < float(PRINTED[key].split()[4])
