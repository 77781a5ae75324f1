"""A user's observer that breaks the protocol is named, with the function and the shape, before anything runs."""

import jax.numpy as jnp
import pytest

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, ObserverSpec, model_only
from pcbench.planning import padding
from pcbench.simulation import shape_checks
from pcbench.study import Study
from pcbench.study.builtin import LITERATURE, STUDIES

BROKEN = {
    "estimate of one state": (
        {"estimate": lambda gains, memory: memory[:1]},
        r"estimate returned shape \(1,\), expected \(2,\)",
    ),
    "scalar snapshot": (
        {"snapshot": lambda gains, memory, now: now.t},
        r"snapshot returned shape \(\), expected a vector",
    ),
    "flow without return": ({"flow": lambda gains, memory, now: None}, "flow returned None, expected the memory"),
    "growing memory": (
        {"jump": lambda gains, memory, now, arrival: jnp.tile(memory, 2)},
        r"jump returned float64\[4\], expected",
    ),
    "python if": (
        {"jump": lambda gains, memory, now, arrival: memory if arrival.mask[0] else -memory},
        "jump cannot be traced .*jnp.where instead of if",
    ),
    "covariance of one state": (
        {"covariance": lambda gains, memory, now: jnp.ones((1, 1))},
        r"covariance returned shape \(1, 1\), expected \(2, 2\)",
    ),
    "one bound": (
        {"bounds": lambda gains, memory: jnp.ones(2)},
        r"bounds returned shape \(2,\), expected \(2, 2\)",
    ),
    "innovation in full": (
        {"innovation": lambda gains, memory, now, arrival: arrival.value},
        r"innovation returned shapes \[\(1,\)\], expected two numbers",
    ),
    "missing argument": ({"init": lambda gains: gains.Phi[0]}, "init cannot be traced"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_observer_is_named(name):
    changes, expected = BROKEN[name]
    OBSERVERS["mine"] = ObserverSpec(
        model_only.OBSERVER._replace(**changes), model_only.Options, model_only.design, True, "broken"
    )
    try:
        with pytest.raises(UserError, match=f"observer mine: {expected}"):
            pcbench.run("cart/nominal", observers=["mine", "kf"], seeds=1)
    finally:
        del OBSERVERS["mine"]


def test_a_field_of_another_shape_than_the_memory_is_named():
    broken = model_only.OBSERVER._replace(field=lambda gains, memory, now, y: y)
    OBSERVERS["mine"] = ObserverSpec(broken, model_only.Options, model_only.design, True, "broken")
    try:
        with pytest.raises(UserError, match=r"observer mine: field returned float64\[2\], expected .*float64\[4\]"):
            pcbench.run("arm/sine", observers=["mine"], seeds=1)
    finally:
        del OBSERVERS["mine"]


def test_a_design_that_returns_no_certificate_is_named():
    OBSERVERS["mine"] = ObserverSpec(model_only.OBSERVER, model_only.Options, lambda s, o: (1, 2), True, "broken")
    try:
        with pytest.raises(UserError, match=r"observer mine: design returned tuple, .*, expected Design"):
            pcbench.run("cart/nominal", observers=["mine"], seeds=1)
    finally:
        del OBSERVERS["mine"]


@pytest.mark.ci
def test_an_empty_note_cut_from_what_differs_between_lanes_is_legal():
    spare = model_only.OBSERVER._replace(
        snapshot=lambda gains, memory, now: memory[:0],
        jump=lambda gains, memory, now, arrival: memory + 0 * arrival.value[0],
    )
    OBSERVERS["mine"] = ObserverSpec(spare, model_only.Options, model_only.design, True, "empty note")
    try:
        runs = pcbench.run("cart/white", observers=["mine", "model-only"], seeds=2).runs
        mae = runs[runs.signal == "position"].pivot(index="seed", columns="observer", values="mae")
        assert mae["mine"].tolist() == pytest.approx(mae["model-only"].tolist(), rel=1e-12)
    finally:
        del OBSERVERS["mine"]


@pytest.mark.ci
def test_every_built_in_observer_keeps_to_the_protocol():
    """Of them a study does not ask it: that would cost up to a fifth of a second for each."""
    asked = set()
    others = {
        "scenarios": ["cart/gaussian"],
        "observers": sorted(
            o for o in OBSERVERS if o.startswith(("kf", "oosm", "particle")) or o in (*LITERATURE, "interval", "cdob")
        ),
    }
    joint = {"scenarios": ["flexible-joint/sampled"], "observers": ["high-gain-predictor"]}
    for study in (STUDIES["all"], Study(name="late", seeds=1, **others), Study(name="joint", seeds=1, **joint)):
        for plan in planning.plan(study):
            for label, observer in plan.layout.observers:
                shape_checks.check(label, observer, plan.problem, plan.layout.continuous)
                asked.add(label)
    assert asked >= set(OBSERVERS)


def test_of_built_in_code_it_is_not_asked_and_of_a_users_plant_it_is(monkeypatch):
    asked = []
    monkeypatch.setattr(shape_checks, "check", lambda label, *rest: asked.append(label))
    (plan,) = planning.plan(Study(name="one", scenarios=["cart/nominal"], observers=["kf"], seeds=1))
    assert asked == []
    users = plan.layout.plant._replace(output=lambda params, now, x: plan.layout.plant.output(params, now, x))
    list(padding.check_drafts([plan._replace(layout=plan.layout._replace(plant=users))]))
    assert asked == ["kf"]


def test_of_a_plant_that_is_made_of_a_users_equations_it_is_asked(monkeypatch):
    asked = []
    monkeypatch.setattr(shape_checks, "check", lambda label, *rest: asked.append(label))
    swing = pcbench.make_plant(
        field=lambda numbers, now, x: jnp.stack([x[1], now.u[0] - x[0]]),
        output=lambda numbers, now, x: x[:1],
        states=["angle [rad]", "rate [rad/s]"],
        operating_point=([0.0, 0.0], [0.0]),
    )
    (plan,) = planning.plan(Study(name="one", scenarios=["cart/nominal"], observers=["kf"], seeds=1))
    list(padding.check_drafts([plan._replace(layout=plan.layout._replace(plant=swing.plant))]))
    assert asked == ["kf"]
