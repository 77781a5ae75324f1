"""Costs are counted from the functions themselves: products worked out by hand, loops as often as they go round."""

import io
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pandas as pd
import pytest
from jax import lax
from matplotlib.collections import PathCollection
from matplotlib.text import Text

import pcbench
from pcbench import plots
from pcbench.cli.render import results
from pcbench.cli.render.tables import Screen
from pcbench.errors import UserError
from pcbench.planning.operation_counts import count_multiplications
from pcbench.plots import observer_costs
from pcbench.report import headline
from pcbench.study import parse
from pcbench.study.schema import Study

A, X = jnp.ones((3, 4)), jnp.ones(4)


@pytest.mark.parametrize(
    ("f", "many"),
    [
        (lambda a, x: a @ x, 12),
        (lambda a, x: a @ x + 1.0, 12),
        (lambda a, x: 2.0 * x / 3.0, 8),
        (lambda a, x: x[::-1] - x, 0),
        (lambda a, x: jax.jit(lambda a, x: a @ x)(a, x), 12),
        (lambda a, x: lax.fori_loop(0, 5, lambda i, x: x * x, x), 20),
        (lambda a, x: lax.fori_loop(0, jnp.sum(x).astype(int), lambda i, x: x * x, x), 16),
        (lambda a, x: lax.scan(lambda c, row: (c + row @ row, None), 0.0, a)[0], 12),
        (lambda a, x: lax.cond(jnp.sum(x) > 9, lambda: a @ x, lambda: a[:, 0]), 0),
    ],
)
def test_products_are_those_counted_by_hand(f, many):
    assert count_multiplications(f, A, X) == many


@pytest.mark.ci
def test_costs_of_observers_of_two_states_and_one_output():
    """A tick of the model alone is Phi x + Gamma u: 4 + 2 products; `kf` moves g too, by the same push: 4 + 4 + 2."""
    found = pcbench.operation_counts(
        "cart/white", observers=["model-only", "kf", "kf-ignore-delay", "kf-delayed-horizon"]
    ).set_index("observer")
    assert found.tick[["model-only", "kf", "kf-ignore-delay"]].tolist() == [6, 10, 10]
    assert found["sample"]["model-only"] == 0
    assert found["sample"]["kf"] == found["sample"]["kf-ignore-delay"] > 50
    assert found.tick["kf-delayed-horizon"] > found["sample"]["kf"], "it updates at every tick"
    assert found.memory["model-only"] == 2 * 8


@pytest.mark.ci
def test_a_loop_over_what_is_remembered_goes_round_as_at_the_end_of_a_run():
    """Of `ekf-delay` state, input, slope go on over the longest delay (4 + 2 + 8 products a tick), all it keeps over a period.

    That are 3 states, of which one is the delay, an input, and a covariance: 9 + 3 + 54.
    """

    def products(longest, period):
        study = {
            "name": "t",
            "scenario": {
                "base": "cart/white",
                "sampling_period": period,
                "delay": 0.2,
                "duration": 2.0,
                "steady_start": 1.0,
            },
        }
        study |= {"options": {"ekf-delay": {"longest": longest}}}
        return int(pcbench.operation_counts(study, observers=["ekf-delay"])["sample"].iloc[0])

    least = products(0.3, 0.2)
    assert products(0.5, 0.2) - least == 200 * (4 + 2 + 8)
    assert products(0.3, 0.3) - least == 100 * (9 + 3 + 54)


def result_of(stats):
    """As much of a result as the picture asks for."""
    of = SimpleNamespace(
        study=Study(name="costs", scenarios=["cart/white"]),
        stats=stats.assign(n=8, diverged=0, p50=0.0),
        scenarios=list(dict.fromkeys(stats.scenario)),
    )
    of.signals, of.ranks = lambda scenario: list(dict.fromkeys(stats.signal)), lambda metric: metric
    of.stats_of = lambda scenario, signal: of.stats[(of.stats.scenario == scenario) & (of.stats.signal == signal)]
    return of


