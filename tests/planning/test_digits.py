"""A state too large for the digits of its errors is said to be that, and no observer is judged; others keep their numbers."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from reference.long_digits import steady_rms

import pcbench
from pcbench import planning
from pcbench.cli.commands import app
from pcbench.dataset import validate_exact
from pcbench.errors import DigitsError
from pcbench.external import score
from pcbench.observers import entry_of
from pcbench.planning import digits
from pcbench.plants import PLANTS
from pcbench.study import parse, serialize

pytestmark = pytest.mark.usefixtures("in_a_hurry")

A, H, PERIOD, DELAY, NOISE, PUSH = 4.0, 0.02, 2, 2, 0.1, 0.01
LTI = {
    "A": [[A]], "B": [[1.0]], "C": [[1.0]], "tick": H, "sampling_period": PERIOD * H, "delay": DELAY * H, "noise_std": NOISE,
    "process_std": [PUSH], "x0": [0.0], "prior_std": [1.0], "divergence_threshold": 1e12, "input": "zero",
}  # fmt: skip
RANDOM = {"scenario": {"random_initial_state": True, "consistency": True}}
BLAMELESS = "fewer than two digits of the errors are left, for any observer"
STEADY = {"A": [[0.0]], "process_std": None, "duration": 3.0}


class Wobble(NamedTuple):
    """The numbers of a nonlinear plant."""

    wobble: float = 1.0


def study(observers=("kf", "ekf"), seeds=16, options=RANDOM, **changes):
    lti = {name: value for name, value in (LTI | changes).items() if value is not None}
    return {"name": "long", "seeds": seeds, "observers": list(observers), "options": options, "lti": lti}


def right(horizon):
    """What the errors are, in 80 digits: over the tail of a run of this length, which begins at three tenths."""
    ticks = round(horizon / H)
    return steady_rms(A, H, 1.0, PUSH, NOISE, PERIOD, DELAY, ticks, round(0.3 * ticks))


def value(stats, metric):
    return stats[stats.metric == metric].set_index("observer")["mean"]


@pytest.mark.slow
def test_numbers_are_right_as_long_as_a_double_has_digits(tmp_path):
    """At e^24 the state is 3e10 and the right error 0.1; exact moments need more digits, say so, and blame no run."""
    want, last = right(6.0)
    stats = pcbench.run(study(seeds=256, duration=6.0), out=tmp_path / "o").stats
    for observer in ("kf", "ekf"):
        rms = stats[(stats.metric == "steady_pooled_rmse") & (stats.observer == observer)].iloc[0]
        assert abs(rms["mean"] - want) < 4 * rms["se"]
        assert rms["mean"] * value(stats, "rms_efficiency")[observer] == pytest.approx(want, rel=1e-6)
        assert value(stats, "mse").notna().all()
        assert abs(value(stats, "nees")[observer] - 1) < 4 * np.sqrt(2 / 256)
    checked = validate_exact.check(tmp_path / "o")
    assert checked.rows.empty
    assert all("has too few digits for an exact answer: x1 reaches" in sentence for sentence in checked.refusals)
    assert last > 0


@pytest.mark.parametrize(
    ("observer", "horizon"),
    [
        ("kf", 9.5),
        *(
            pytest.param(o, h, marks=pytest.mark.ci)
            for o, h in [("ekf", 9.5), ("kf-reprocess", 9.5), ("kf", 8.0), ("kf", 17.0)]
        ),
    ],
)
def test_no_observer_is_judged_where_a_double_has_no_digits_left(observer, horizon):
    """At e^32 two digits are left, at e^38 none, at e^68 all runs leave the bound. Beyond e^69 [lti] is refused."""
    with pytest.raises(DigitsError, match=BLAMELESS) as error:
        pcbench.run(study([observer], duration=horizon))
    assert str(error.value).startswith("lti, cell 0: x1 reaches")


@pytest.mark.ci
def test_the_command_ends_with_the_sentence(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "s.toml").write_text(serialize.to_toml(*parse.grid_of(study(["kf"], duration=9.5), {}, [])))
    with pytest.raises(DigitsError, match="shorter duration"):
        app(["run", "s.toml"], standalone_mode=False)


def closed_loop(observer, seeds):
    return study([observer], seeds, duration=9.5, input=None) | {"controller": {"use": "lqr", "Q1": [1.0], "Q2": 1.0}}


@pytest.mark.slow
def test_a_loop_that_is_stabilised_has_the_errors_of_the_filter():
    """The same plant and horizon with feedback: what the filter is off by does not depend on the input."""
    stats = pcbench.run(closed_loop("ekf", 256)).stats
    rms = stats[stats.metric == "steady_pooled_rmse"].iloc[0]
    assert abs(rms["mean"] - right(9.5)[0]) < 4 * rms["se"]


@pytest.mark.parametrize(
    ("start", "noise", "resolved"),
    [
        (1e12, 1e-5, False),
        pytest.param(1e9, 1e-7, False, marks=pytest.mark.ci),
        pytest.param(1e6, 1e-3, True, marks=pytest.mark.ci),
    ],
)
def test_a_large_offset_counts_beside_the_errors(start, noise, resolved):
    given = study(**STEADY | {"x0": [start], "xhat0": [start], "prior_std": [10 * noise], "noise_std": noise})
    if resolved:
        assert value(pcbench.run(given).stats, "steady_pooled_rmse").between(0.1 * noise, noise).all()
    else:
        with pytest.raises(DigitsError, match="origin near the state"):
            pcbench.run(given)


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["kf-drop-delayed", "kf-reprocess"])
def test_an_observer_that_keeps_the_response_without_feedback_says_so(observer):
    """There its error is 20 times too large at e^38, by rounding of what it keeps."""
    with pytest.raises(DigitsError, match=f"lti, cell 0: {observer} keeps the response of x1 to the input"):
        pcbench.run(closed_loop(observer, 16))
    with pytest.raises(DigitsError, match=f"lti, cell 0: {observer} keeps the response of x1 to the input"):
        pcbench.simulate(closed_loop(observer, 16), [observer])


@pytest.mark.ci
def test_exact_moments_name_the_response_that_is_kept_without_feedback():
    """The deviation from linear maps is 1e-7 of the error, by rounding: the filter is affine."""
    exact = pcbench.exact_moments("ncs-reactor/round-robin", observers=["kf-reprocess"])
    (reason,) = exact.stats.query("metric == 'steady_mse'").reason.unique()
    assert "kf-reprocess keeps the response of x1 to the input without the feedback, which grows to about" in reason


@pytest.mark.slow
def test_an_error_that_decays_to_rounding_is_zero_for_every_purpose():
    """A lag without noise behind a noisy integrator, and no noise at all."""
    lag = {"A": [[0.0, 1.0], [0.0, -40.0]], "B": [[0.0], [40.0]], "C": [[1.0, 0.0]], "x0": [0.0, 1.0]}
    lag |= {"prior_std": [1.0, 1.0], "process_std": [0.01, 0.0], "input": "sine", "duration": 8.0}
    assert value(pcbench.run(study(["kf"], **lag)).stats, "steady_mse").notna().all()
    quiet = STEADY | {"A": [[-4.0]], "noise_std": 0.0, "x0": [5.0], "xhat0": [5.5], "input": "sine", "duration": 16.0}
    assert value(pcbench.run(study(["ekf"], options={}, seeds=1, **quiet)).stats, "steady_mse").max() < 1e-20


@pytest.mark.slow
def test_the_measurement_of_the_last_state_is_traced_once_for_all_calls_of_a_cell(monkeypatch):
    """It is asked for after each call in which errors are small beside the state; 300,000 seeds are 293 calls."""
    asked, traced = [], []
    for name, calls in (("_matters", asked), ("present", traced)):
        f = getattr(digits, name)
        monkeypatch.setattr(digits, name, lambda *given, f=f, calls=calls: calls.append(1) or f(*given))
    pcbench.run({"name": "calls", "scenarios": ["cart/gaussian"], "observers": ["kf", "kfbo"], "seeds": 4096})
    assert len(asked) > 1, "no case in which it is asked for twice"
    assert len(traced) <= 1


@pytest.mark.ci
def test_a_model_without_feedback_is_as_far_off_as_the_plant_grows():
    """Its error is a part of the state, so it keeps all digits where a filter has none: 0.2 e^38 at the end."""
    started = study(
        ["model-only"],
        options={},
        seeds=1,
        duration=9.5,
        x0=[1.0],
        xhat0=[0.8],
        process_std=None,
        divergence_threshold=1e12,
    )
    stats = pcbench.run(started).stats
    assert (stats[stats.metric == "divergence_rate"]["mean"] == 1.0).all()


@pytest.mark.ci
def test_an_unstable_nonlinear_plant_is_said_to_be_that(monkeypatch):
    def field(p, now, x):
        return A * x + p.wobble * jnp.sin(x) + now.u

    entry = pcbench.make_plant(
        field=field,
        output=lambda p, now, x: x,
        states=["level [m]"],
        numbers=Wobble(),
        operating_point=([0.0], [0.0]),
        summary="a runaway",
    )
    monkeypatch.setitem(PLANTS, "runaway", entry)
    table = {
        "plant": "runaway",
        "dt": H,
        "x0": [1.0],
        "xhat0": [0.9],
        "prior_std": [0.1],
        "input": "zero",
        "divergence_threshold": 1e12,
    }
    table |= {"sampling_period": PERIOD * H, "delay": DELAY * H, "noise_std": NOISE}
    for horizon in (5.0, 9.5):
        given = {"name": "r", "seeds": 4, "observers": ["ekf"], "scenario": table | {"duration": horizon}}
        if horizon == 5.0:
            assert value(pcbench.run(given).stats, "steady_mse").max() < 1.0
            continue
        with pytest.raises(DigitsError, match=r"level reaches \S+ m, where"):
            pcbench.run(given)


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["kf-drop-delayed", "kf-reprocess"])
def test_nor_is_the_trace_of_a_run(observer):
    with pytest.raises(DigitsError, match=BLAMELESS):
        pcbench.simulate(study([observer], duration=9.5), observer)
    frame = pcbench.simulate(study([observer], duration=4.0), observer)
    assert np.isfinite(frame[f"{observer}.x1"]).all()


def test_estimates_that_are_made_elsewhere_are_not_judged_either():
    (cell,) = parse.grid_of(study(["kf"], duration=9.5), {}, []).cells
    p = planning.draft(cell, {"kf": entry_of("kf").options()})
    ticks = cell.times.ticks
    x = np.exp(A * H * np.arange(ticks + 1.0))[None, :, None] * np.ones((3, 1, 1))
    with pytest.raises(DigitsError, match=BLAMELESS):
        score.compute_metrics(p, x, x[:, :ticks] + 0.05)
    assert score.compute_metrics(p, x, 0.8 * x[:, :ticks])["diverged"].all()


@pytest.mark.ci
def test_exact_moments_say_where_they_have_too_few_digits():
    """At e^8 they are those of 80 digits; at e^12 squares of the state have six digits more than squares of the errors."""
    stats = pcbench.exact_moments(study(duration=2.0)).stats
    np.testing.assert_allclose(value(stats, "steady_pooled_rmse"), right(2.0)[0], rtol=1e-7)
    stats = pcbench.exact_moments(study(duration=4.0)).stats
    reasons = stats[stats.metric == "mse"].reason
    assert reasons.str.contains("has too few digits for an exact answer: x1 reaches").all()
    assert value(stats, "steady_pooled_rmse").isna().all()


TABLE = """
name = "known"
observers = ["kf"]
seeds = 4
[scenario]
plant = "cart"
x0 = [0.0, 0.0]
prior_std = [0.0, 1.0]
sampling_period = 0.2
delay = 0.2
noise_std = 0.1
duration = 2.0
"""


@pytest.mark.ci
def test_a_state_that_is_known_at_the_start_has_a_settling_band_of_its_size(tmp_path):
    (tmp_path / "known.toml").write_text(TABLE)
    (cell,) = parse.grid_of(str(tmp_path / "known.toml"), {}, []).cells
    assert min(cell.scenario.scoring.settle_band) > 0
    assert np.isfinite(pcbench.run(str(tmp_path / "known.toml")).stats["mean"].iloc[0])


def still(observer, prior, **changed):
    """A start known exactly, and a state that forgets the noise at once: its error is 0 but for rounding."""
    plant = {
        "A": [[0.0, 1.0], [0.0, -122.0]],
        "B": [[0.0], [355.0]],
        "C": [[1.0, 0.0]],
        "tick": 0.001,
        "noise_std": 0.6,
    }
    times = {"sampling_period": 0.2, "delay": 0.2, "x0": [5.0, 10.0], "xhat0": [5.0, 10.0], "duration": 2.0}
    return {
        "name": "x",
        "observers": [observer],
        "seeds": 64,
        "lti": plant | times | {"prior_std": [prior] * 2} | changed,
    }


@pytest.mark.ci
@pytest.mark.parametrize(
    ("observer", "prior", "changed"),
    [("kf", 100.0, {}), ("ekf", 1.0, {}), ("ekf", 100.0, {"loss": 0.3})],
    ids=["kf", "ekf", "ekf with loss"],
)
def test_an_error_that_is_0_but_for_rounding_is_no_sign_of_a_bend(observer, prior, changed):
    """Its deviation from where linear maps put it was divided by itself, which is rounding too."""
    study = still(observer, prior, **changed)
    exact = pcbench.exact_moments(study).stats.query("metric == 'pooled_rmse'").set_index("signal")["mean"]
    runs = pcbench.run(study).stats.query("metric == 'pooled_rmse'").set_index("signal")
    assert exact["x2"] < 1e-12
    assert runs["mean"]["x2"] < 1e-12
    assert abs(exact["x1"] - runs["mean"]["x1"]) < 5 * runs["se"]["x1"]
