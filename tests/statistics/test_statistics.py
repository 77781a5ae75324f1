"""The numbers over runs against SciPy, against loops over whole arrays, and against what is known of them.

How often the intervals cover is tested in test_coverage.py.
"""

import warnings

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import runs_as_rows
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import statistics as reference
from scipy import stats

from pcbench import statistics
from pcbench.dataset import close, columns, parquet_io
from pcbench.statistics import comparison, quantile_intervals, ranking

RNG = np.random.default_rng(5)
A, B = RNG.gamma(3.0, size=60), RNG.gamma(3.3, size=60)
GOOD = np.zeros(60, bool)

PLAIN = tuple(
    m for m in statistics.RUN_METRICS if not any(each in m for each in ("nees", "nis", "interval", "sent"))
)  # of few observers


def test_mean_interval_equals_scipy():
    got = statistics.mean(A)
    low, high = stats.t.interval(0.95, 59, loc=A.mean(), scale=stats.sem(A))
    assert (got["n"], got["mean"], got["se"]) == pytest.approx((60, A.mean(), stats.sem(A)))
    assert (got["ci_low"], got["ci_high"]) == pytest.approx((low, high))


@settings(max_examples=200)
@given(st.integers(1, 400), st.integers(0, 2**32 - 1))
def test_quantiles_equal_numpy_to_the_bit(n, seed):
    x = np.random.default_rng(seed).lognormal(size=n)
    got = runs_as_rows.quantiles(x)
    assert [got[q] for q in statistics.QUANTILES] == np.quantile(x, [0.05, 0.25, 0.5, 0.75, 0.95]).tolist()


@pytest.mark.parametrize(
    ("column", "first"),
    [
        *[("p05_low", 72), ("p05_high", 2), ("p25_low", 13), ("p25_high", 3), ("p50_low", 6), ("p50_high", 6)],
        *[("p75_low", 3), ("p75_high", 13), ("p95_low", 2), ("p95_high", 72)],
    ],
)
def test_an_interval_is_open_below_as_many_runs_as_the_docstring_says(column, first):
    for n in range(1, 100):
        assert np.isnan(runs_as_rows.quantiles(np.arange(float(n)))[column]) == (n < first)


def test_the_interval_of_a_quantile_lies_around_it():
    for n in [*range(1, 300), 1000, 4097, 10**5, 10**7]:
        at = quantile_intervals.positions(n)
        middle, low, high = (at.rank + at.part)[0::3], (at.rank + at.part)[1::3], (at.rank + at.part)[2::3]
        assert not ((low > middle) | (middle > high)).any()  # NaN where open
        assert ((at.rank >= 0) & (at.rank < max(n - 1, 1))).all()


