"""Estimates as people read them: a value, and half its interval to two digits."""

import pandas as pd
import pytest

from pcbench.statistics import number_format

NAN = float("nan")
WRITTEN = [
    ((0.5, 0.45, 0.55), "0.500 ± 0.050"),
    ((12.3456, 12.05, 12.65), "12.35 ± 0.30"),
    ((3e-13, 0.0, 1e-12), "0"),
    ((1234.5, 1230.0, 1239.0), "1234.5 ± 4.5"),
    ((0.012345, 0.0123, 0.01239), "0.012345 ± 0.000045"),
    ((2.5e7, 2.4e7, 2.6e7), "(2.50 ± 0.10)e+07"),
    ((-3.21e-6, -3.31e-6, -3.11e-6), "(-3.21 ± 0.10)e-06"),
    ((4.0, 4.0, 4.0), "4"),
    ((1.0, 1.0 - 1e-13, 1.0 + 1e-13), "1"),
    ((1.0, 0.999, 1.5), "1 (1 .. 1.5)"),
    ((NAN, 0.0, 1.0), "-"),
    ((2.0, NAN, NAN), "2 ± ?"),
]


@pytest.mark.parametrize(("given", "text"), WRITTEN)
def test_an_estimate_is_written_with_half_its_interval(given, text):
    assert number_format.estimate(*given) == text
    assert number_format.interval(dict(zip(("mean", "ci_low", "ci_high"), given, strict=True))) == text


def test_a_sign_is_written_of_a_positive_difference_too():
    assert number_format.estimate(1.5, 1.4, 1.6, "+") == "+1.50 ± 0.10"
    assert number_format.estimate(2.5e7, 2.4e7, 2.6e7, "+") == "(+2.50 ± 0.10)e+07"


def test_a_fraction_is_in_per_cent_with_its_whole_interval():
    assert number_format.fraction({"mean": 0.25, "ci_low": 0.125, "ci_high": 0.375}) == "25 % (12.5 .. 37.5)"


def pair(a, b, **changes):
    usual = {"mean_diff": 0.4, "ci_low": 0.3, "ci_high": 0.5, "n": 64, "p_holm": 0.01, "prob_a_better": 0.1}
    return pd.DataFrame([{"observer_a": a, "observer_b": b} | usual | changes])


def test_a_difference_is_the_observer_less_the_best_in_either_order():
    assert number_format.difference(pair("x", "best"), "x", "best") == "+0.40 ± 0.10"
    assert (
        number_format.difference(pair("best", "x", mean_diff=-0.4, ci_low=-0.5, ci_high=-0.3), "x", "best")
        == "+0.40 ± 0.10"
    )
    assert number_format.difference(pair("best", "other"), "x", "best") == "-"


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({"p_holm": 0.051}, "="),
        ({"p_holm": 0.05}, "+0.40 ± 0.10"),
        ({"prob_a_better": 0.5}, "="),
        ({"mean_diff": 0.0, "ci_low": 0.0, "ci_high": 0.0, "p_holm": NAN, "prob_a_better": NAN}, "="),
        ({"n": 1, "ci_low": NAN, "ci_high": NAN, "p_holm": 0.2}, "+0.4 ± ?"),
        ({"mean_diff": NAN}, "-"),
        ({"ci_low": 0.4, "ci_high": 0.4, "p_holm": NAN}, "+0.4"),
    ],
)
def test_a_difference_that_may_be_chance_is_none(changes, text):
    assert number_format.difference(pair("x", "best", **changes), "x", "best") == text