def test_error_against_cost_has_a_point_for_every_observer_that_costs_and_says_where_it_is():
    row = {
        "scenario": "cart/white",
        "cell": 0,
        "signal": "position",
        "unit": "m",
        "metric": "steady_rmse",
        "delay": 0.1,
    }
    stats = pd.DataFrame(
        [
            row | {"observer": o, "mean": m, "ci_low": m - 0.1, "ci_high": m + 0.1}
            for o, m in (("kf", 1.0), ("kf-ignore-delay", 2.0), ("model-only", 3.0))
        ]
    )
    costs = stats[["scenario", "cell", "observer"]].assign(sample=[60, 55, 0], tick=[10, 10, 6], memory=[100, 100, 16])
    result = result_of(pd.concat([stats, stats.assign(cell=1, delay=0.8)]))
    figure = plots.cost(result, costs, signal="position")
    assert "cart/white, delay 0.1 s, 8 runs" in {text.get_text() for text in figure.findobj(Text)}
    (ax,) = figure.axes
    points = [tuple(map(float, each.get_offsets()[0])) for each in ax.collections if len(each.get_offsets()) == 1]
    assert (60.0, 1.0) in points
    assert (55.0, 2.0) in points
    assert len([p for p in points if p[1] == 3.0]) == 0
    with pytest.raises(UserError, match="did you mean 'sample'"):
        plots.cost(result, costs, by="sampel")


def test_error_against_cost_is_of_the_scenario_that_is_asked_for():
    """Of several scenarios each has its own costs and errors."""
    rows = [
        {"scenario": s, "cell": 0, "signal": "a", "unit": "m", "metric": "steady_rmse", "observer": o, "mean": m,
         "ci_low": 0.9 * m, "ci_high": 1.1 * m}
        for s, m in (("one", 1.0), ("two", 5.0)) for o in ("kf", "kf-ignore-delay")
    ]  # fmt: skip
    stats = pd.DataFrame(rows)
    costs = stats[["scenario", "cell", "observer"]].assign(sample=60, tick=10, memory=100)
    (ax,) = plots.cost(result_of(stats), costs, scenario="two", signal="a").axes
    marks = [c for c in ax.collections if isinstance(c, PathCollection)]
    assert marks
    assert not any(mark.get_clip_on() for mark in marks), "of an error of 0 the half below the axis was missing"
    points = [each.get_offsets() for each in ax.collections if isinstance(each, PathCollection)]
    assert {float(each[0][1]) for each in points} == {5.0}


def test_what_observers_of_a_cell_cost_is_kept_and_is_nothing_where_nothing_is_sampled(tmp_path, monkeypatch):
    study = parse.parse({"name": "t", "scenarios": ["cart/white", "arm/sine"], "observers": ["model-only"]}, "t")
    found = observer_costs.frame_of(study, "cart/white", tmp_path)
    whole = pcbench.operation_counts("cart/white", observers=["model-only"])
    pd.testing.assert_frame_equal(found, whole[["scenario", "cell", "observer", "sample", "tick", "memory"]])
    monkeypatch.setattr(observer_costs.operation_counts, "costs", None)
    pd.testing.assert_frame_equal(observer_costs.frame_of(study, "cart/white", tmp_path), found)
    assert observer_costs.frame_of(study, "arm/sine", tmp_path) is None


def test_what_no_loop_depends_on_is_not_computed():
    """A wait on what cannot be computed does not hinder the count."""

    def f(a, x):
        return lax.fori_loop(0, 3, lambda i, x: x * jax.pure_callback(lambda v: 1 / 0, x, x), x)

    assert count_multiplications(f, A, X) == 12


@pytest.mark.nightly
def test_tables_have_what_observers_cost_where_that_is_asked():
    result = pcbench.run("cart/slow", observers=["model-only"], seeds=2)
    costs = pcbench.operation_counts("cart/slow", observers=["model-only"])
    console = Screen(file=io.StringIO(), width=140)
    results.closing(result, console, "steady_rmse", None, costs)
    (row,) = [line.split() for line in console.file.getvalue().splitlines() if line.strip().startswith("model-only")]
    assert {"0", "6", "16"} <= set(row)
    _, table = headline.headlines(result, "cart/slow", "position", "steady_rmse", 0, costs)
    assert table.heads[-3:] == ["multiplications per sample", "multiplications per tick", "bytes of memory"]
    assert table.rows[0].cells[-3:] == ["0", "6", "16"]