def test_the_median_has_hettmanspergers_and_sheathers_interval():
    """Their equation: w = (n - d) I / (d + (n - 2 d) I), I = (c_d - c) / (c_d - c_{d+1}), c_d = 1 - 2 P(Bin(n, 1/2) < d)."""
    n, x = 60, np.sort(A)
    c = [1 - 2 * stats.binom.cdf(d - 1, n, 0.5) for d in range(n // 2)]
    d = max(d for d in range(1, n // 2) if c[d] >= 0.95)
    share = (c[d] - 0.95) / (c[d] - c[d + 1])
    w = (n - d) * share / (d + (n - 2 * d) * share)
    got = runs_as_rows.quantiles(A)
    assert got["p50_low"] == pytest.approx((1 - w) * x[d - 1] + w * x[d], rel=1e-12)
    assert got["p50_high"] == pytest.approx((1 - w) * x[n - d] + w * x[n - d - 1], rel=1e-12)


def test_an_interval_of_sizes_is_students_of_their_means_logarithm_and_never_below_zero():
    low, high = np.exp(stats.t.interval(0.95, 59, loc=np.log(A.mean()), scale=stats.sem(A) / A.mean()))
    got = statistics.size(A)
    assert (got["ci_low"], got["ci_high"]) == pytest.approx((low, high), rel=1e-12)
    few = statistics.size(np.array([0.0, 0.0, 0.0, 8.0]))
    assert 0 < few["ci_low"] < few["mean"] < few["ci_high"] < np.inf
    assert statistics.mean(np.array([0.0, 0.0, 0.0, 8.0]))["ci_low"] < 0
    with warnings.catch_warnings(action="error"):
        statistics.size(np.array([-1.0, 1.0001]))  # as a signed metric's column is, before its interval is replaced
    none = statistics.size(np.zeros(4))
    assert (none["mean"], none["ci_low"], none["ci_high"]) == (0, 0, 0)


def test_pooled_interval_is_the_root_of_the_mean_squares_interval():
    square = statistics.size(A)
    low, high = square["ci_low"], square["ci_high"]
    got = runs_as_rows.pool(A)
    assert (got["mean"], got["ci_low"], got["ci_high"]) == pytest.approx(np.sqrt([A.mean(), low, high]))
    assert got["se"] == pytest.approx(stats.sem(A) / (2 * np.sqrt(A.mean())))


def test_efficiency_of_an_observer_at_the_bound_is_one():
    assert runs_as_rows.efficiency(np.array([3.9, 4.1]), 2.0)["mean"] == pytest.approx(1.0)
    worse = runs_as_rows.efficiency(np.array([99.0, 101.0]), 2.0)
    assert worse["mean"] == pytest.approx(0.2)
    assert worse["ci_low"] < worse["mean"] < worse["ci_high"]


def test_efficiency_against_a_bound_of_zero_is_none():
    """Beside it the errors of the best observer are rounding, and of any other their size says nothing."""
    assert np.isnan(runs_as_rows.efficiency(np.array([1e-17, 2e-17]), 0.0)["mean"])


def test_paired_test_equals_scipy():
    got, want = runs_as_rows.compare(A, B, GOOD, GOOD), stats.ttest_rel(A, B)
    assert got["p_value"] == pytest.approx(want.pvalue)
    ci = want.confidence_interval(0.95)
    assert (got["ci_low"], got["ci_high"]) == pytest.approx((ci.low, ci.high))
    assert got["prob_a_better"] == pytest.approx((A < B).mean())


@pytest.mark.parametrize("n", [1, 2, 9, 200])
def test_ratio_of_paired_means_equals_reference(n):
    """Two observers whose errors are correlated over runs and differ in size and spread."""
    rng = np.random.default_rng([n, 5])
    shared = rng.standard_exponential((3, n))
    a, b = shared + rng.standard_exponential((3, n)), 0.2 + 0.3 * shared + rng.random((3, n)) ** 2
    e = comparison.paired_ratio(a, b)
    assert e.n == n
    for k in range(3):
        known = reference.ratio(a[k], b[k])
        for name in ("mean", "ci_low", "ci_high"):
            assert getattr(e, name)[k] == pytest.approx(known[name], rel=1e-10, nan_ok=True)


def test_ratio_to_a_mean_of_zero_is_none():
    e = comparison.paired_ratio(np.ones((1, 4)), np.zeros((1, 4)))
    assert np.isnan(e.mean)
    assert np.isnan(comparison.paired_ratio(np.ones((1, 0)), np.ones((1, 0))).mean)


def test_swapping_a_and_b_flips_the_sign_and_the_probability():
    one, two = runs_as_rows.compare(A, B, GOOD, GOOD), runs_as_rows.compare(B, A, GOOD, GOOD)
    assert one["mean_diff"] == pytest.approx(-two["mean_diff"])
    assert one["prob_a_better"] == pytest.approx(1 - two["prob_a_better"])


def test_diverged_runs_lose_and_are_never_averaged():
    bad = GOOD.copy()
    bad[:6] = True
    a = np.where(bad, np.nan, A)
    got = runs_as_rows.compare(a, B, bad, GOOD)
    assert got["n"] == 54
    assert got["mean_diff"] == pytest.approx((A - B)[6:].mean())
    assert got["prob_a_better"] == pytest.approx((A < B)[6:].sum() / 60)
    results = {m: np.stack([a]) for m in PLAIN} | {"diverged": bad}
    stats_rows, _ = runs_as_rows.summarise(
        lambda: [{"a": results | {"unsettled": np.stack([GOOD])}}], {"a": None}, [], ()
    )
    rows = stats_rows["a"]
    assert len(rows) == len(PLAIN) + 4
    for row in rows:
        assert row["diverged"] == 6
        assert row["n"] == (60 if row["metric"] == "divergence_rate" else 54)
        assert np.isfinite(row["mean"])


def test_runs_that_do_not_vary_have_an_interval_without_width_and_no_test():
    same = np.full(9, 0.1)
    got = statistics.mean(same)
    assert (got["mean"], got["se"], got["ci_low"]) == (0.1, 0.0, 0.1)
    compared = runs_as_rows.compare(same, same + 1, GOOD[:9], GOOD[:9])
    assert compared["prob_a_better"] == 1.0
    assert np.isnan(compared["p_value"])


@pytest.mark.parametrize("value", [0.1, 1 / 3, 1e-9, 7.3e5])
def test_values_that_are_all_equal_keep_no_rounding_of_their_sum(value):
    for n in range(2, 40):
        found = statistics.mean(np.full(n, value))
        assert (found["mean"], found["se"]) == (value, 0.0), n


@pytest.mark.parametrize(("difference", "better"), [(1e-12, 0.5), (0.9e-7, 0.5), (1.1e-7, 1.0)])
def test_rounding_is_a_tie(difference, better):
    found = runs_as_rows.compare(A, A * (1 + difference), GOOD, GOOD)
    assert found["prob_a_better"] == better
    assert np.isnan(found["p_value"]) == (better == 0.5)


@pytest.mark.parametrize("n", [0, 1])
def test_too_few_runs_have_no_interval(n):
    got = statistics.mean(A[:n])
    assert np.isnan([got["se"], got["ci_low"], got["ci_high"]]).all()


@settings(max_examples=80)
@given(st.lists(st.floats(0, 1), min_size=1, max_size=12))
def test_holm_equals_its_definition(p):
    """Reject in order of p while p_(i) <= alpha / (k - i): the adjusted value is the least alpha that rejects."""
    p = np.array(p)
    order = np.argsort(p, kind="stable")
    want = np.empty(len(p))
    for i, place in enumerate(order):
        want[place] = min(1.0, max((len(p) - j) * p[order[j]] for j in range(i + 1)))
    np.testing.assert_allclose(statistics.holm(p), want)


def test_holm_leaves_missing_tests_out():
    got = statistics.holm(np.array([0.01, np.nan, 0.03]))
    np.testing.assert_allclose(got, [0.02, np.nan, 0.03])


@pytest.mark.parametrize("at_once", [1, 5, 100])
def test_holm_families_are_one_scenario_signal_and_metric_over_all_cells(at_once, monkeypatch):
    """However many rows of the table are written at a time."""
    monkeypatch.setattr(parquet_io, "ROWS", at_once)
    names = [(s, g, m) for s in "ab" for g in "xy" for m in ("mae", "rmse")]
    rows = [
        {"scenario": s, "signal": g, "metric": m, "cell": cell, "p_value": 0.001 * (1 + i + 8 * cell)}
        for cell in range(2)
        for i, (s, g, m) in enumerate(names)
    ]
    table = parquet_io.GrowingTable({})
    for row in rows:
        table.add(columns.table({name: [value] for name, value in (row | {"p_holm": np.nan}).items()}))
    done = pq.read_table(pa.BufferReader(close.adjust_pairs(table.content(), {})))
    for i, row in enumerate(done.to_pylist()):
        small, large = 0.001 * (1 + i % 8), 0.001 * (9 + i % 8)
        assert row["p_holm"] == pytest.approx(2 * small if row["cell"] == 0 else max(2 * small, large))


def test_rounding_of_zero_is_no_difference():
    """Errors of 1e-13 m and 1e-15 m on a signal of metres are both zero: a tie, and no test."""
    tiny = RNG.normal(size=60) * 1e-15
    got = runs_as_rows.compare(np.abs(tiny), np.abs(tiny) + 4e-13, GOOD, GOOD, floor=5e-11)
    assert got["prob_a_better"] == 0.5
    assert np.isnan(got["p_value"])


SIGNALS, SIZES = ["position", "velocity"], (1.0, 0.01)
TRACKED = ("tracking_rmse", "steady_tracking_rmse", *statistics.OF_RUN)


def cell(seed, n, observers, divergence, kind):
    """Whole arrays of a cell's runs; the last observer estimates one signal only."""
    rng, out = np.random.default_rng(seed), {}
    draw = {
        "smooth": lambda shape: rng.gamma(2.0, size=shape),
        "ties": lambda shape: rng.integers(0, 4, shape) / 4.0,
        "duration": lambda shape: np.minimum(rng.gamma(2.0, size=shape), 1.5),
        "constant": lambda shape: np.full(shape, 0.1),
    }[kind]
    for k in range(observers):
        many = 1 if k == observers - 1 and k > 0 else 2
        bad = rng.random(n) < divergence
        metrics = {m: draw((1 if m in TRACKED else many, n)) for m in PLAIN if m != "recovery_time"}
        metrics["final_error"] = metrics["final_error"] - 1.0
        unsettled = (rng.random((many, n)) < 0.2) & ~bad
        out[f"observer-{k}"] = {m: np.where(bad, np.nan, v) for m, v in metrics.items()} | {
            "diverged": bad,
            "unsettled": unsettled,
        }
    return out


def chunks_of(cell, size):
    """Passes over a cell in chunks; how often one was asked for is in the list."""
    n, passes = len(next(iter(cell.values()))["diverged"]), []

    def chunks():
        passes.append(None)
        for first in range(0, n, size):
            part = slice(first, first + size)
            yield {label: {m: v[..., part] for m, v in results.items()} for label, results in cell.items()}

    return chunks, passes


def assert_rows_agree(got, want):
    assert len(got) == len(want)
    for g, w in zip(got, want, strict=True):
        assert g.keys() == w.keys()
        for name, value in w.items():
            if isinstance(value, float):
                assert g[name] == pytest.approx(value, rel=1e-10, abs=1e-13, nan_ok=True), (w["metric"], name)
            else:
                assert g[name] == value, name


@pytest.mark.ci
@settings(max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.one_of(st.integers(1, 12), st.integers(13, 160)),
    observers=st.integers(1, 3),
    divergence=st.sampled_from([0.0, 0.1, 0.6, 1.0]),
    kind=st.sampled_from(["smooth", "ties", "duration", "constant"]),
    size=st.integers(1, 170),
    held=st.sampled_from([0, 5, 4096]),
    splitters=st.integers(1, 40),
)
def test_any_chunks_agree_with_loops_over_whole_arrays(seed, n, observers, divergence, kind, size, held, splitters):
    whole = cell(seed, n, observers, divergence, kind)
    chunks, passes = chunks_of(whole, size)
    bounds = {label: np.array([0.5, np.nan]) for label in whole} | {"observer-0": None}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quantile_intervals, "MAX_STORED", held)
        patch.setattr(quantile_intervals, "SPLITTERS", splitters)
        stats_rows, pair_rows = runs_as_rows.summarise(chunks, bounds, SIGNALS, SIZES)
        assert len(passes) <= (1 if n <= held else 2)
        assert list(stats_rows) == list(bounds)
    for label, rows in stats_rows.items():
        assert_rows_agree(rows, reference.describe(whole[label], bounds[label]))
    assert_rows_agree(pair_rows, reference.pairs(whole, SIGNALS, SIZES))


@settings(max_examples=100)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 500),
    kind=st.sampled_from(["smooth", "ties", "constant", "sorted", "backwards"]),
    borders=st.lists(st.integers(0, 500), max_size=8),
    held=st.integers(0, 60),
    splitters=st.integers(1, 40),
)
def test_selection_is_exact_to_the_bit_whatever_the_parts(seed, n, kind, borders, held, splitters):
    """Also where the first part is unlike the rest."""
    rng = np.random.default_rng(seed)
    x = {"ties": lambda: rng.integers(0, 5, (3, n)) / 3.0, "constant": lambda: np.full((3, n), 0.1)}.get(
        kind, lambda: rng.lognormal(size=(3, n))
    )()
    x = np.sort(x)[:, :: -1 if kind == "backwards" else 1] if kind in ("sorted", "backwards") else x
    parts = np.split(x, sorted(b for b in borders if b <= n), axis=1)
    ranks = rng.integers(0, n, 30)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quantile_intervals, "MAX_STORED", held)
        patch.setattr(quantile_intervals, "SPLITTERS", splitters)
        order = quantile_intervals.EMPTY
        for part in parts:
            order = quantile_intervals.add(order, part)
        sought = quantile_intervals.seek(order, ranks)
        found = (
            []
            if quantile_intervals.is_complete(order)
            else [quantile_intervals.collect(sought, part) for part in parts]
        )
        got = quantile_intervals.select(order, sought, ranks, found)
    np.testing.assert_array_equal(got, np.sort(x)[:, ranks])


