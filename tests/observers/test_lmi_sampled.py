"""The observer of held innovations: runs against the reference, on two clocks and a nonlinear plant, and its certificate."""

import numpy as np
import pytest
from harness import CART, ODD, Case, trace
from reference import held, linear

import pcbench
from pcbench import planning
from pcbench.errors import DesignError, UserError
from pcbench.observers import lmi_sampled
from pcbench.plants import flexible_joint
from pcbench.study import parse
from pcbench.synthesis.certificate import is_certified

START = {2: [5.0, 10.0], 3: [1.0, -2.0, 0.5]}
SLOPES = {"gravity": [-3.33, 3.33]}  # of -3.33 sin x3
TWO_CLOCKS = {
    "name": "held",
    "observers": ["lmi-sampled"],
    "lti": {
        "A": [[0.0, 1.0, 0.0], [-2.0, -0.6, 0.4], [0.0, -0.3, -0.1]],
        "B": [[0.0], [1.5], [0.2]],
        "C": [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        "D": [[0.0], [0.3]],
        "sampling_period": [0.2, 0.14],
        "sampling_phase": [0.0, 0.03],
        "delay": [0.0, 0.0],
        "noise_std": [0.3, 0.4],
        "x0": [1.0, -0.5, 2.0],
        "input": "sine",
        "tick": 0.01,
        "duration": 4.0,
    },
}


def design(context, **options):
    return lmi_sampled.design(context, lmi_sampled.Options(**options))


def context(scenario, observer="lmi-sampled", **changes):
    _, cell = parse.one_cell({"name": "t", "scenario": {"base": scenario, **changes}}, [observer], [])
    return planning.context_of(cell)


@pytest.mark.parametrize(("te", "d"), [(1, 0), (17, 0), (30, 45), (40, 3)])
@pytest.mark.parametrize("model", [CART, ODD], ids=["cart", "odd"])
def test_perfect_start_stays_perfect(model, te, d):
    start = START[len(model.A)]
    case = Case(model, te, d, ticks=300, h=0.01 if model is ODD else 1e-3, x0=start, xhat0=start)
    got = trace(case, {"lmi-sampled": {}})
    assert np.abs(got.x - got.estimates["lmi-sampled"]).max() < 1e-12 * np.abs(got.x).max()


def test_run_on_two_clocks_is_the_references():
    """The measurements are those of the run itself; y contains D u."""
    got = pcbench.simulate(TWO_CLOCKS, ["lmi-sampled"], seed=4)
    A, B, C, D = (np.array(TWO_CLOCKS["lti"][key]) for key in "ABCD")
    u, samples = got[["u1"]].to_numpy(), []
    for channel, (first, period) in enumerate([(0, 20), (3, 14)]):
        for index, tick in enumerate(range(first, len(u), period)):
            value = got[f"y{channel + 1}"][tick] - D[channel] @ u[tick]
            samples.append(linear.Sample(tick, tick, channel, index, value))
    L = pcbench.design(TWO_CLOCKS, "lmi-sampled").gains.L
    want = held.linear_run(linear.Model(A, B, C, 0.01), u, samples, np.zeros(3), L)
    np.testing.assert_allclose(got[[f"lmi-sampled.x{i}" for i in (1, 2, 3)]], want, rtol=0, atol=1e-10)


def test_run_of_the_flexible_joint_is_the_references():
    """One Runge-Kutta step a tick of the field and the held innovation."""

    def motion(x, u):
        motor = -48.6 * x[0] - 1.25 * x[1] + 48.6 * x[2] + 21.6 * u
        return np.array([x[1], motor, x[3], 19.5 * x[0] - 19.5 * x[2] - 3.33 * np.sin(x[2])])

    h, ticks = 0.005, 300
    scenario = {"base": "flexible-joint/sampled", "duration": ticks * h, "steady_start": 1.0}
    got = pcbench.simulate({"name": "t", "scenario": scenario}, ["lmi-sampled"], seed=6)
    L = design(context("flexible-joint/sampled")).gains.L
    y = got["y1"].to_numpy()
    samples = [linear.Sample(k, k, 0, i, y[k]) for i, k in enumerate(range(0, ticks + 1, 20))]
    u = np.sin(4 * h * np.arange(ticks))
    want = held.run(
        lambda k, x, g: held.rk4(lambda x: motion(x, u[k]) + L @ g, x, h), np.eye(4)[:1], ticks, samples, np.zeros(4)
    )
    names = [f"lmi-sampled.{name}" for name, _ in flexible_joint.SIGNALS]
    np.testing.assert_allclose(got[names], want, rtol=0, atol=1e-10)


def test_slopes_of_the_flexible_joint_are_certified_up_to_0_29_s():
    made = design(context("flexible-joint/sampled"), max_interval=0.289, parameter_range=SLOPES)
    assert is_certified(made.certificate._asdict())
    np.testing.assert_allclose(made.gains.L.T, [[4.375, 0.179, 4.071, 3.463]], atol=0.05)
    with pytest.raises(DesignError, match="not certified"):
        design(context("flexible-joint/sampled"), max_interval=0.3, parameter_range=SLOPES)


@pytest.mark.ci
def test_error_falls_in_every_run_within_the_certificate():
    """No noise, the upright link included: the certified rate bounds the last error by the first, up to the norm of P."""
    quiet = {"noise_std": 0.0, "process_std": [0.0] * 4, "x0": [3.0, 0.0, 3.0, 0.0], "sampling_jitter": 0.02}
    study = {
        "name": "t",
        "scenario": {"base": "flexible-joint/sampled", "sampling_period": 0.15, **quiet},
        "options": {"lmi-sampled": {"parameter_range": SLOPES, "max_interval": 0.2, "decay": 0.05}},
    }
    got = pcbench.simulate(study, ["lmi-sampled"], seed=1)
    names = [name for name, _ in flexible_joint.SIGNALS]
    e = got[names].to_numpy() - got[[f"lmi-sampled.{name}" for name in names]].to_numpy()
    P = design(
        context("flexible-joint/sampled"), parameter_range=SLOPES, max_interval=0.2, decay=0.05
    ).certificate.numbers["P"]
    size = np.sqrt(np.einsum("ki,ij,kj->k", e, P, e))
    t = got["t"].to_numpy()
    # at a sample V is the size of e alone, and between samples the size is below the root of V
    assert (size <= 1.0001 * np.exp(-0.05 * t) * size[0]).all()
    assert size[-1] < 1e-3 * size[0]


@pytest.mark.parametrize(
    ("changes", "options", "certified"),
    [
        ({}, {"parameter_range": SLOPES}, True),
        ({}, {}, False),  # the plant is nonlinear
        ({"delay": [0.05]}, {"parameter_range": SLOPES}, False),
    ],
)
def test_certificate_is_given_for_what_it_covers(changes, options, certified):
    made = design(context("flexible-joint/sampled", **changes), **options)
    assert bool(is_certified(made.certificate._asdict())) == certified


def test_interval_is_that_of_the_schedule_by_default():
    # an instant may move by 0.04 s, so an interval by 0.08 s
    found = design(context("flexible-joint/sampled", sampling_period=[0.15], sampling_jitter=0.04))
    assert found.certificate.numbers["longest_intervals"] == pytest.approx([0.23])


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"parameter_range": {"gravitation": [0.0, 1.0]}}, "gravity"),
        ({"L": [[1.0, 2.0]]}, "expected a matrix of shape"),
        (
            {"parameter_range": {name: [1.0, 2.0] for name in flexible_joint.Numbers._fields[:5]}, "max_interval": 0.1},
            None,
        ),
    ],
)
def test_options_that_do_not_fit_are_refused(options, sentence):
    known = context("flexible-joint/sampled")
    if sentence is None:
        assert lmi_sampled.corner_models(known, options["parameter_range"], "test").shape == (32, 4, 4)
        return
    with pytest.raises(UserError, match=sentence):
        design(known, **options)


@pytest.mark.parametrize("scenario", ["growth-model/gordon", "intermittent/scalar"])
def test_plant_in_discrete_time_is_refused(scenario):
    with pytest.raises(UserError, match="discrete time"):
        design(context(scenario))
