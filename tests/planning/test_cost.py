"""Costs are counted from the functions themselves: products worked out by hand, loops as often as they go round."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import pandas as pd
import pytest
from jax import lax

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.planning.cost import counted

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
    assert counted(f, A, X) == many


def test_costs_of_observers_of_two_states_and_one_output():
    """A tick of the model alone is Phi x + Gamma u: 4 + 2 products; `dkf` moves g too, by the same push: 4 + 4 + 2."""
    found = pcbench.costs("cart/white", observers=["open-loop", "dkf", "kf-now", "kf-horizon"]).set_index("observer")
    assert found.tick[["open-loop", "dkf", "kf-now"]].tolist() == [6, 10, 10]
    assert found["sample"]["open-loop"] == 0
    assert found["sample"]["dkf"] == found["sample"]["kf-now"] > 50
    assert found.tick["kf-horizon"] > found["sample"]["dkf"], "it updates at every tick"
    assert found.memory["open-loop"] == 2 * 8


def test_error_against_cost_has_a_point_for_every_observer_that_costs():
    row = {"scenario": "cart/white", "cell": 0, "signal": "position", "unit": "m", "metric": "tail_rmse"}
    stats = pd.DataFrame(
        [
            row | {"observer": o, "mean": m, "ci_low": m - 0.1, "ci_high": m + 0.1}
            for o, m in (("dkf", 1.0), ("kf-now", 2.0), ("open-loop", 3.0))
        ]
    )
    costs = stats[["scenario", "cell", "observer"]].assign(sample=[60, 55, 0], tick=[10, 10, 6], memory=[100, 100, 16])
    result = SimpleNamespace(stats=stats)
    (ax,) = plots.cost(result, costs).axes
    points = [tuple(map(float, each.get_offsets()[0])) for each in ax.collections if len(each.get_offsets()) == 1]
    assert (60.0, 1.0) in points
    assert (55.0, 2.0) in points
    assert len([p for p in points if p[1] == 3.0]) == 0
    with pytest.raises(UserError, match="did you mean 'sample'"):
        plots.cost(result, costs, by="sampel")
