"""The checks of a user's controller: for each there is a law that does not pass. A sound one passes all: `cli/test_new.py`."""

import itertools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import BaseModel, Field
from scipy.linalg import expm

import pcbench
from pcbench.checking import controller
from pcbench.checking.controller import CHECKS, findings
from pcbench.checking.targets import SkipCheck
from pcbench.errors import UserError
from pcbench.scenarios import SCENARIOS
from pcbench.study import controller_table
from pcbench.study.plugins import user_controllers
from pcbench.study.plugins.user_code import Code, UserPlugin

CART, COUNT = SCENARIOS["cart/white"], itertools.count()


class Options(BaseModel):
    gain: float = Field(2.0, description="of the position")
    period: float | None = None


class Params(NamedTuple):
    K: Any
    T: Any
    period_ticks: Any


def prepare(options, context):
    period_ticks = context.period_ticks(options.period)
    return Params(np.array([[options.gain, 0.1]]), np.asarray(period_ticks * context.dt), np.asarray(period_ticks))


def start(params, estimate):
    return jnp.zeros(1), jnp.zeros(())


def command(params, now, estimate, coming, kept):
    total = kept[1] + 0.5 * params.T * estimate[0]
    u = -params.K @ estimate[:2] - total
    new, decides = (u, total), now.tick % params.period_ticks == 0
    after = jax.tree.map(lambda a, b: jnp.where(decides, a, b), new, kept)
    return after[0], after


LAW = pcbench.Controller(lambda params, tick: jnp.zeros(1), lambda params, tick, estimate: jnp.zeros(1), command, start)


def own(make=prepare, check=user_controllers.accept_all, **functions):
    entry = pcbench.ControllerSpec(LAW._replace(**functions), Options, make, "yours", check)
    return UserPlugin(user_controllers.entry(entry, None, "t"), Code("", "pull", (), ""))


def trial(mine, **options):
    return controller.trial("pull", mine, CART, options)[0]


def changed(u=lambda u, now, estimate, params: u):
    def other(params, now, estimate, coming, kept):
        said, after = command(params, now, estimate, coming, kept)
        return u(said, now, estimate, params), after

    return {"command": other}


def called_back(u, now, estimate, params):
    return jax.pure_callback(lambda u: np.asarray(u), jax.ShapeDtypeStruct((1,), float), u)


def fit(options, sizes):
    if options.gain > 1:
        raise UserError(f"{sizes.where}.gain: got {options.gain}, expected 1 at most; write less.")


BROKEN = [
    ("numbers", {"make": lambda options, context: ("PI", 1.0)}, {}, "got 'PI' in the result of prepare"),
    ("shapes", {"target": lambda params, tick: 0.5}, {}, r"target returned shape \(\)"),
    ("shapes", {"command": lambda *given: given[-1][0]}, {}, "command returned no pair"),
    ("purity", changed(lambda u, *given: u * (1 + 1e-9 * next(COUNT))), {}, "two programs when command was traced twice"),
    ("float64", changed(lambda u, *given: u.astype(jnp.float32).astype(float)), {}, "got float32 in command"),
    ("many runs", changed(called_back), {}, "command in vmap"),
    ("held", changed(lambda u, now, estimate, params: u + estimate[0]), {"period": 0.05}, "a different command at tick 1"),
    ("settles", {}, {"gain": -2.0}, "pull does not stabilise the plant of cart/white: .* eigenvalue 1"),
    ("run", changed(lambda u, now, *given: u / (now.tick - 7)), {}, "not finite at tick 7 .0.007 s. of cart/white"),
]  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize(("check", "functions", "options", "sentence"), BROKEN, ids=[c for c, *_ in BROKEN])
def test_a_broken_controller_fails_the_check_it_should(check, functions, options, sentence):
    with pytest.raises(UserError, match=sentence) as said:
        CHECKS[check](trial(own(**functions), **options))
    assert str(said.value).endswith(".")


def test_there_is_a_controller_for_every_check():
    assert {check for check, *_ in BROKEN} == {*CHECKS}


def test_options_that_do_not_fit_are_the_first_finding_and_the_last():
    for given, sentence in (
        ({"gain": "much"}, "gain: got 'much'"),
        ({"gian": 1.0}, "did you mean 'gain'"),
        ({"gain": 2.0}, "options.gain: got 2.0, expected 1 at most"),
    ):
        first, *others = findings("pull", own(check=fit), CART, given)
        assert (first.check, first.verdict) == ("options", "fails")
        assert sentence in first.why
        assert {f.why for f in others} == {"not run: options has not passed"}


@pytest.mark.ci
def test_its_eigenvalue_is_that_of_the_loop_written_out():
    """Plant and integrator over one period, by hand: x+ = Phi x + Gamma u, s+ = s + T x1 / 2, u = -K x - s+."""
    t = trial(own(), period=0.05)
    model, T = t.context.model, 0.05
    whole = expm(T * np.block([[model.A, model.B], [np.zeros((1, 3))]]))
    Phi, Gamma, K = whole[:2, :2], whole[:2, 2:], np.array([[2.0 + 0.5 * T, 0.1]])
    loop = np.block([[Phi - Gamma @ K, -Gamma], [np.array([[0.5 * T, 0.0]]), np.eye(1)]])
    found = controller_table.slowest_mode(t.scenario, "t")
    assert abs(found.mode) == pytest.approx(np.abs(np.linalg.eigvals(loop)).max(), rel=1e-10)
    assert (found.delay, found.period) == (0.0, pytest.approx(0.05))


@pytest.mark.ci
def test_a_law_that_looks_at_what_is_on_its_way_is_not_linearised():
    def ahead(params, now, estimate, coming, kept):
        return command(params, now, estimate + 0.0 * coming(jnp.asarray(0)), coming, kept)

    with pytest.raises(SkipCheck, match=r"write linear\(options, context\)"):
        CHECKS["settles"](trial(own(command=ahead)))
    with pytest.raises(SkipCheck, match="it decides at every tick"):
        CHECKS["held"](trial(own()))


def test_a_scenario_whose_loop_it_closes_keeps_its_options_and_its_network():
    mine = own()
    closed = trial(mine, gain=3.0).scenario.with_fields(actuator_delay=0.02, command_loss=0.1)
    again, why = controller.trial("pull", mine, closed, {"period": 0.01})
    assert why == "gain = 3.0, period = 0.01"
    assert (again.context.late, again.scenario.loop.command_loss) == (20, 0.1)
