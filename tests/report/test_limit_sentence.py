"""What suffices, as the page says it beside a curve: from intervals by hand, and nothing where there is no answer."""

import pandas as pd

from pcbench.report import captions

HEADS = ["observer", "delay", "metric", "mean", "ci_low", "ci_high", "n", "diverged"]


def rows(*given):
    return pd.DataFrame(
        [(o, x, "steady_rmse", m, m - h, m + h, 8 - lost, lost) for o, x, m, h, lost in given], columns=HEADS
    )


PART = rows(
    ("kf", 0.1, 0.010, 0.001, 0),
    ("kf", 0.2, 0.015, 0.001, 0),
    ("kf", 0.4, 0.030, 0.001, 0),
    ("chain", 0.1, 0.040, 0.001, 0),
    ("chain", 0.2, 0.050, 0.001, 0),
    ("chain", 0.4, 0.060, 0.001, 0),
    ("kfbo", 0.1, 0.012, 0.001, 0),
    ("kfbo", 0.2, 0.0195, 0.001, 0),
    ("kfbo", 0.4, 0.012, 0.001, 3),
)


def test_without_a_limit_it_is_twice_the_least_error_of_the_axis():
    assert captions.describe_limit(PART, "delay", "m", None) == (
        "Significantly below 0.02 m (twice the least mean): kf up to 0.2, not at 0.4; chain nowhere; "
        "kfbo up to 0.1, not at 0.4 (runs diverge)."
    )


def test_a_limit_is_what_a_user_says():
    said = captions.describe_limit(PART, "delay", "m", 0.045)
    assert said == (
        "Significantly below 0.045 m: kf everywhere; chain up to 0.1, not at 0.2; "
        "kfbo up to 0.2, not at 0.4 (runs diverge)."
    )


def test_what_is_not_sure_is_not_said():
    wide = rows(("kf", 0.1, 0.010, 0.015, 0), ("kf", 0.2, 0.010, 0.015, 0))
    assert (
        captions.describe_limit(wide, "delay", "m", None)
        == "Significantly below 0.02 m (twice the least mean): kf undecided everywhere."
    )


def test_an_error_that_falls_again_is_said():
    odd = rows(("kf", 0.1, 0.05, 0.001, 0), ("kf", 0.2, 0.01, 0.001, 0))
    assert captions.describe_limit(odd, "delay", "m", 0.02) == (
        "Significantly below 0.02 m: kf up to 0.2 (but not at 0.1)."
    )
    wide = pd.concat([odd, rows(("kf", 0.4, 0.02, 0.005, 0), ("kf", 0.8, 0.03, 0.001, 0))])
    assert captions.describe_limit(wide[:3], "delay", "m", 0.02).endswith(
        "kf up to 0.2 (but not at 0.1), undecided beyond."
    )
    assert captions.describe_limit(wide, "delay", "m", 0.02).endswith("kf up to 0.2 (but not at 0.1), not at 0.8.")


def test_undecided_everywhere_is_not_said_of_an_error_that_exceeds_the_limit():
    risen = rows(("kf", 0.1, 0.02, 0.005, 0), ("kf", 0.2, 0.05, 0.001, 0))
    assert captions.describe_limit(risen, "delay", "m", 0.02).endswith(": kf undecided, not at 0.2.")


def test_where_only_diverged_runs_fail_it_is_said():
    """The mean over the other runs lies below the limit in the figure."""
    lost = rows(("kf", 0.1, 0.01, 0.001, 1), ("kf", 0.2, 0.01, 0.001, 2))
    assert captions.describe_limit(lost, "delay", "m", 0.02).endswith(": kf nowhere (runs diverge).")
    lost.loc[0, ["diverged", "mean", "ci_low", "ci_high"]] = [0, 0.03, 0.029, 0.031]
    assert captions.describe_limit(lost, "delay", "m", 0.02).endswith(": kf nowhere.")


def test_of_a_negative_fault_the_size_counts():
    """An offset of -1.6 s is larger than one of -0.1 s."""
    offset = rows(("kf", -1.6, 0.9, 0.01, 0), ("kf", -0.1, 0.015, 0.001, 0), ("kf", 0.0, 0.01, 0.001, 0))
    assert captions.describe_limit(offset, "delay", "m", None) == (
        "Significantly below 0.02 m (twice the least mean), by the size of delay [s]: kf up to 0.1, not at 1.6."
    )


def test_exact_values_and_numbers_without_a_unit():
    exact = PART.assign(n=0, diverged=0)
    assert captions.describe_limit(exact, "delay", "1", 0.045).startswith(
        "Below 0.045: kf everywhere; chain up to 0.1,"
    )


def test_an_axis_of_words_and_errors_that_are_0_have_no_answer():
    assert captions.describe_limit(PART.assign(delay="interval"), "delay", "m", None) == ""
    assert captions.describe_limit(PART.assign(delay=None), "delay", "m", None) == ""
    assert captions.describe_limit(rows(("kf", 0.1, 0.0, 0.0, 0)), "delay", "m", None) == ""
