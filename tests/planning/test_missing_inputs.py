"""`run` names an own observer that asks for an input that its closed loop no longer stores."""

from pathlib import Path

import pytest

import pcbench

OWN = (Path(__file__).parents[1] / "support" / "own_observer.py").read_text()
ASKING = """

def asking(age, each):
    def flow(gains, memory, now):
        return nudge.flow(gains, memory, now) + 0.0 * jnp.sum(each(now, age))

    return nudge._replace(flow=flow)


def one(now, age):
    return now.past_u(jnp.asarray(age))


def several(now, age):
    return jax.vmap(now.past_u)(jnp.array([0, age, 1]))


def by_scan(now, age):
    return jax.lax.scan(lambda s, a: (s + now.past_u(a).sum(), 0), 0.0, jnp.array([0, age]))[0]


near, far = asking(20, one), asking(900, one)
far_by_vmap, far_by_scan = asking(901, several), asking(902, by_scan)
"""
SHORT = {"base": "cart/white", "name": "short", "duration": 1.5, "steady_start": 0.5}


@pytest.fixture
def sentences(tmp_path):
    (tmp_path / "mine.py").write_text("import jax\n" + OWN + ASKING)

    def of(names, **loop):
        found = []
        study = {
            "name": "x",
            "observers": [f"{tmp_path}/mine.py:{name}" for name in names],
            "seeds": 2,
            "scenario": SHORT,
        } | loop
        pcbench.run(study, on_warning=found.append)
        return found

    return of


@pytest.mark.ci
def test_run_names_observer_and_age_if_a_loop_no_longer_stores_an_input(sentences):
    loop = {"controller": {"use": "lqr", "Q1": 1.0, "Q2": 1.0}}
    found = sentences(["far", "near", "far_by_vmap", "far_by_scan"], **loop)
    assert [sentence.split(" ticks ago")[0] for sentence in found] == [
        f"{name}: asks past_u for the input of {age}"
        for name, age in (("far", 900), ("far_by_vmap", 901), ("far_by_scan", 902))
    ]


@pytest.mark.ci
def test_run_names_nothing_in_an_model_only(sentences):
    assert sentences(["far"]) == []
