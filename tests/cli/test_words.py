"""What a person reads in the terminal: numbers with half their interval, signs, per cents, and counts of verdicts."""

import io
from types import SimpleNamespace
from typing import NamedTuple

import pandas as pd
import pytest

from pcbench.cli.render import folder, gains, results
from pcbench.cli.render.tables import Screen
from pcbench.dataset.compare import Comparison
from pcbench.dataset.timing import Cost
from pcbench.papers.claim import FINDING, VERDICTS, Claim
from pcbench.study import STUDIES, Study
from pcbench.synthesis.certificate import Certificate, Design, no_certificate

NAN = float("nan")


def row(mean, low, high, **more):
    return {"mean": mean, "ci_low": low, "ci_high": high} | more


@pytest.mark.parametrize(
    ("median", "text"), [(1.234, "1.23"), (9.999, "10"), (10.0, "never"), (12.0, "never"), (NAN, "-")]
)
def test_who_settles_at_the_horizon_never_settles(median, text):
    assert results.format_settling_time({"p50": median}, 10.0) == text


def capture(show_it, *given):
    out = io.StringIO()
    show_it(*given, Screen(file=out, width=200, color_system=None))
    return out.getvalue()


def test_claims_are_counted_by_verdict_and_findings_apart():
    rows = [Claim("c", "1", "2", v) for v in (*VERDICTS, VERDICTS[0], VERDICTS[2], FINDING, FINDING, FINDING)]
    text = "6 claims: 2 reproduced, 1 misprint, 2 does not hold, 1 not determinable; 3 findings that are in no paper."
    assert folder.summary(rows) == text
    assert text in capture(folder.all_claims, {"a": rows[:4], "b": rows[4:]}, {"a": "A", "b": "B"})


def test_a_comparison_shows_both_sides_with_two_standard_errors():
    one = {
        "scenario": "s",
        "where": "",
        "observer": "o",
        "signal": "x",
        "metric": "mae",
        "unit": "m",
        "n_a": 9,
        "n_b": 9,
    }
    one |= {
        "mean_a": 1.0,
        "se_a": 0.2,
        "mean_b": 1.5,
        "se_b": 0.05,
        "difference": 0.5,
        "relative": 0.3,
        "p_value": 0.001,
    }
    one |= {"p_holm": 0.002, "same_draws": False, "changed": True, "identical": False}
    one |= {"certified_a": None, "certified_b": True}
    rows = pd.DataFrame([one, one | {"observer": "still", "changed": False}])
    text = capture(folder.comparison, Comparison(rows, (0, 3), ["versions.jax: 1 there, 2 here"]), "old", "new")
    assert "1 ± 0.4 m" in text
    assert "1.5 ± 0.1 m" in text
    assert "+0.5" in text
    assert "2.0e-03" in text
    assert "versions.jax: 1 there, 2 here" in text
    assert "3 rows are only in new." in text
    assert "All 2 rows have different seeds" in text
    assert "1 of 2 rows changed beyond their interval." in text
    assert "still" not in text


def test_what_is_found_of_gains_that_nothing_proves_says_so():
    proven = Certificate("radius < 1", 0.5, "poles", "solved")
    for certificate in (no_certificate("by hand"), proven):
        known = {"certified": certificate is proven}
        option = {"share": 0.1, "rate": NAN, "margin": 1.0, "solver": "none", "fallback": "", "refused": ""} | known
        version = {"scenario": "s", "metric": "mae", "signal": "x", "unit": "m", "cell": 0, "observer": "mine"}
        version |= {"tuning": "published", "label": "mine", "note": "", "diverged": 0, **known}
        version |= dict.fromkeys(
            ("held_out", "held_out_se", "rms_efficiency", "training", "training_se", "gap", "gap_se"), NAN
        )
        found = SimpleNamespace(
            judgements=[],
            points=[],
            method="search",
            best={},
            kept_start="",
            exact=False,
            objective=SimpleNamespace(metric="mae", base="mae", name="x"),
            **known,
        )
        texts = [
            capture(gains.gains, Design(None, certificate)),
            capture(gains.trade_off, "mine in s", pd.DataFrame([option])),
            capture(gains.print_tuning, found, "mine", None),
            capture(gains.fair, pd.DataFrame([version])),
        ]
        assert [("No certificate for" in text) for text in texts] == 4 * [certificate is not proven]
        assert [("mine *" in text) for text in texts[2:]] == 2 * [certificate is not proven]


