"""A nonlinear plant of a user's own, a pendulum on a cart: against matrices by hand, SciPy and the same plant linearised."""

import jax.numpy as jnp
import numpy as np
import pytest
from pendulum import Numbers, field, matrices, output, pendulum, scipys

import pcbench
from pcbench import planning
from pcbench.dataset.single_table import trace_table
from pcbench.errors import UserError
from pcbench.plants import PLANTS, entry_of, output_units
from pcbench.scenarios import SCENARIOS
from pcbench.study import parse
from pcbench.study.grid import cell_of
from pcbench.study.plugins import user_plants
from pcbench.study.plugins.user_code import Code, UserPlugin

TABLE = {
    "plant": "pendulum",
    "x0": [0.02, 0.01, 0.0, 0.0],
    "prior_std": [0.02, 0.01, 0.01, 0.01],
    "sampling_period": 0.03,
    "delay": 0.06,
    "noise_std": [1e-3, 2e-3],
    "duration": 0.9,
    "input": "square",
}
SMALL = {
    "x0": [2e-6, 1e-6, 0.0, 0.0],
    "prior_std": [2e-6, 1e-6, 1e-6, 1e-6],
    "noise_std": [1e-7, 2e-7],
    "input": "zero",
}


@pytest.fixture
def own(monkeypatch):
    """Put a plant under a name, and return how a study of it is written."""

    def put(table=None, entry=None, **study):
        monkeypatch.setitem(PLANTS, "pendulum", entry or pendulum())
        return {"name": "mine", "seeds": 4, "scenario": TABLE | (table or {})} | study

    return put


@pytest.mark.ci
def test_its_linearisation_is_the_one_by_hand():
    """The Jacobians by jax to 1e-12, also for other numbers."""
    entry = pendulum()
    for p in (Numbers(), Numbers(M=2.0, m=0.5, l=0.3, b=0.1)):
        model = entry.nominal(entry.numbers._replace(**p._asdict()))
        for got, want in zip((model.A, model.B, model.C), matrices(p), strict=True):
            np.testing.assert_allclose(got, want, rtol=0, atol=1e-12)
        assert (model.D, model.E, model.discrete) == (None, None, False)


def test_its_outputs_have_the_units_that_it_names(own):
    """Without names, an output has the unit of the state that it shows; a dataset keeps them without the code."""
    entry = pendulum(output=lambda p, now, x: jnp.stack([jnp.hypot(x[0], p.l), x[1]]))
    scenario = parse.scenarios_of(parse.parse(own(entry=entry), "mine"))["mine"]
    assert output_units(scenario) == ["", "rad"]
    entry = pendulum(output=lambda p, now, x: x[:2], outputs=["range [m]", "bearing [deg]"])
    read = parse.parse(own(entry=entry), "mine")
    assert output_units(parse.scenarios_of(read)["mine"]) == ["m", "deg"]
    kept = user_plants.absent("mine.py:pendulum", Code("mine.py", "pendulum", (), ""), user_plants.facts(entry))
    assert kept.entry.outputs == entry.outputs == (("range", "m"), ("bearing", "deg"))
    frame = pcbench.simulate(read, ["model-only"])
    table = trace_table(frame, entry.signals)
    assert [table.field(y).metadata[b"unit"] for y in ("y1", "y2")] == [b"m", b"deg"]


@pytest.mark.ci
def test_its_run_is_scipys(own):
    """One Runge-Kutta step a tick of 1 ms against an adaptive integrator: 1e-8 over 0.9 s of falling."""
    frame = pcbench.simulate(own({"x0": [0.1, 0.4, -0.2, 0.3]}), ["model-only"])
    got = frame[["position", "angle", "speed", "rate"]].to_numpy()
    u = np.ones((len(got), 1))
    np.testing.assert_allclose(got, scipys([0.1, 0.4, -0.2, 0.3], u, 1e-3, len(got) - 1), rtol=0, atol=1e-8)
    assert np.abs(got[-1, 1]) > 1.0, "far from upright: the equations count"


@pytest.mark.nightly
def test_observers_run_on_it_and_those_that_cannot_say_why(own):
    observers = ["ekf", "kf", "pccebo", "model-only"]
    stats = pcbench.run(own(observers=observers, seeds=16)).stats
    rms = stats.query("metric == 'pooled_rmse' and signal == 'angle'").set_index("observer")["mean"]
    assert set(rms.index) == set(observers)
    assert max(rms["ekf"], rms["kf"]) < 0.5 * rms["model-only"]
    assert own()["scenario"].get("observers") is None
    assert list(parse.scenarios_of(parse.parse(own(), "mine"))["mine"].observers) == ["ekf", "kf", "model-only"]
    with pytest.raises(UserError, match="got a plant that is not a chain of positions"):
        pcbench.run(own(observers=["high-gain"]))


