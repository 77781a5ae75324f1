"""Estimators for nonlinear plants: each equals an independent reference, and on a linear plant Kalman's filter.

The linear plant and its schedules are those of `test_late_samples`; the nonlinear one is in `support/swinging`, where samples
are late, lost and out of sequence, neither sensor is linear, and a parameter is estimated with the state. Tolerances are
rounding: 1e-10 of the signal's size.
"""

import driven
import honest
import jax.numpy as jnp
import numpy as np
import pytest
import swinging
from harness import inputs, starts
from reference import horizon, particles
from reference import nonlinear as reference
from test_late_samples import CASE, KNOWN, TICKS, TIMES, optimum, plant, same
from test_late_samples import found as of_linear

import pcbench
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, particle
from pcbench.observers.parts.reorder_buffer import Measurement
from pcbench.protocols import Now

CUBATURE = {"form": "cubature"}
LINEAR = [("ekf-iterated", {}), ("ukf", {}), ("ukf", CUBATURE)]


@pytest.mark.parametrize(
    ("name", "options", "schedule"),
    [
        pytest.param(*each, schedule, marks=() if each == LINEAR[1] and schedule == "wild" else pytest.mark.nightly)
        for each in LINEAR
        for schedule in TIMES
    ],
    ids=str,
)
def test_on_a_linear_plant_it_is_the_optimum_whatever_is_late_lost_or_out_of_sequence(name, options, schedule):
    there = driven.traffic(TIMES[schedule], plant(schedule)[1], TICKS, 2)
    xhat, P, squares = driven.whole(name, KNOWN, options, there, inputs(CASE), starts(CASE)[1])
    same(xhat, optimum(schedule))
    same(P, of_linear("kf", schedule)[1])
    best = driven.whole("kf", KNOWN, {}, there, inputs(CASE), starts(CASE)[1])[2]
    judged = squares[:, 1] == best[:, 1]  # they do not judge measurements that arrive after newer ones, and count none
    same(squares[judged], best[judged])
    assert (squares[~judged, 1] < best[~judged, 1]).all()
    newest = np.maximum.accumulate(np.append(-1, there.when.ravel()))[:-1].reshape(there.when.shape)
    np.testing.assert_array_equal(~judged, ((there.when >= 0) & (there.when < newest)).any(1))


def agrees(got, want):
    states, squares = want
    same(got[0], np.array([z for z, _ in states]))
    same(got[1], np.array([P for _, P in states]))
    same(got[2], squares)
    assert squares[:, 1].sum() > 6


@pytest.mark.parametrize("iterations", [pytest.param(1, marks=pytest.mark.nightly), 4])
def test_iterating_equals_the_reference(iterations):
    want = reference.by_slopes(swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), iterations)
    agrees(swinging.run_observer("ekf-iterated", iterations=iterations), want)


@pytest.mark.nightly
def test_iterating_once_is_the_extended_filter():
    once, extended = swinging.run_observer("ekf-iterated", iterations=1), swinging.run_observer("ekf")
    for a, b in zip(once[:2], extended[:2], strict=True):
        same(a, b)
    judged = once[2][:, 1] == extended[2][:, 1]  # it judges no measurement that arrives after a newer one
    same(once[2][judged], extended[2][judged])
    assert 0.5 < judged.mean() < 1
    assert np.abs(swinging.run_observer("ekf-iterated", iterations=4)[0] - swinging.run_observer("ekf")[0]).max() > 1e-3


WEIGHTS = [
    {"alpha": 0.6, "beta": 1.3, "kappa": 0.4},
    pytest.param({"alpha": 1.0, "beta": 2.0}, marks=pytest.mark.nightly),
]


@pytest.mark.ci
@pytest.mark.parametrize("options", WEIGHTS, ids=str)
def test_unscented_points_equal_the_reference(options):
    want = reference.by_points(swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), **options)
    agrees(swinging.run_observer("ukf", **options), want)


@pytest.mark.nightly
def test_cubature_points_equal_the_reference():
    want = reference.by_points(
        swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), cubature=True
    )
    agrees(swinging.run_observer("ukf", **CUBATURE), want)


@pytest.mark.ci
def test_unscented_points_without_weight_on_the_centre_are_the_cubature_points():
    flat, cubature = (
        swinging.run_observer("ukf", alpha=1.0, beta=0.0, kappa=0.0),
        swinging.run_observer("ukf", **CUBATURE),
    )
    for a, b in zip(flat, cubature, strict=True):
        same(a, b)
    assert np.abs(swinging.run_observer("ukf", alpha=1.0, beta=0.0, kappa=1.0)[0] - cubature[0]).max() > 1e-6