def stats(**means):
    """Rows of a closing table for two cells of one scenario."""
    metrics = ("mae", "pooled_rmse", "steady_pooled_rmse", "settling_time", "divergence_rate")
    rows = []
    for observer, (first, second, lost) in means.items():
        for cell, mean in enumerate((first, second)):
            for metric in metrics:
                value = lost / 10 if metric == "divergence_rate" else mean
                rows.append(
                    {"study": "t", "scenario": "cart/white", "plant": "cart", "observer": observer, "cell": cell}
                    | {
                        "delay": 0.2 + cell,
                        "signal": "position",
                        "unit": "m",
                        "predicts_unknown_input": None,
                        "metric": metric,
                    }
                    | {"certified": None, "method": "runs"}
                    | row(value, value - 0.01, value + 0.01, n=10 - lost, diverged=lost, p50=mean)
                )
    return pd.DataFrame(rows)


class Results(NamedTuple):
    stats: pd.DataFrame
    pairs: pd.DataFrame
    study: Study = STUDIES["quick"]

    def unproven(self, scenario):
        return ""

    def ranks(self, metric):
        return metric


def test_the_closing_table_has_the_least_first_and_who_diverges_last():
    table = stats(worse=(0.5, 0.2, 0), better=(0.3, 0.4, 0), lost=(0.1, 0.1, 2))
    usual = {"observer_a": "worse", "observer_b": "better", "n": 64, "p_holm": 0.01, "prob_a_better": 0.1}
    pairs = pd.DataFrame(
        [
            usual | {"mean_diff": 0.2, "ci_low": 0.1, "ci_high": 0.3},
            usual | {"mean_diff": -0.2, "ci_low": -0.3, "ci_high": -0.1},
        ]
    ).assign(scenario="cart/white", signal="position", metric="mae", cell=[0, 1])
    lines = capture(lambda console: results.closing(Results(table, pairs), console, "mae")).splitlines()
    order = [word for line in lines for word in line.split() if word in ("worse", "better", "lost")]
    assert order == ["better", "worse", "lost", "worse", "better", "lost"]
    assert "20 % (19 .. 21)" in "\n".join(lines)
    (second,) = (line for line in lines if "worse" in line and "+0.20 ± 0.10" in line)
    assert "0.500 ± 0.010" in second


def test_timings_say_where_the_time_went_and_nothing_where_nothing_was_done():
    spent = {f"{part}_seconds": 2.0 for part in ("compile", "planning", "computing", "writing", "closing")}
    about = {"wall_seconds": 3.0, "runs_added": 8} | spent

    def said(cost):
        return results.timings(SimpleNamespace(provenance=about, cost=cost), seconds=4.5)

    assert said(Cost()) == []
    exact = said(Cost(exact_seconds=1.25))
    assert [line.split("  ")[0] for line in exact] == [
        "from the command to the study",
        "exact numbers",
        "the whole study",
    ]
    assert "1.50 s" in exact[0]
    assert "1.25 s" in exact[1]
    both = said(Cost(runs=8, exact_seconds=1.25))
    assert [line.split("  ")[0] for line in both][1:4] == ["exact numbers", "planning", "computing"]
    assert both[-1].endswith("8 runs")
    assert len(said(Cost(runs=8))) == len(both) - 1


def test_table_spells_out_acronyms_of_papers_once():
    text = capture(lambda screen: screen.explain_acronyms(["kf", "pccebo-riccati", "pccebo", "smo"]))
    assert text == "pccebo: piecewise continuous and current estimator-based observer; smo: sliding-mode observer.\n"
    assert not capture(lambda screen: screen.explain_acronyms(["kf", "model-only"]))