@pytest.mark.parametrize("observer", [pytest.param("ekf", marks=pytest.mark.nightly), "model-only"])
def test_perfect_start_holds(own, observer):
    """True model, true start, no noise: `ekf` has no error far from upright, the linear ones near it."""
    x0 = [0.1, 0.5, -0.2, 0.3] if observer == "ekf" else [1e-7, 2e-7, 0.0, 0.0]
    table = {"x0": x0, "xhat0": x0, "noise_std": 0.0, "input": "sine" if observer == "ekf" else "zero"}
    frame = pcbench.simulate(own(table), [observer])
    off = max(np.abs(frame[f"{observer}.{s}"] - frame[s]).max() for s in ("position", "angle", "speed", "rate"))
    assert off < (1e-12 if observer == "ekf" else 1e-15)


@pytest.mark.ci
def test_for_small_angles_it_is_the_linear_plant(own):
    """Of 1e-6 rad the sine is off by 1e-18: the same numbers as `[lti]` with the matrices by hand, to 1e-9 of the signals."""
    A, B, C = (matrix.tolist() for matrix in matrices())
    kept = {
        key: (TABLE | SMALL)[key]
        for key in ("sampling_period", "delay", "noise_std", "duration", "input", "x0", "prior_std")
    }
    names = ["position [m]", "angle [rad]", "speed [m/s]", "rate [rad/s]"]
    linear = {"name": "linear", "lti": {"A": A, "B": B, "C": C, "states": names} | kept}
    ours = pcbench.simulate(own(SMALL), ["kf", "ekf"], seed=3)
    theirs = pcbench.simulate(linear, ["kf", "ekf"], seed=3)
    columns = [
        c for c in ours.columns if c in theirs.columns and c.split(".")[-1] in ("position", "angle", "speed", "rate")
    ]
    assert {"kf.angle", "ekf.angle", "rate"} <= set(columns)
    for column in columns:
        loose = 1e-3 if column.startswith("ekf") else 1e-9  # F = I + h J is the map of a tick to h^2
        size = np.abs(theirs[column]).max()
        np.testing.assert_allclose(ours[column], theirs[column], rtol=0, atol=loose * size, err_msg=column)


@pytest.mark.ci
def test_signals_are_deviations_from_the_operating_point(own):
    """A pendulum that hangs: 0 is straight down, where functions see pi; and a plant that is held up by its input."""
    down = pendulum(operating_point=([0.3, np.pi, 0.0, 0.0], [0.0]))
    A = down.nominal(down.numbers).A
    assert A[3, 1] == pytest.approx(-1.2 * 9.81 / 0.6, rel=1e-12)
    frame = pcbench.simulate(own({"input": "zero", "x0": [0.0, 0.01, 0.0, 0.0]}, down), ["kf"])
    assert np.abs(frame["angle"]).max() < 0.011
    hover = pendulum(
        field=lambda p, now, x: [x[1], now.u[0] / p.M - p.g, 0.0 * x[2], 0.0 * x[3]],
        operating_point=([5.0, 0, 0, 0], [9.81]),
    )
    assert not hover.residual(hover.numbers).any()
    assert hover.residual(hover.numbers._replace(M=2.0))[1] == pytest.approx(-9.81 / 2)
    np.testing.assert_array_equal(hover.nominal(hover.numbers).B[:, 0], [0.0, 1.0, 0.0, 0.0])


@pytest.mark.nightly
def test_away_from_an_equilibrium_linear_observers_refuse_and_ekf_runs(own):
    slope = pendulum(operating_point=([0.0, 0.5, 0.0, 0.0], [0.0]))
    with pytest.raises(UserError, match=r"kf in mine got an operating point that is no equilibrium \(rate changes by"):
        pcbench.run(own({"observers": ["kf"]}, slope))
    stats = pcbench.run(own({"observers": ["ekf"], "noise_std": 1e-3}, slope)).stats
    assert (stats.query("metric == 'divergence_rate'")["mean"] == 0).all()
    with pytest.raises(UserError, match="got a parameter_drift of 1 in mine, which has no parameter drift"):
        parse.parse(own({"parameter_drift": 1.0}), "mine.toml")


@pytest.mark.nightly
def test_unknown_parameters_are_found_beside_the_state(own):
    """Friction, declared and not programmed: `ekf` finds it, and linear observers do without it."""
    entry = pendulum(unknown_parameters={"b": ("N s/m", 0.0, 5.0)})
    assert (entry.unknowns, entry.ranges) == ((("b", "N s/m"),), ((0.0, 5.0),))
    table = {
        "duration": 3.0,
        "x0": [0.0, 3.0, 0.0, 0.0],
        "xhat0": [0.0, 3.0, 0.0, 0.0],
        "noise_std": 1e-4,
        "input": "sine",
    }
    beside = {
        "unknown0": [1.0],
        "unknown_std": [0.5],
        "observers": ["ekf", "model-only"],
        "options": {"ekf": {"walk": 1e-4}},
    }
    frame = pcbench.simulate(own(table | beside, entry), ["ekf"])
    assert frame["b"].to_numpy() == pytest.approx(0.4)
    assert frame["ekf.b"].iloc[0] == 1.0
    assert frame["ekf.b"].iloc[-1] == pytest.approx(0.4, abs=0.02)


