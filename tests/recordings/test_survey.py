"""What `pcbench info` says of a log is what loops over its rows say, whatever parts it comes in."""

import numpy as np
import pytest
from logged import log_of
from reference.logs import delays

import pcbench
from pcbench.errors import UserError
from pcbench.recordings import running_stats
from pcbench.recordings.survey import channel_rows, survey


def draw_samples(seed, many=60, doubled=3):
    """Samples of one channel, late and out of sequence, some of them twice; in the order in which they arrive."""
    rng = np.random.default_rng(seed)
    taken = np.cumsum(rng.integers(1, 6, many))
    arrives = taken + rng.integers(0, 25, many)
    every = [(0, int(t), int(a)) for t, a in zip(taken, arrives, strict=True)]
    every += [(0, every[i][1], every[i][2] + 3) for i in rng.choice(many, doubled, False)]
    return sorted(every, key=lambda s: s[2])


@pytest.mark.parametrize("seed", range(5))
def test_rates_delays_and_orders_are_those_of_loops(seed):
    samples = draw_samples(seed)
    (row,) = channel_rows(survey(log_of(samples, 0.1, channels=1, part=1000)))
    late = np.array([(a - t) * 0.1 for _, t, a in samples])
    behind, doubled = delays([(t, a) for _, t, a in samples])
    assert (row["samples"], row["out_of_order"], row["doubled"]) == (len(samples), behind, doubled)
    apart = np.diff(sorted({t for _, t, _ in samples})) * 0.1
    expected = [late.mean(), late.min(), late.max(), *np.quantile(late, [0.05, 0.5, 0.95]), apart.min(), apart.max()]
    names = [
        "delay_mean",
        "delay_least",
        "delay_most",
        "delay_p05",
        "delay_median",
        "delay_p95",
        "interval_least",
        "interval_most",
    ]
    np.testing.assert_allclose([row[name] for name in names], expected, rtol=1e-10)


def test_parts_change_nothing_that_is_counted():
    samples = draw_samples(7, 200)
    whole, parts = (channel_rows(survey(log_of(samples, part=part)))[0] for part in (1000, 41))
    same = ["samples", "lost", "delay_mean", "delay_median", "out_of_order", "drift_ppm", "first", "last"]
    np.testing.assert_allclose([whole[k] for k in same], [parts[k] for k in same], rtol=1e-9)


def test_a_gap_a_jump_and_a_drift_are_found_with_their_rows():
    t = np.arange(100.0)
    t[60:] += 30
    late = 0.3 + 1e-4 * t + 0.001 * np.cos(t)
    late[80] += 0.9
    found = survey(log_of([(0, a, a + b) for a, b in zip(t, late, strict=True)], channels=1))
    (row,) = channel_rows(found)
    assert (row["gaps"], row["longest_gap"], row["longest_gap_row"]) == (1, 31.0, 61)
    assert (row["jumps"], row["largest_jump_row"]) == (2, 81)
    slope = np.polyfit(t, late, 1)[0]
    assert row["drift_ppm"] == pytest.approx(-1e6 * slope, rel=1e-8)
    assert abs(row["drift_ppm"] + 100) < 4 * row["drift_ppm_se"]


def test_a_clock_that_is_fast_in_a_simulation_is_fast_in_its_log(tmp_path):
    plant = {
        "A": [[-1.0]],
        "B": [[1.0]],
        "C": [[1.0]],
        "tick": 0.01,
        "sampling_period": 0.1,
        "delay": 0.2,
        "noise_std": 0.1,
        "duration": 40,
    }
    study = {"name": "fast", "observers": ["model-only"], "lti": plant, "axes": {"clock_skew": [5000.0]}}
    pcbench.simulate(study, ["model-only"], log=tmp_path / "log")
    drift = pcbench.info(tmp_path / "log").drift_ppm[0]
    assert drift == pytest.approx(1e6 * 5e-3 / (1 + 5e-3), rel=5e-3)  # beside the stamps' own clock


def test_a_lost_sample_is_counted_and_has_no_delay():
    (row,) = channel_rows(survey(log_of([(0, 0, 3), (0, 5, None), (0, 10, 14)], channels=1)))
    assert (row["samples"], row["lost"], row["delay_mean"]) == (3, 1, 3.5)


def test_how_far_a_row_is_behind_is_known_across_parts():
    assert survey(log_of([(0, 50, 60), (1, 3, 70), (0, 55, 71)], part=1)).behind == 47
    assert survey(log_of([(0, 1, 6), (1, 3, 7)])).behind == 0


def test_an_empty_log_is_one_sentence():
    with pytest.raises(UserError, match="got no samples"):
        survey(log_of([]))


def test_a_selection_of_many_numbers_is_even():
    numbers = np.random.default_rng(1).normal(size=200_000)
    found = running_stats.RunningStats()
    for part in np.array_split(numbers, 37):
        found = running_stats.add(found, part, part)
    assert (found.many, found.least, found.most) == (200_000, numbers.min(), numbers.max())
    assert found.mean == pytest.approx(numbers.mean(), rel=1e-10)
    np.testing.assert_array_equal(found.selection[:, 1], numbers[:: found.stride])
    assert len(found.selection) <= running_stats.MOST