def test_quantiles_of_many_runs_keep_few_of_them_and_equal_numpy():
    """200,000 runs, a third of them at the horizon: what is kept of a metric is 3 splitters' worth and 2 % of its values."""
    x = np.minimum(RNG.gamma(3.0, size=(2, 200_000)), 3.5)
    order = quantile_intervals.EMPTY
    for part in np.split(x, 50, axis=1):
        order = quantile_intervals.add(order, part)
    at = quantile_intervals.positions(order.n)
    ranks = quantile_intervals.ranks(at, order.n)
    sought = quantile_intervals.seek(order, ranks)
    found = [quantile_intervals.collect(sought, part) for part in np.split(x, 50, axis=1)]
    assert sum(values.size for part in found for values in part) < 0.02 * x.size
    got = quantile_intervals.values_at(at, quantile_intervals.select(order, sought, ranks, found))
    np.testing.assert_array_equal(got[:, 0::3].T, np.quantile(x, [0.05, 0.25, 0.5, 0.75, 0.95], axis=1))
    assert got[0, 12] == got[0, 13] == got[0, 14] == 3.5


def test_two_thousand_chunks_lose_no_digits():
    """Of values that vary by 1e-6 about 1000, one at a time."""
    x = 1000 + 1e-6 * RNG.normal(size=2000)
    whole = {"a": dict.fromkeys(PLAIN, x[None]) | {"diverged": x < 0, "unsettled": x[None] < 0}}
    (row, *_), want = runs_as_rows.summarise(chunks_of(whole, 1)[0], {"a": None}, [], ())[0]["a"], statistics.size(x)
    assert row["mean"] == pytest.approx(want["mean"], rel=1e-14)
    assert row["se"] == pytest.approx(want["se"], rel=1e-6)


