"""The search for what suffices, with runs that are a formula: its answer is that of every value tried, by far fewer."""

from itertools import pairwise
from math import inf, isclose, isnan, nan

import numpy as np
import pandas as pd
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from pcbench.limits.search import Scale, search, seeds_to_add
from pcbench.statistics import limit_verdicts
from pcbench.statistics.limit_verdicts import Point, answer

LIMIT, SEEDS, MOST = 0.1, 64, 4096
PERIODS = Scale(0.001, 2.0, tick=1e-3)


def runs(errors, spread=0.0, asked=None):
    """What would come out of runs whose error is a formula: an interval that narrows with the root of the seeds."""

    def look(values, seeds):
        if asked is not None:
            asked.append((set(values), dict(seeds)))
        return {o: [known(f, v, seeds.get(v, 0)) for v in values] for o, f in errors.items()}

    def known(f, value, seeds):
        n = max(SEEDS, seeds)
        mean, half = f(value), 2 * spread * f(value) / np.sqrt(n)
        lost = 1 if mean == inf else 0
        row = {"mean": nan if lost else mean, "ci_low": mean - half, "ci_high": mean + half, "n": n - lost}
        return limit_verdicts.point(row | {"diverged": lost, "metric": "rmse"}, value, LIMIT)

    return look


def by_every_tick(f, scale=PERIODS):
    """The same by trying all of them: the largest value with an error below the limit, where all smaller ones are."""
    values = np.round(np.arange(1, round(scale.high / scale.tick) + 1) * scale.tick, 12)
    good = values[f(values) < LIMIT]
    return good[-1] if len(good) else nan


@example(1.0, 1.0)
@example(0.5, 1.0)
@example(0.025, 2.0)
@given(st.floats(0.02, 5.0), st.floats(0.3, 3.0))
def test_without_noise_it_is_the_answer_of_every_tick_to_the_tick(size, power):
    def error(v):
        return size * v**power

    want = by_every_tick(error)
    asked = []
    found = answer(search(runs({"a": error}, asked=asked), PERIODS._replace(tol=1e-3), LIMIT, MOST)["a"])
    at_limit = sum(p.verdict == "undecided" for p in found.points)  # an error of the limit itself, without spread
    if isnan(want):
        assert found.kind == "no value"
    elif want == PERIODS.high:
        assert found.kind == "every value"
    else:
        assert found.largest.value == want
        above = want + 1e-3 * (1 + at_limit)
        if above > PERIODS.high + 1e-9:  # the last value of all has an error of the limit itself
            assert found.exceeds is None
        else:
            assert isclose(found.exceeds.value, above)
    assert len(asked[-1][0]) < 20 * (1 + at_limit), "of 2000; both sides of one at the limit are searched"


@given(st.floats(0.06, 5.0), st.floats(0.5, 2.0))
def test_by_default_it_is_found_to_a_twentieth(size, power):
    crossing = (LIMIT / size) ** (1 / power)
    found = answer(search(runs({"a": lambda v: size * v**power}), PERIODS, LIMIT, MOST)["a"])
    if 0.002 < crossing < 1.9:
        assert found.largest.value <= crossing <= found.exceeds.value
        gaps = 1 + sum(p.verdict == "undecided" for p in found.points)  # an error of the limit itself, without spread
        assert found.exceeds.value - found.largest.value <= gaps * max(0.05 * found.exceeds.value, 1e-3) + 1e-12


def test_where_an_interval_holds_the_limit_seeds_are_added_up_to_the_budget():
    asked = []
    found = search(runs({"a": lambda v: 0.2 * v**0.5}, 0.3, asked), PERIODS, LIMIT, MOST)["a"]
    a = answer(found)
    assert 0.2 <= a.largest.value < 0.25 < a.exceeds.value < 0.3
    assert a.largest.high < LIMIT < a.exceeds.low
    many = {p.value: p.runs for p in found}
    assert max(many.values()) <= MOST
    assert many[0.001] == many[2.0] == SEEDS, "none where it is sure anyway"
    between = [p for p in found if a.largest.value < p.value < a.exceeds.value]
    assert all(p.runs == MOST and p.verdict == "undecided" for p in between)
    for earlier, later in pairwise(asked):
        assert earlier[0] <= later[0], "a study only grows"
        assert all(later[1][v] >= n for v, n in earlier[1].items())


def test_with_a_budget_of_no_more_seeds_the_edges_are_still_sharp():
    found = answer(search(runs({"a": lambda v: 0.2 * v**0.5}, 0.3), PERIODS, LIMIT, SEEDS)["a"])
    assert found.largest.value < 0.25 < found.exceeds.value
    assert all(p.runs == SEEDS for p in found.points)


def test_each_observer_has_its_own_answer_and_sees_what_others_needed():
    errors = {"a": lambda v: v, "b": lambda v: 0.3 * v, "c": lambda v: 0.9 + 0 * v, "d": lambda v: 0.01 + 0 * v}
    found = {o: answer(each) for o, each in search(runs(errors), PERIODS, LIMIT, MOST).items()}
    assert [found[o].kind for o in "abcd"] == ["up to", "up to", "no value", "every value"]
    assert len({tuple(p.value for p in each.points) for each in found.values()}) == 1
    assert found["c"].exceeds.value == PERIODS.low
    assert found["d"].largest.value == PERIODS.high