@pytest.mark.nightly
def test_a_start_that_is_known_has_no_points():
    """P0 = 0 and no process noise: the points are one, and nothing is divided by 0."""
    known = swinging.design_context(P0=np.zeros((2, 2)), process_std=(), unknown_std=(0.0,))
    xhat, P, _ = driven.whole("ukf", known, {}, swinging.traffic(), swinging.inputs(), swinging.START)
    z = np.append(swinging.START, swinging.P_START)
    for k, u in enumerate(swinging.inputs()):
        np.testing.assert_allclose(xhat[k], z, rtol=0, atol=1e-12)
        z = reference.rk4(swinging.rate, z, u, swinging.H)
    assert not P.any()


@pytest.mark.parametrize(
    ("name", "options", "sentence"),
    [
        ("ukf", {"form": "cubature", "alpha": 0.3}, "got alpha with form = 'cubature'"),
        ("ukf", {"kappa": -3.0}, "got kappa = -3 with 3 states and unknowns, expected more than -3"),
    ],
    ids=str,
)
def test_what_cannot_be_is_refused_in_a_sentence(name, options, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        OBSERVERS[name].design(swinging.design_context(), OBSERVERS[name].options(**options))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "option"),
    [
        ("mhe", "window"),
        ("mhe", "iterations"),
        ("ekf-iterated", "iterations"),
        ("ekf-iterated", "walk"),
        ("ukf", "alpha"),
        ("ukf", "beta"),
        ("ukf", "R"),
    ],
)
@pytest.mark.parametrize("value", [-1, float("nan"), float("inf")])
def test_options_that_are_no_sizes_or_counts_are_refused(name, option, value):
    with pytest.raises(ValueError, match=option):
        OBSERVERS[name].options(**{option: value})


@pytest.mark.parametrize(
    ("schedule", "window"),
    [
        ("wild", 4),
        *(pytest.param(*each, marks=pytest.mark.nightly) for each in (("now", 1), ("wild", 1), ("late", 15))),
    ],
)
def test_looking_back_without_bounds_is_the_optimum_of_a_linear_plant_whatever_the_window(schedule, window):
    there = driven.traffic(TIMES[schedule], plant(schedule)[1], TICKS, 2)
    xhat, P, _ = driven.whole("mhe", KNOWN, {"window": window}, there, inputs(CASE), starts(CASE)[1])
    same(xhat, optimum(schedule))
    same(P, of_linear("kf", schedule)[1])


@pytest.mark.parametrize(
    ("name", "options"),
    [("ekf-iterated", {}), pytest.param("ukf", CUBATURE, marks=pytest.mark.nightly), ("mhe", {"window": 4})],
    ids=str,
)
def test_from_a_perfect_start_there_is_no_error_whatever_is_late_lost_or_out_of_sequence(name, options):
    """Of the linear plant, where no spread of points moves a mean; the reactor's is in `test_reactor`."""
    x, samples = plant("wild", noise=False)
    there = driven.traffic(TIMES["wild"], samples, TICKS, 2)
    xhat, _, squares = driven.whole(name, KNOWN, options, there, inputs(CASE), starts(CASE)[0])
    assert np.abs(xhat - x).max() < 1e-12 * np.abs(x).max()
    assert squares[:, 0].max() < 1e-20, "no innovation"


ANYWHERE = {"unknown_range": ((-np.inf, np.inf),)}


@pytest.mark.nightly
@pytest.mark.parametrize(("window", "iterations"), [(1, 1), (3, 3)])
def test_looking_back_equals_the_reference(window, iterations):
    model = swinging.model()._replace(low=np.full(3, -np.inf), high=np.full(3, np.inf))
    given = model, *swinging.prior(), swinging.samples(), swinging.inputs(), window, iterations
    agrees(
        swinging.run_observer("mhe", known=ANYWHERE, window=window, iterations=iterations), horizon.estimated(*given)
    )


@pytest.mark.ci
def test_looking_back_within_bounds_equals_the_reference():
    """An interior point against active sets: its last l s, 1e-14, over a multiplier is how near it comes to a bound."""
    low, high = np.array([-0.2, -0.9]), np.array([0.75, 0.1])
    ends = np.append(low, 1.0), np.append(high, 5.0)
    given = swinging.model(), *swinging.prior(), swinging.samples(), swinging.inputs(), 3, 2
    want, _ = horizon.estimated(*given, *ends)
    got = swinging.run_observer("mhe", window=3, iterations=2, lower=low.tolist(), upper=high.tolist())[0]
    same(got, np.array([z for z, _ in want]))
    free = swinging.run_observer("mhe", window=3, iterations=2)[0]
    assert np.abs(got - free).max() > 1e-2, "the bounds hold somewhere"
    assert (free[:, 1] > high[1] + 0.01).any(), "those above too"