def test_numbers_do_not_depend_on_how_the_arrays_lie_in_memory():
    whole = cell(3, 3000, 3, 0.1, "smooth")
    turned = {label: {m: np.asfortranarray(v) for m, v in results.items()} for label, results in whole.items()}
    bounds = dict.fromkeys(whole, np.array([0.5, 0.5]))
    got = [runs_as_rows.summarise(chunks_of(each, 1000)[0], bounds, SIGNALS, SIZES) for each in (whole, turned)]
    assert repr(got[0]) == repr(got[1])


def test_many_runs_are_read_twice_and_few_once():
    for n, want in [(4096, 1), (4097, 2)]:
        chunks, passes = chunks_of(cell(1, n, 2, 0.0, "smooth"), statistics.CHUNK)
        runs_as_rows.summarise(chunks, {"observer-0": None, "observer-1": None}, SIGNALS, SIZES)
        assert len(passes) == want


@pytest.mark.parametrize(
    ("metric", "zero"), [("mae", 1e-13), ("steady_max_abs_error", 1e-13), ("mse", 1e-15), ("steady_mse", 1e-15)]
)
def test_zero_is_a_part_of_the_signals_size_squared_for_squares(metric, zero):
    """Of velocity, of size 0.01: what differs by less than 1e-11 of it is a tie, and what differs by more is not."""
    for times, better in [(0.5, 0.5), (2.0, 1.0)]:
        a = {m: np.zeros((2, 8)) for m in statistics.RUN_METRICS} | {"diverged": np.zeros(8, bool)}
        a["unsettled"] = np.zeros((2, 8), bool)
        b = a | {metric: np.full((2, 8), times * zero)}
        _, rows = runs_as_rows.summarise(chunks_of({"a": a, "b": b}, 8)[0], {"a": None, "b": None}, SIGNALS, SIZES)
        (row,) = (r for r in rows if r["signal"] == "velocity" and r["metric"] == metric)
        assert row["prob_a_better"] == better