def test_a_failure_below_a_value_that_suffices_is_said():
    def error(v):
        return 0.2 if 0.005 < v < 0.2 else 0.05

    found = answer(search(runs({"a": error}), PERIODS, LIMIT, MOST)["a"])
    assert found.largest.value == 2.0
    assert 0.005 < found.fails_below.value < 0.2
    assert "it is not monotone" in limit_verdicts.sentence(found, "period")


def test_where_runs_diverge_it_does_not_suffice():
    found = answer(search(runs({"a": lambda v: 0.05 if v < 0.5 else inf}), PERIODS, LIMIT, MOST)["a"])
    assert found.largest.value < 0.5 <= found.exceeds.value
    assert found.exceeds.verdict == "diverges"
    assert "diverges" in limit_verdicts.sentence(found, "period")


def test_a_metric_without_a_number_has_no_answer():
    def look(values, seeds):
        return {"a": [Point(v, "null", runs=64) for v in values]}

    found = answer(search(look, PERIODS, LIMIT, MOST)["a"])
    assert found.kind == "no number"
    assert "no number" in limit_verdicts.sentence(found, "period")


def test_a_value_that_an_observer_cannot_work_at_is_no_failure_and_no_success():
    def look(values, seeds):
        free = runs({"a": lambda v: 0.1 * v})(values, seeds)["a"]
        return {"a": [Point(p.value, "refused", why="no gains.") if 0.9 < p.value < 1.2 else p for p in free]}

    found = answer(search(look, PERIODS, LIMIT, MOST)["a"])
    assert 0.85 < found.largest.value <= 0.9
    assert 1.2 <= found.exceeds.value < 1.26
    assert ": no gains." in limit_verdicts.sentence(found, "period")
    every = answer([Point(v, "refused", why="no gains.") for v in (1.0, 2.0)])
    assert every.kind == "refused"


def test_one_run_is_not_sure_and_a_mean_at_the_limit_that_does_not_vary_never_will_be():
    one = Point(0.1, "undecided", 0.05, nan, nan, 1)
    assert seeds_to_add([one], PERIODS, LIMIT, MOST) == {0.1: 16}
    exact = Point(0.1, "undecided", LIMIT, LIMIT, LIMIT, 64)
    assert seeds_to_add([exact], PERIODS, LIMIT, MOST) == {}
    assert answer([exact]).kind == "undecided"


@pytest.mark.parametrize(
    ("scale", "start"),
    [
        (Scale(0.001, 4.0, tick=1e-3), [0.001, 0.008, 0.06, 0.5, 4.0]),
        (Scale(0.0, 1.0), [0.0, 0.2, 0.5, 0.8, 1.0]),
        (Scale(0.0, 0.002, tick=1e-3), [0.0, 0.001, 0.002]),
        (Scale(110.0, 122.0, also=(115.5,)), [110.0, 113.0, 115.5, 116.0, 120.0, 122.0]),
    ],
)
def test_it_begins_with_the_ends_and_round_values_between_them(scale, start):
    assert scale.start() == start


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_what_lies_between_two_values_lies_between_them(a, apart):
    b = a + apart
    middle = Scale(a, b).between(a, b)
    assert middle is None or a < middle < b
    ticks = Scale(a, b, tick=0.5).between(a, b)
    assert ticks is None or (a < ticks < b and ticks * 2 == round(ticks * 2))


def test_two_neighbouring_ticks_are_as_close_as_can_be():
    assert PERIODS.is_near(0.011, 0.012)
    assert PERIODS._replace(tol=1e-6).is_near(0.3, 0.301)
    assert not PERIODS.is_near(0.01, 0.012)


def answers(rows, axis, limit):
    found = limit_verdicts.points(rows, axis, limit)
    return limit_verdicts.table({observer: answer(each) for observer, each in found.items()}, axis)


def test_the_answer_of_values_that_were_run_is_read_from_a_frame():
    """For a page over a study: no search, the rows of stats alone."""
    values, rng = np.array([0.1, 0.2, 0.3, 0.4]), np.random.default_rng(3)
    rows = []
    for o, means in {"a": [0.05, 0.08, 0.099, 0.3], "b": [0.2, 0.3, 0.4, 0.5]}.items():
        for v, mean in zip(values, means, strict=True):
            rows.append(
                {"observer": o, "period": v, "metric": "rmse", "n": 64, "diverged": 0, "mean": mean,
                 "ci_low": mean - 0.01, "ci_high": mean + 0.01}
            )  # fmt: skip
    frame = pd.DataFrame(rows).sample(frac=1, random_state=rng.bit_generator)
    found = answers(frame, "period", LIMIT).set_index("observer")
    assert found.answer.to_dict() == {"a": "up to", "b": "no value"}
    assert (found.largest["a"], found.exceeds["a"], found.exceeds["b"]) == (0.2, 0.4, 0.1)
    assert (found.ci_high["a"], found["mean"]["a"]) == (0.09, 0.08)
    assert found.sentence["a"].startswith(
        "period up to 0.2 suffices; at 0.4 it is 0.300 ± 0.010; undecided at 0.3 with"
    )
    diverged = frame.assign(diverged=(frame.period == 0.1).astype(int))
    assert answers(diverged, "period", LIMIT).set_index("observer").fails_below["a"] == 0.1
    assert answers(diverged.assign(metric="divergence_rate"), "period", LIMIT).fails_below.isna().all()
