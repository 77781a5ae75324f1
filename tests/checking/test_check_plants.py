"""The checks of a user's plant: for each there is a plant that does not pass. A sound one passes all: `cli/test_new.py`."""

import itertools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import pcbench
from pcbench.checking import plant
from pcbench.checking.plant import CHECKS, findings, finer, integration_error, stepping
from pcbench.checking.targets import CheckNote
from pcbench.errors import UserError
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.study.plugins.user_code import Code, UserPlugin

COUNT = itertools.count()


class Numbers(NamedTuple):
    length: float = 0.5  # m
    friction: float = 0.2  # 1/s


def field(p, now, x):
    return jnp.stack([x[1], -9.81 / p.length * jnp.sin(x[0]) - p.friction * x[1] + now.u[0]])


def swing(**changes):
    given = {"field": field, "output": lambda p, now, x: jnp.sin(x[:1]), "states": ["angle [rad]", "rate [rad/s]"],
             "numbers": Numbers(), "operating_point": ([0.0, 0.0], [0.0])}  # fmt: skip
    return pcbench.make_plant(**given | changes)


def alone(entry):
    return plant.plant_scenario("swing", entry, {"user_code": {"plant": UserPlugin(entry, Code("", "swing", (), ""))}})


def check_message(check, entry):
    """What one check says, as it raises it."""
    trial, _ = plant.trial("swing", alone(entry))
    return CHECKS[check](trial)


def of(**functions):
    """A plant with functions of its own, as they are: `pcbench.make_plant` has not seen them."""
    entry = swing()
    return entry._replace(plant=entry.plant._replace(**functions))


EVERY = {"cart/white": {"axes"}, "csth/10s-noise": set(), "arm/sampled": set(), "helicopter/constant": {"rest"},
         "reactor/batch": set(), "cart/unknown-delay": {"axes"}, "ncs-two-state/held": set(),
         "ncs-reactor/round-robin": set(), "growth-model/gordon": {"rest", "seen"}, "intermittent/scalar": set(),
         "quadruple-tank/delayed": set(), "flexible-joint/sampled": set(), "falling-body/radar": set(),
         "coordinated-turn/radar": set(), "double-well/sampled": set(),
         "digester/multirate": set(), "camera-target/following": set()}  # fmt: skip

KNOWN = {
    "reactor/batch": {"tick"},  # its tick of 0.1 s is wrong by 2e-5 of a state
    "falling-body/radar": {"tick"},  # at ten times the drag, as its prior allows; the true path is exact to 0.5 ft
    "coordinated-turn/radar": {"slopes"},  # the linear model is of the start; at 0 the radar sees no angle
    # the linear model is exact in time, a step of half an hour is not: the gas moves within seconds
    "digester/multirate": {"slopes", "perfect start"},
    "growth-model/gordon": {"slopes"},  # at x = 0 the output and its slope are 0: differences have no scale
}


def test_every_built_in_plant_is_among_those_that_are_checked():
    assert {SCENARIOS[name].plant for name in EVERY} == {*PLANTS} - {"lti"}


@pytest.mark.nightly
@pytest.mark.parametrize(("name", "notes"), EVERY.items())
def test_every_built_in_plant_passes(name, notes):
    found = findings(name, SCENARIOS[name])
    assert {f.check for f in found if f.verdict == "note"} == notes
    assert {f.check for f in found if f.verdict == "fails"} == KNOWN.get(name, set())


def counted(p, now, x):
    return field(p, now, x) * (1 + 1e-9 * next(COUNT))


def called_back(p, now, x):
    return jax.pure_callback(lambda x: np.asarray(x), jax.ShapeDtypeStruct((1,), float), x[:1])


STEP = swing().plant.step


def late(p, now, x):
    return STEP(p, now._replace(u=now.past_u(1)), x)


def stiff(p, now, x):
    return jnp.stack([x[1], -2e4 * (x[1] - x[0]) + now.u[0] / p.length - p.friction * x[1]])


def unstopped(p, now, x):
    return jnp.stack([x[1], -9.81 / p.length * jax.lax.stop_gradient(x[0]) - p.friction * x[1] + now.u[0]])


BROKEN = {
    "shapes": [
        (lambda: of(output=lambda p, now, x: x[0]), r"got an array of shape \[\] from output, expected \[1\].*output 1"),
        (lambda: of(step=lambda p, now, x: x if x[0] > 0 else -x), "step cannot be traced .*Tracer.*line"),
    ],
    "purity": [
        (lambda: swing(field=counted), "two programs when step was traced twice"),
    ],
    "float64": [(lambda: of(output=lambda p, now, x: x[:1].astype(jnp.float32).astype(float)), "got float32 in output")],
    "finite": [
        (lambda: swing(output=lambda p, now, x: jnp.sqrt(0.05 + x[:1])), "got nan for output 1 in output at angle -0.0.*rate"),
    ],
    "many runs": [(lambda: of(output=called_back), "output in vmap.*callback")],
    "slopes": [
        (
            lambda: swing(field=lambda p, now, x: field(p, now, x) - 0.3 * jnp.sign(x[1]) * jnp.array([0.0, 1.0])),
            "got -0.2 from the linear model and -.* from differences for the slope of rate in field by rate, at angle 0",
        ),
        (
            lambda: swing(output=lambda p, now, x: jnp.sin(x[:1]) + jnp.abs(x[1:])),
            "got 1 from the linear model and 0 from differences for the slope of output 1 in output by rate",
        ),
        (lambda: swing(field=unstopped), "got 0 from the linear model and -19.62 .* slope of rate in field by angle"),
        (
            lambda: swing()._replace(nominal=lambda numbers: swing().nominal(numbers)._replace(B=np.array([[0.0], [2.0]]))),
            "got 2 from the linear model and 1 from differences for the slope of rate in field by u1",
        ),
    ],
    "tick": [(lambda: swing(field=stiff), "got a tick of 0.001 s that is off by .* of a state, 10000 times.*write dt = ")],
    "perfect start": [(lambda: of(step=late), "got an error of .* in (angle|rate) at tick [12], where model-only has")],
}  # fmt: skip
BROKEN = [(check, make, sentence) for check, cases in BROKEN.items() for make, sentence in cases]