def of_a_cell(**observers):
    """Rows of stats of one metric in a cell, and the one row of pairs where there are two observers."""
    rows = [{"observer": o, "mean": m, "n": 64 - lost, "diverged": lost} for o, (m, lost) in observers.items()]
    pair: dict = dict(zip(("observer_a", "observer_b"), observers, strict=True))
    (a, _), (b, _) = observers.values()
    return pd.DataFrame(rows), pair | {
        "n": 64,
        "mean_diff": a - b,
        "p_value": 1e-4,
        "p_holm": 1e-3,
        "prob_a_better": 0.9,
    }


def test_who_diverges_least_wins_before_the_least_mean():
    rows, pair = of_a_cell(steady=(1.0, 0), lost=(0.5, 32))
    assert ranking.standing(rows, pd.DataFrame([pair])[:0]).winner == "steady", "no run of both is needed"
    assert ranking.diverges_more(rows.iloc[0], rows.iloc[1])
    assert not ranking.diverges_more(rows.iloc[1], rows.iloc[0])


def test_one_diverged_run_of_many_may_be_chance():
    rows, pair = of_a_cell(steady=(1.0, 0), lost=(1.0, 1))
    assert not ranking.diverges_more(rows.iloc[0], rows.iloc[1])
    assert ranking.standing(rows, pd.DataFrame([pair | {"p_value": 0.4, "p_holm": 0.4}])).winner == ""


