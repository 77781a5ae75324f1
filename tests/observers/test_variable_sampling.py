"""Variable intervals, jitter, loss and disorder: numbers known beforehand, and every observer against the NumPy reference."""

import jax
import numpy as np
import pytest
from harness import CART, ODD, Case, context_of, inputs, noise, problem, recorder, starts
from reference import held, linear
from reference import irregular as reference

import pcbench
from pcbench import planning
from pcbench.dynamics import linear as synthesis
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.planning import run_local
from pcbench.runtime import config
from pcbench.simulation.schedule import common_times, random_times, sampling
from pcbench.simulation.schedule.sampling import LOST, Clock
from pcbench.study import parse

PAGE = {  # t: (x1, pco, pi-pco), noise off
    500: (6.0888233710, 6.0068561578, 6.0068561578),
    1000: (6.3035122430, 6.2830204397, 6.2912171610),
    2000: (5.8901399136, 5.8899798204, 5.9035638808),
    10000: (6.2752057436, 6.2752057436, 6.2752051793),
}
WILD = {  # ticks
    "sine": Clock((0,), 60, None, "sine"),
    "uniform": Clock((0,), 60, None, "uniform"),
    "sampling_jitter": Clock((0,), 50, 80, "periodic", 20, 0, 0.0),
    "loss": Clock((0,), 50, 30, "periodic", 0, 0, 0.4),
    "disorder": Clock((0,), 30, 40, "periodic", 10, 120, 0.2),
    "turns": Clock((0,), 42, 20, (30, 50, 45), delay_sequence=(0, 90, LOST, 10, 60)),
}
CHOICES = {
    "pccebo": [{}],
    "pco": [{"Kp": -61.0}],
    "pi-pco": [{"Kp": -61.0, "Ki": 12.2}],
    "lmi-sampled": [{}],
    "kf": [{}, {"bias_variance": 1.0}],
}


@pytest.fixture(scope="module")
def quiet():
    return pcbench.simulate("cart/variable", ["pco", "pi-pco"], overrides=["axes.noise_std=0"])


@pytest.mark.ci
@pytest.mark.parametrize("tick", PAGE)
def test_the_worked_positions_come_out(quiet, tick):
    got = [quiet[name][tick] for name in ("position", "pco.position", "pi-pco.position")]
    np.testing.assert_allclose(got, PAGE[tick], rtol=0, atol=6e-11)


def test_the_worked_metrics_come_out(quiet):
    for name, mae, rmse in (("pco", 0.134557440785, 0.812830903051), ("pi-pco", 0.136476736960, 0.812845680813)):
        e = (quiet["position"] - quiet[f"{name}.position"])[:-1]
        assert e.abs().mean() == pytest.approx(mae, abs=1e-12)
        assert (e**2).mean() ** 0.5 == pytest.approx(rmse, abs=1e-12)


def wild(case, clock, observer, options):
    """Layout and problem of a case on one run's draw of a clock, with the reference's times of that run."""
    channels = len(case.model.C)
    clock = clock._replace(channels=tuple(range(channels)))
    with config.float64():
        run = [clock], case.ticks
        samples = (
            random_times.draw_samples(*run, channels, 0, case.seed) if clock.random else common_times.samples_of(*run)
        )
    plan = common_times.pad_slots(
        common_times.schedule(samples, case.ticks, channels), 4 if clock.max_extra_delay else 1
    )
    known = context_of(case)._replace(
        oosm_lag=random_times.max_oosm_lag([clock], case.ticks),
        intervals=tuple(sampling.intervals(clock, case.ticks)),
    )
    design = OBSERVERS[observer].design(known, OBSERVERS[observer].options(**options))
    layout, p = problem(case, {})
    layout = layout._replace(observers=((observer, OBSERVERS[observer].observer),))
    times = [
        [(s.tick, s.arrives if s.arrives < common_times.NEVER else None) for s in samples if s.channel == j]
        for j in range(channels)
    ]
    return layout, jax.tree.map(np.asarray, p._replace(schedule=plan, gains={observer: design.gains})), design, times


def reference_pco(observer, options, model, u, samples, xhat0, design, case):
    if observer == "pccebo":
        return reference.pccebo(model, u, samples, xhat0, design.gains.L)
    if observer == "lmi-sampled":
        return held.linear_run(model, u, samples, xhat0, design.gains.L)
    if observer == "kf":
        W = case.input_intensity * case.model.B @ case.model.B.T
        return reference.kf(
            model, u, samples, xhat0, context_of(case).P0, design.gains.R, W, options.get("bias_variance")
        )
    Ki = design.gains.Ki if observer == "pi-pco" else None
    return reference.pco(model, u, samples, xhat0, design.gains.T, design.gains.Kp, Ki)


FAST = {
    ("pccebo", "loss"),
    ("kf", "turns"),
    ("lmi-sampled", "disorder"),
}  # on the cart; `test_events_per_lane` has more
EVERY = [
    pytest.param(plant, o, options, clock, marks=[] if plant == "cart" and (o, clock) in FAST else pytest.mark.nightly)
    for plant in ("cart", "odd")
    for o, choices in CHOICES.items()
    for options in choices
    for clock in WILD
]