@pytest.mark.ci
@pytest.mark.parametrize(("check", "make", "sentence"), BROKEN)
def test_a_broken_plant_fails_the_check_it_should(check, make, sentence):
    with pytest.raises(UserError, match=f"^{check}: .*{sentence}") as said:
        check_message(check, make())
    assert str(said.value).endswith(".")


NOTES = {
    "axes": (
        lambda: swing(numbers=(NamedTuple("More", [("length", float), ("friction", float), ("mass", float)]))(0.5, 0.2, 1.0)),
        r"plant\.mass changes nothing: ",
    ),
    "rest": (
        lambda: swing(operating_point=([0.3, 0.0], [0.0])),
        rf"no equilibrium: rate by -{9.81 / 0.5 * np.sin(0.3):.4g} a second at the operating point",
    ),
    "seen": (lambda: swing(field=lambda p, now, x: jnp.stack([0 * x[1], -p.friction * x[1] + now.u[0]]),
                           output=lambda p, now, x: x[1:]), "no output shows the mode 0, which does not decay"),
}  # fmt: skip


@pytest.mark.parametrize("check", NOTES)
def test_what_is_no_mistake_is_a_note(check):
    make, sentence = NOTES[check]
    with pytest.raises(CheckNote, match=sentence):
        check_message(check, make())


@pytest.mark.ci
def test_a_smooth_slope_between_two_is_a_kink():
    """Of |rate| at rest jax says the slope 1 or 0, differences from both sides 0: those from one side tell."""
    ramp = swing(output=lambda p, now, x: x[:1] + jnp.where(x[1:] > 0, 2 * x[1:], 0.0) - x[1:])
    ramp = ramp._replace(nominal=lambda numbers: swing().nominal(numbers)._replace(C=np.array([[1.0, 0.0]])))
    with pytest.raises(
        UserError, match=r"got 0 from the linear model and (-1|1) from differences for the slope of output 1"
    ):
        check_message("slopes", ramp)


def test_a_mode_that_decays_unseen_is_named_too():
    own = swing(output=lambda p, now, x: x[:1], field=lambda p, now, x: jnp.stack([now.u[0] - x[0], -2.5 * x[1]]))
    with pytest.raises(CheckNote, match=r"no output shows the mode -2\.5, which decays"):
        check_message("seen", own)


def test_there_is_a_plant_for_every_check():
    assert {check for check, _, _ in BROKEN} | {*NOTES} == {*CHECKS}


def test_numbers_that_are_none_are_named():
    with pytest.raises(UserError, match=r"^numbers: got 'x' in the result of prepare"):
        check_message("shapes", swing()._replace(prepare=lambda *given: "x"))
    with pytest.raises(UserError, match=r"^numbers: got A of shape \[2, 2\] in the linear model of 3 states"):
        check_message("shapes", swing()._replace(signals=(("a", "1"),) * 3, operating_point=None))


def test_the_error_of_a_tick_is_what_scipy_finds_and_the_tick_that_is_advised_will_do():
    """Of a Runge-Kutta step: what two half steps leave is a sixteenth of it, so they say the error to 10 %."""
    trial, _ = plant.trial("swing", alone(swing()))
    g, dt, worst = plant.points(trial), 0.1, 0.0
    for each in g:
        x, u = np.asarray(each.x), float(each.u[0])
        rate = lambda t, x, u=u: [x[1], -9.81 / 0.5 * np.sin(x[0]) - 0.2 * x[1] + u]  # noqa: E731
        exact = solve_ivp(rate, (0, dt), x, rtol=1e-12, atol=1e-14).y[:, -1]
        k1 = np.array(rate(0, x))
        k2 = np.array(rate(0, x + dt / 2 * k1))
        k3 = np.array(rate(0, x + dt / 2 * k2))
        k4 = np.array(rate(0, x + dt * k3))
        worst = max(worst, (abs(x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4) - exact) / 0.1).max())
    assert integration_error(trial, stepping(trial), dt) == pytest.approx(worst * 10.0 / dt, rel=0.1)
    trial, _ = plant.trial("swing", alone(swing(field=stiff)))
    with pytest.raises(UserError, match="write dt = ") as said:
        CHECKS["tick"](trial)
    advised = float(str(said.value).split("write dt = ")[1].split(",")[0])
    assert advised in finer(1e-3)
    scenario = trial.scenario._replace(dt=advised, duration=10.0)
    assert "is off by" in CHECKS["tick"](trial._replace(scenario=scenario))


@pytest.mark.nightly
def test_a_plant_given_by_its_step_has_no_tick_to_be_asked():
    own = swing(field=None, step=lambda p, now, x: x + now.dt * field(p, now, x), tick=0.01)
    found = {f.check: f for f in findings("swing", alone(own))}
    assert found["tick"].verdict == "skipped"
    assert {f.verdict for name, f in found.items() if name != "tick"} == {"passes"}, found