@pytest.mark.parametrize(
    ("options", "changes", "sentence"),
    [
        (
            {"window": 19},
            {},
            "got a window of 19 samples, longer than the duration, in which 18 are taken; expected at most 18",
        ),
        ({"lower": 0.0}, {"xhat0": (0.7, -0.4)}, "got bounds that leave out xhat0"),
        ({"lower": [0.0]}, {}, "lower: got .*, expected a number, or 2, one for each state"),
        ({"lower": 1.0, "upper": 1.0}, {}, "expected the first below"),
    ],
    ids=str,
)
def test_windows_and_bounds_that_cannot_be_are_refused_in_a_sentence(options, changes, sentence):
    with pytest.raises(UserError, match=sentence) as caught:
        OBSERVERS["mhe"].design(swinging.design_context(**changes), OBSERVERS["mhe"].options(**options))
    assert "\n" not in str(caught.value)
    with pytest.raises(UserError, match="mhe in helicopter/constant got a closed loop"):
        pcbench.run("helicopter/constant", observers=["mhe"])


@pytest.mark.ci
@pytest.mark.parametrize(("many", "share"), [(40, 0.6), pytest.param(25, 0.0, marks=pytest.mark.nightly)])
def test_particles_equal_the_reference_on_the_same_draws(many, share):
    """Late and out-of-sequence samples move the same particles by the same draws again."""
    xhat, P, _ = swinging.run_observer("particle", particles=many, resample=share)
    model, (z, P0) = swinging.model(), swinging.prior()
    want = particles.filtered(model, z, P0, swinging.samples(), swinging.inputs(), many, share)
    same(xhat, np.array([m for m, _ in want]))
    same(P, np.array([each for _, each in want]))


def eight_particles():
    """Gains of a filter that never resamples, and the present of tick 0."""
    entry, zero, u = OBSERVERS["particle"], jnp.asarray(0), jnp.zeros(1)
    gains = entry.design(swinging.design_context(), entry.options(particles=8, resample=0.0)).gains
    return gains, Now(jnp.asarray(0.0), zero, jnp.asarray(swinging.H), u, lambda age: u)


@pytest.mark.ci
def test_a_particle_that_overflows_gets_weight_zero():
    """The other particles give mean and covariance, at this tick and after the next measurement."""
    gains, now = eight_particles()
    before = particle.first(gains, jnp.asarray(swinging.START))
    before = before._replace(x=before.x.at[3, 1].set(1.7e308))
    after = particle.tick(gains, now, before)
    others = np.delete(np.asarray(after.x), 3, 0)
    assert np.isfinite(others).all()
    np.testing.assert_allclose(particle.mean(gains, after), others.mean(0), rtol=1e-12)
    np.testing.assert_allclose(particle.spread(gains, after), np.cov(others.T, bias=True), rtol=1e-10, atol=1e-14)
    value, age = jnp.array([0.4, 0.1]), jnp.asarray(0)
    arrival = Measurement(tick=age, mask=jnp.array([True, True]), value=value, snapshot=jnp.zeros(0))
    assert np.isfinite(particle.mean(gains, particle.update(gains, now, after, arrival))).all()


@pytest.mark.ci
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_particle_whose_sensor_has_no_value_does_not_take_part_in_the_nis(value):
    """As of a level below zero whose root is measured: what is expected of a sample is the other particles'."""
    gains, now = eight_particles()
    state = particle.first(gains, jnp.asarray(swinging.START))
    sensor, gains = gains.sensor, gains._replace(R=jnp.asarray(gains.R))

    def partial(now, x, p):
        return jnp.where(x[0] == state.x[3, 0], value, sensor(now, x, p))

    sample = Measurement(
        tick=now.tick, mask=jnp.array([True, True]), value=jnp.array([0.4, 0.1]), snapshot=jnp.zeros(0)
    )
    found = particle.innovation_of_cloud(gains._replace(sensor=partial), now, state, sample)
    off = jnp.where(jnp.arange(8) == 3, -jnp.inf, -jnp.log(7.0))
    want = particle.innovation_of_cloud(gains, now, state._replace(weight=off), sample)
    np.testing.assert_allclose(found.nis_sum, want.nis_sum, rtol=1e-12)
    assert np.isfinite(found.nis_sum)


def test_of_one_particle_too_many_it_says_how_many_fit():
    with pytest.raises(UserError, match=r"got 10000000000 particles, which take .* expected at most"):
        OBSERVERS["particle"].design(swinging.design_context(), OBSERVERS["particle"].options(particles=10**10))


@pytest.mark.nightly
def test_the_difference_from_kalmans_filter_falls_as_one_over_the_particles():
    """In mean square over 64 runs, each with draws of its own: a slope of -1 +- 0.2 over three doublings twice."""
    options = {f"particle-{S}": {"particles": S} for S in (50, 200, 800)}
    study = honest.STUDY | {
        "observers": ["kf", *options],
        "seeds": 64,
        "options": options | {"scenario": {"random_initial_state": True}},
    }
    runs = pcbench.run(study).runs
    final = runs[runs.signal == "a"].pivot_table(index="seed", columns="observer", values="final_error")
    square = [np.mean((final[name] - final["kf"]) ** 2) for name in options]
    slope = np.polyfit(np.log([50, 200, 800]), np.log(square), 1)[0]
    assert slope == pytest.approx(-1.0, abs=0.2)
    assert final[next(iter(options))].nunique() == 64