@pytest.mark.ci
@pytest.mark.parametrize(("plant", "observer", "options", "clock"), EVERY, ids=str)
def test_observers_equal_the_reference_with_jitter_loss_and_disorder(plant, observer, options, clock):
    if plant == "cart":
        case = Case(CART, 50, 60, ticks=700, noise_std=0.3, seed=2, x0=[5.0, 10.0])
    else:
        case = Case(ODD, 50, 60, ticks=400, h=0.01, noise_std=0.2, seed=3, xhat0=[0.5, -1.0, 2.0], input_intensity=0.05)
        options = {k: v for k, v in options.items() if k not in ("Kp", "Ki")}
    layout, p, design, times = wild(case, WILD[clock], observer, options)
    got = jax.tree.map(np.asarray, recorder()(layout, p, np.asarray(0), np.asarray(case.seed)))
    u, (x0, xhat0) = inputs(case), starts(case)
    model = linear.Model(case.model.A, case.model.B, case.model.C, case.h)
    draws = noise(case._replace(te=1))
    x, samples = reference.simulate(model, u, x0, times, draws)
    size = np.abs(x).max()
    np.testing.assert_allclose(got.x, x, rtol=0, atol=1e-10 * size)
    want = reference_pco(observer, options, model, u, samples, xhat0, design, case)
    np.testing.assert_allclose(got.estimates[observer], want, rtol=0, atol=1e-10 * max(size, np.abs(want).max()))


@pytest.mark.parametrize(
    "axes",
    [
        {"sampling_pattern": ["uniform"]},
        {
            "sampling_pattern": ["periodic"],
            "delay": [0.3],
            "sampling_jitter": [0.05],
            "delay_jitter": [0.5],
            "loss": [0.3],
        },
        {"sampling_pattern": ["periodic"], "delay": [0.1], "loss": [0.3], "assumed_delay_error": [0.07]},
        {"sampling_pattern": ["periodic"], "delay": [0.1], "loss": [0.3], "assumed_delay_error": [-0.07]},
    ],
    ids=["uniform", "disorder", "assumed older", "assumed younger"],
)
@pytest.mark.nightly
def test_lanes_on_schedules_of_their_own_have_the_numbers_of_runs_alone(axes):
    """`random_schedules` against `common_schedule` through the recorded run on that seed's schedule."""
    names = ["pccebo", "pi-pco", "kf", "kf-bias"]
    with config.float64():
        chosen = parse.parse({"name": "t", "scenarios": ["cart/variable"], "observers": names, "axes": axes,
                              "options": {"kf-bias": {"bias_variance": 1.0}}}, "t")  # fmt: skip
        (planned,) = planning.plan(chosen)
        (done,) = run_local.execute(chosen, [planned], np.arange(3), 1)
        for seed in range(3):
            p = planning.alone(planned, 0, seed)
            out = recorder()(p.layout, jax.tree.map(np.asarray, p.problem), np.asarray(0), np.asarray(seed))
            for name in names:
                e = np.asarray(out.x - out.estimates[name])
                got = {metric: values[:, seed] for metric, values in done.results[name].items() if values.ndim == 2}
                np.testing.assert_allclose(got["mae"], np.abs(e[:-1]).mean(0), rtol=1e-10, atol=1e-13)
                np.testing.assert_allclose(
                    got["steady_rmse"], np.sqrt((e[3000:-1] ** 2).mean(0)), rtol=1e-10, atol=1e-13
                )
                np.testing.assert_allclose(got["max_abs_error"], np.abs(e[:-1]).max(0), rtol=1e-10)
                np.testing.assert_allclose(got["final_error"], e[-2], rtol=1e-9, atol=1e-13)


@pytest.mark.parametrize(
    ("axes", "sentence"),
    [
        ({"sampling_jitter": [0.2]}, "at most 0.049"),
        ({"sampling_jitter": [0.0005]}, "whole number of ticks"),
        ({"loss": [1.5]}, "probability from 0 to 1"),
        ({"loss": [-0.1]}, "at least 0"),
        ({"sampling_pattern": ["sinus"]}, "did you mean 'sine'"),
        ({"sampling_pattern": [[0.1, 0.0]]}, "at least one tick"),
        ({"delay": ["intervall"]}, "'interval'"),
        ({"assumed_delay_error": [-0.2]}, "write at least -0.1"),
    ],
    ids=str,
)
def test_times_that_do_not_fit_are_one_sentence(axes, sentence):
    with pytest.raises(UserError, match=sentence):
        parse.parse({"name": "t", "scenarios": ["cart/variable"], "axes": axes}, "t")


def test_an_observer_that_needs_a_constant_delay_is_refused_where_it_varies():
    with pytest.raises(UserError, match="kfbo in cart/variable got a delay of one interval that varies"):
        parse.parse({"name": "t", "scenarios": ["cart/variable"], "observers": ["kfbo"]}, "t")
    parse.parse({"name": "t", "scenarios": ["cart/white"], "observers": ["kfbo"], "axes": {"loss": [0.2]}}, "t")


@pytest.mark.parametrize("observer", ["kf", "pccebo", "pco"])
def test_a_mode_that_no_output_shows_is_named(observer):
    blind = synthesis.Model(np.diag([1.0, -1.0]), np.ones((2, 1)), np.array([[0.0, 1.0]]))
    with pytest.raises(UserError, match=r"mode 1 is un(detectable|observable)"):
        OBSERVERS[observer].design(context_of(Case(blind, 10, 10)), OBSERVERS[observer].options())