def test_the_worse_does_not_win_by_the_other_ones_chance_loss_of_a_run():
    """It has fewer diverged runs, not surely; and surely the larger error."""
    rows, pair = of_a_cell(steady=(2.0, 0), lost=(1.0, 1))
    assert ranking.standing(rows, pd.DataFrame([pair])).winner == ""
    swapped = pair | {"observer_a": "lost", "observer_b": "steady", "mean_diff": -1.0}
    assert ranking.standing(rows, pd.DataFrame([swapped])).winner == ""


@pytest.mark.parametrize(
    ("found", "wins"),
    [
        ({"p_value": 0.001, "p_holm": 0.049}, True),
        ({"p_value": 0.001, "p_holm": 0.051}, False),  # it is one test of many
        ({"p_value": np.nan, "p_holm": np.nan, "prob_a_better": 1.0}, True),  # nothing varies
        ({"p_value": np.nan, "p_holm": np.nan, "prob_a_better": 0.5}, False),
        ({"p_value": np.nan, "p_holm": np.nan, "prob_a_better": 1.0, "n": 1}, False),  # one run says nothing of others
    ],
)
def test_a_cell_is_won_by_the_adjusted_p_value(found, wins):
    rows, pair = of_a_cell(better=(0.5, 0), worse=(1.0, 0))
    assert ranking.standing(rows, pd.DataFrame([pair | found])).winner == ("better" if wins else "")