@pytest.mark.nightly
def test_unknown_inputs_are_a_signal_that_observers_may_find(own):
    entry = pendulum(unknown_inputs={"push": "N"})
    np.testing.assert_allclose(entry.nominal(entry.numbers).E, matrices()[1], atol=1e-12)
    assert "push" not in entry.numbers._fields, "it is no axis"
    table = {
        "unknown_input": "step",
        "input": "zero",
        "duration": 0.3,
        "unknown_std": [1.0],
        "x0": [0.0, 0.01, 0.0, 0.0],
        "noise_std": 1e-5,
    }
    frame = pcbench.simulate(own(table, entry), ["ekf", "kf"])
    assert set(frame["push"]) == {1.0}
    for observer in ("ekf", "kf"):
        assert frame[f"{observer}.push"].iloc[-1] == pytest.approx(1.0, abs=0.03)
    both = pendulum(unknown_inputs={"push": "N"}, unknown_parameters={"b": ("N s/m", 0.0, 5.0)})
    assert [name for name, _ in both.unknowns] == ["push", "b"]
    stats = pcbench.run(own(table | {"unknown_std": [1.0, 0.2]}, both, observers=["ekf", "kf"])).stats
    states = {"position", "angle", "speed", "rate"}
    assert set(stats[stats.observer == "ekf"].signal) == states | {"push", "b"}
    assert set(stats[stats.observer == "kf"].signal) == states, "it looks for inputs only, and shows all or none"


@pytest.mark.nightly
def test_a_plant_given_by_its_step_moves_by_it(own):
    """x one tick later is the user's; the linear model is discrete, and `ekf` takes the step's slope."""
    euler = {"field": None, "step": lambda p, now, x: x + now.dt * field(p, now, x), "tick": 0.01}
    entry = pendulum(**euler)
    model = entry.nominal(entry.numbers)
    assert model.discrete
    np.testing.assert_allclose(model.A, np.eye(4) + 0.01 * matrices()[0], atol=1e-12)
    x0 = [0.1, 0.5, -0.2, 0.3]
    table = {"dt": 0.01, "x0": x0, "xhat0": x0, "noise_std": 0.0, "prior_std": [0.1] * 4}
    frame = pcbench.simulate(own(table, entry), ["ekf"])
    assert np.abs(frame["ekf.angle"] - frame["angle"]).max() < 1e-12
    assert frame["angle"].iloc[1] == pytest.approx(0.5 + 0.01 * 0.3, abs=1e-15)
    noisy = pcbench.simulate(own(table | {"xhat0": [0.0, 0.4, 0.0, 0.0], "noise_std": 1e-4}, entry), ["ekf"])
    assert abs(noisy["ekf.rate"].iloc[-1] - noisy["rate"].iloc[-1]) < 0.02
    with pytest.raises(UserError, match=r"got a tick of 0\.001 s where step moves by 0.01 s"):
        pcbench.simulate(own({}, entry), ["ekf"])


@pytest.mark.nightly
def test_a_sensor_that_is_not_linear_is_measured_by_its_slope(own):
    """The camera's image of the bob, position + l sin(angle): at its prediction `ekf` takes the derivative."""
    import jax.numpy as jnp

    bob = pendulum(output=lambda p, now, x: [x[0] + p.l * jnp.sin(x[1]), jnp.sin(x[1])])
    np.testing.assert_allclose(bob.nominal(bob.numbers).C, [[1, 0.6, 0, 0], [0, 1, 0, 0]], atol=1e-12)
    x0 = [0.1, 2.0, -0.2, 0.3]
    table = {"x0": x0, "xhat0": [0.2, 2.2, 0.0, 0.0], "noise_std": 1e-4, "prior_std": [0.1, 0.2, 0.2, 0.3]}
    frame = pcbench.simulate(own(table, bob), ["ekf"])
    assert np.abs(frame["ekf.angle"] - frame["angle"]).iloc[-1] < 0.005
    perfect = pcbench.simulate(own(table | {"xhat0": x0, "noise_std": 0.0}, bob), ["ekf"])
    assert np.abs(perfect["ekf.angle"] - perfect["angle"]).max() < 1e-12


