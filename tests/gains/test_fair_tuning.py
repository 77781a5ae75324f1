"""What tuning finds where the answer is known otherwise: by brute force, by a rule of thumb, by the clock of nobody."""

import numpy as np
import pytest

import pcbench
from pcbench import planning
from pcbench.gains import objective_eval
from pcbench.gains.objective import objective_of
from pcbench.observers import entry_of
from pcbench.runtime import config
from pcbench.study import options_of, parse

pytestmark = pytest.mark.nightly
HALF = {"training_seeds": (3_000_000_000, 3_000_000_256), "validation_seeds": (3_500_000_000, 3_500_000_256)}


def brute_force(grid):
    """The least tail RMSE in cart/gaussian over a grid of gains L, on the training seeds."""
    with config.float64():
        study, cell = parse.one_cell("cart/gaussian", ["pccebo"], [])
        known, options = planning.context_of(cell), options_of(study, cell.scenario, "pccebo")

        def gains(L):
            return entry_of("pccebo").design(known, options.model_copy(update={"L": [[float(x)] for x in L]})).gains

        (p,) = planning.plan(study)
        seeds = np.arange(*HALF["training"])
        value = objective_eval.evaluator(
            "search", p, objective_of("steady_rmse", cell.scenario, None, "test"), 0, seeds, gains
        )
        return min((value(np.array(L))[0], L) for L in grid)


def test_tuned_pccebo_comes_within_ten_percent_of_the_best_fixed_gain():
    least, L = brute_force([(a, b) for a in np.linspace(0.1, 1.0, 19) for b in (-80.0, -40.0, -10.0, 0.0, 20.0)])
    found = pcbench.tune("cart/gaussian", "pccebo", objective="steady_rmse", budget=30, **HALF)
    assert found.judgements[0].tuned <= 1.1 * least, (found.best, L)
    assert found.judgements[0].start > 1.5 * least, "there was something to find"
    assert not found.kept_start


def test_pi_pco_finds_the_sign_rule_by_itself():
    """Kp < 0 smooths, Kp > 0 amplifies noise, and where the model is exact the integral only hurts."""
    wrong = ["options.pi-pco.Kp=40.0", "options.pi-pco.Ki=12.0"]
    found = pcbench.tune("cart/variable", "pi-pco", objective="steady_rmse", overrides=wrong, **HALF)
    assert found.best["Kp"] < -40
    assert abs(found.best["Ki"]) < 0.5
    assert found.judgements[1].tuned < 0.5 * found.judgements[1].start


@pytest.mark.parametrize("observer", ["kfbo", "kf"])
def test_tuned_is_not_worse_than_its_start_on_other_draws(observer):
    found = pcbench.tune("cart/gaussian", observer, objective="steady_rmse", budget=15, **HALF)
    (_, judging) = found.judgements
    assert found.kept_start or judging.difference <= 2 * judging.difference_se
