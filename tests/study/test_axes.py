"""What an axis may hold, at the very edge; sensors as clocks in ticks; what does not go together."""

import numpy as np
import pytest

from pcbench.errors import UserError
from pcbench.observers import OBSERVERS
from pcbench.scenarios import INTERVAL, SCENARIOS
from pcbench.simulation.schedule.sampling import Clock
from pcbench.study import axes, fits, times

CART, TANK, LOOP = (SCENARIOS[name] for name in ("cart/white", "csth/10s", "helicopter/varying"))


def works_on(observer, scenario, where):
    fits.works_on(observer, OBSERVERS[observer], scenario, where)


@pytest.mark.parametrize(
    ("name", "taken", "refused"),
    [
        ("loss", 1, 1.001),
        ("loss", 0, -0.001),
        ("sampling_period", 0.001, 0.0),
        ("sampling_period", 10.0, 10.001),
        ("delay", 0.0, -0.001),
        ("delay", 10.0, 10.001),
        ("delay", 0.037, 0.0375),
        ("sampling_jitter", 0.0, -0.001),
        ("assumed_delay_error", -0.1, -10.001),
        ("noise_std", 1e12, 1.1e12),
        ("noise_std", 1e-12, 1e-13),
        ("parameter_drift", -1.0, float("nan")),
        ("plant.lam", -3.0, float("inf")),
        ("loss", 0.5, True),
    ],
)
def test_a_value_is_taken_up_to_its_edge_and_refused_beyond(name, taken, refused):
    axes.axis_values(name, [taken], CART, "test")
    with pytest.raises(UserError, match=r"^test\[0\]: got .*expected"):
        axes.axis_values(name, [refused], CART, "test")


def test_a_value_for_each_channel_is_as_many_as_there_are_channels():
    assert axes.axis_values("delay", [20.0, [20.0, 50.0, 70.0], "interval"], TANK, "test") == [
        (20.0,) * 3, (20.0, 50.0, 70.0), (INTERVAL,) * 3,
    ]  # fmt: skip
    with pytest.raises(UserError, match="got 2 values, expected one or 3"):
        axes.axis_values("delay", [[20.0, 50.0]], TANK, "test")
    with pytest.raises(UserError, match="got a value twice"):
        axes.axis_values("delay", [20.0, [20.0, 20.0, 20.0]], TANK, "test")


def test_channels_of_the_same_period_and_delay_are_one_clock_in_ticks():
    assert times.clocks(TANK) == [Clock((j,), 1, d) for j, d in enumerate((2, 5, 7))]
    mixed = TANK.with_fields(
        delay=(20.0, 50.0, 20.0), sampling_jitter=10.0, delay_jitter=30.0, loss=0.2, sampling_pattern=(10.0, 30.0)
    )
    rest = ((1, 3), 1, 3, 0.2)
    assert times.clocks(mixed) == [Clock((0, 2), 1, 2, *rest), Clock((1,), 1, 5, *rest)]
    (clock,) = times.clocks(LOOP)
    assert (clock.channels, clock.period, clock.delay, clock.early) == ((0, 1), 200, 30, True)
    assert clock.delay_sine == pytest.approx((15.0, 2e-3))


def test_commands_are_as_late_as_samples_unless_said_and_swing_with_them():
    t = np.array([0.0, 0.4, 3.0])
    np.testing.assert_allclose(times.actuator_delay(LOOP)(t), 0.03 + 0.015 * np.sin(2 * t), rtol=1e-15)
    other = LOOP.with_fields(actuator_delay=0.1)
    np.testing.assert_allclose(times.actuator_delay(other)(t), 0.1 + 0.015 * np.sin(2 * t), rtol=1e-15)


def test_commands_are_never_less_than_half_a_tick_late_as_their_delay_swings():
    """Ticks of 1 ms: the least delay of 0.6 ms is taken, one of 0.4 ms refused."""
    fits.fits(LOOP.with_fields(actuator_delay=0.0156), "test")
    for swung in ({"actuator_delay": 0.0154}, {"delay": (0.0154, 0.0154)}):
        with pytest.raises(
            UserError, match=r"expected at least half a tick on the way to the plant.*write at least 0\.016"
        ):
            fits.fits(LOOP.with_fields(**swung), "test")
    fits.fits(LOOP.with_fields(actuator_delay=0.03, delay=(0.0152, 0.0152)), "test")


@pytest.mark.parametrize(
    ("observer", "takes", "refuses"),
    [
        ("kfbo", {"loss": 0.1, "sampling_jitter": 0.01}, {"delay_jitter": 0.01}),
        ("kfbo", {"delay": (INTERVAL,)}, {"delay": (INTERVAL,), "sampling_pattern": "sine"}),
        ("kfbo", {"sampling_pattern": "sine"}, {"delay": (INTERVAL,), "sampling_jitter": 0.01}),
        ("chain", {"loss": 0.1}, {"delay_jitter": 0.2}),
        ("chain", {}, {"sampling_jitter": 0.01}),
        ("chain", {}, {"sampling_pattern": (0.2, 0.4)}),
    ],
)
def test_an_observer_is_given_the_schedules_that_it_takes_and_no_other(observer, takes, refuses):
    works_on(observer, CART.with_fields(**takes), "test")
    with pytest.raises(UserError, match=f"test: {observer} in cart/white got .*leave {observer} out"):
        works_on(observer, CART.with_fields(**refuses), "test")


def test_a_nonlinear_plant_is_given_to_observers_that_need_no_linear_model():
    for observer in ("ekf", "high-gain"):
        works_on(observer, LOOP, "test")
    with pytest.raises(UserError, match=r"kf in helicopter/varying got a nonlinear plant.*use one of high-gain, .*ekf"):
        works_on("kf", LOOP, "test")


def test_one_clock_is_one_period_and_one_delay():
    for changes in ({}, {"delay": (20.0,) * 3, "sampling_period": (10.0, 20.0, 10.0)}):
        with pytest.raises(UserError, match="pccebo in csth/10s got channels that differ"):
            works_on("pccebo", TANK.with_fields(**changes), "test")
    works_on("pccebo", TANK.with_fields(delay=(20.0,) * 3), "test")
    works_on("kf", TANK, "test")


def test_what_measures_at_every_stage_has_no_schedule_and_no_noise():
    sine = SCENARIOS["arm/sine"]
    fits.fits(sine, "test")
    for changes in (
        {"delay": (1e-4, 0.0)},
        {"noise_std": (0.0, 1e-3)},
        {"loss": 0.1},
        {"sampling_period": (1e-4, 2e-4)},
        {"sampling_phase": 0.1},
        {"outage_duration": 1.0},
    ):
        with pytest.raises(UserError, match="measurements are continuous and without noise"):
            fits.fits(sine.with_fields(**changes), "test")
