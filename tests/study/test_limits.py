"""Limits are said at the very number: the most is taken, one more is refused."""

import pytest

from pcbench.errors import UserError
from pcbench.scenarios import SCENARIOS
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study import fits, times


def test_a_horizon_has_at_most_so_many_ticks_and_at_least_two():
    tick = 1e-3
    assert times.ticks_of(times.TICKS * tick, tick, "test") == times.TICKS
    with pytest.raises(UserError, match="expected at most 1,000,000 ticks"):
        times.ticks_of((times.TICKS + 1) * tick, tick, "test")
    assert times.ticks_of(2 * tick, tick, "test") == 2
    with pytest.raises(UserError, match="expected at least two ticks"):
        times.ticks_of(tick, tick, "test")


def test_samples_are_counted_by_the_shortest_interval():
    ticks = 1_000_000
    times.require_few_samples([Clock((0,), 10, 0)], ticks, 1e-3, "test")
    for clock in (Clock((0,), 9, 0), Clock((0,), 1000, 0, (9, 1991))):
        with pytest.raises(
            UserError, match=r"a sample every 0\.009 s over 1000 s.*write a sampling_period of at least 0\.01"
        ):
            times.require_few_samples([clock], ticks, 1e-3, "test")


def test_samples_on_their_way_are_counted_by_the_longest_delay():
    ticks = 200_000
    times.require_few_samples([Clock((0,), 2, 20_000)], ticks, 1e-3, "test")
    for clock in (Clock((0,), 2, 20_002), Clock((0,), 2, 20_001, delay_jitter=1)):
        with pytest.raises(UserError, match=r"up to 20\.002 s with samples every 0\.002 s"):
            times.require_few_samples([clock], ticks, 1e-3, "test")


def test_samples_may_be_overtaken_by_so_many_newer_ones_and_no_more():
    times.require_few_samples([Clock((0,), 1, 5, delay_jitter=times.MAX_OOSM_LAG + 1)], 5000, 1e-3, "test")
    with pytest.raises(UserError, match=r"that may arrive after up to 1,001 newer ones"):
        times.require_few_samples([Clock((0,), 1, 5, delay_jitter=times.MAX_OOSM_LAG + 2)], 5000, 1e-3, "test")


@pytest.mark.parametrize(("cells", "ticks"), [(times.CELLS, 100), (100, times.CELL_TICKS // 100)])
def test_cells_are_limited_by_their_number_and_by_all_their_ticks(cells, ticks):
    times.require_few_cells(cells, ticks, "test")
    with pytest.raises(UserError, match=f"expected at most {cells:,}; remove values"):
        times.require_few_cells(cells + 1, ticks, "test")


def test_delays_of_a_gamma_distribution_are_listed_up_to_some_horizons_and_no_further():
    """Of an exponential distribution one sample of 10,000 is later than 9.21 times the mean; a mean of 1e9 s took 67 TiB."""
    scenario = SCENARIOS["cart/white"]
    s = scenario.with_fields(duration=10.0, delay_gamma_mean=10.8)
    fits.fits(s, "test")
    for mean in (10.9, 1e9):
        with pytest.raises(UserError, match=r"expected at most 10 times the duration of 10 s; write a smaller mean"):
            fits.fits(s.with_fields(delay_gamma_mean=mean), "test")