def test_its_numbers_are_axes_and_observers_keep_the_nominal_ones(own):
    study = own({"observers": ["model-only"]}, axes={"plant.m": [0.2, 0.4]})
    stats = pcbench.run(study).stats.query("metric == 'rmse' and signal == 'angle'")
    assert stats["mean"].nunique() == 2
    with pytest.raises(UserError, match=r"axes.plant.m\[0\]: got 0.0, expected a number greater than 0"):
        parse.parse(own(axes={"plant.m": [0.0]}), "mine.toml")
    with pytest.raises(UserError, match=r"'plant\.mass' is no axis of mine"):
        parse.parse(own(axes={"plant.mass": [1.0]}), "mine.toml")


@pytest.mark.nightly
def test_an_lqr_holds_it_upright_by_what_a_delayed_camera_sees(own):
    """The law is designed for the Jacobians; the plant it holds is the nonlinear one."""
    law = {"use": "lqr", "Q1": [10.0, 10.0, 1.0, 1.0], "Q2": [0.1], "actuator_delay": 0.01}
    table = {"x0": [0.1, 0.1, 0.0, 0.0], "prior_std": [0.1] * 4, "sampling_period": 0.033, "duration": 4.0}
    stats = pcbench.run(own(table, observers=["ekf", "kf"], controller=law)).stats
    assert (stats.query("metric == 'divergence_rate'")["mean"] == 0).all()
    angle = stats.query("metric == 'steady_rmse' and signal == 'angle'").set_index("observer")["mean"]
    assert max(angle) < 0.003


def test_a_scenario_carries_it_without_a_name():
    entry, four, two = pendulum(), (0.1,) * 4, (0.03,) * 2
    mine = SCENARIOS["cart/white"].with_fields(
        user_code={"plant": UserPlugin(entry, Code("mine.py", "pendulum", (), "abc"))},
        plant="pendulum",
        x0=four,
        xhat0=four,
        prior_std=four,
        settle_band=four,
        sampling_period=two,
        delay=two,
        noise_std=two,
    )
    assert entry_of(mine) is entry
    assert planning.draft(cell_of(mine), {}).layout.plant is entry.plant


def nan(p, now, x):
    return output(p, now, x) * np.nan


def rooted(p, now, x):
    import jax.numpy as jnp

    return jnp.sqrt(x[:2])


@pytest.mark.ci
@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        (
            {"field": lambda p, now, x: field(p, now, x)[:3]},
            r"field: got an array of shape \(3,\), expected \(4,\), a number for",
        ),
        ({"output": lambda p, now, x: x[0]}, r"output: got an array of shape \(\), expected \(q,\)"),
        (
            {"output": nan},
            r"output: got \[nan, nan\] at the operating point x = \[0.0, .*expected finite numbers; use another",
        ),
        ({"output": rooted}, "the slope of output: got .*inf.* at the operating point"),
        (
            {"field": lambda p, now, x: p.mass * x},
            "field cannot be computed at the operating point: AttributeError: .*mass.*line",
        ),
        (
            {"output": lambda p, now, x: np.asarray(x)[:2]},
            "the slope of field or output cannot be taken: .*write it in jax.numpy",
        ),
        ({"states": ["x"]}, "states: got 1 names, expected 4"),
        ({"outputs": ["place [m]"]}, "outputs: got 1 names, expected 2, one for each number that output returns"),
        ({"states": ["2x", "a", "b", "c"]}, "states: got '2x', expected a name with a unit"),
        ({"field": None}, "got neither field nor step, expected field, or step with its tick"),
        ({"step": field}, "got field and step, expected field, or step"),
        ({"field": None, "step": field}, "got step, expected field, or step with its tick"),
        ({"operating_point": [0.0]}, r"operating_point: got \[0.0\], expected a pair"),
        (
            {"operating_point": ([0.0] * 4, [np.inf])},
            "operating_point: got .*expected at least one state and one input, all finite",
        ),
        ({"numbers": {"M": 1.0}}, "numbers: got {'M': 1.0}, expected a NamedTuple"),
        ({"numbers": Numbers(M="heavy")}, "numbers.M: got 'heavy', expected a number"),
        ({"unknown_parameters": {"B": "N"}}, "unknown_parameters: 'B' is no number of the plant; did you mean 'b'"),
        ({"unknown_parameters": {"b": ("N", 2.0, 1.0)}}, "b: got a range from 2 to 1, expected"),
        (
            {"unknown_parameters": {"b": "N"}, "unknown_inputs": {"b": "N"}},
            "got 'b' as an unknown input and an unknown par",
        ),
        ({"positive": ["L"]}, "positive: 'L' is no number"),
    ],
)
def test_what_cannot_be_a_plant_is_one_sentence(changes, sentence):
    with pytest.raises(UserError, match="^pcbench.make_plant: " + sentence):
        pendulum(**changes)
