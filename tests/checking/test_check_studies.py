"""The checks of a study, of an observer in a loop, and what `check` finds out by itself."""

from pathlib import Path

import own_observer as mine
import pytest
from loops import Q1, Q2, study

from pcbench import checking
from pcbench.checking import observer, targets
from pcbench.checking import study as of_studies
from pcbench.checking.observer_fixtures import Candidate
from pcbench.checking.targets import CheckNote, SkipCheck
from pcbench.errors import UserError
from pcbench.observers import ObserverSpec
from pcbench.study import parse

SHORT = {"duration": 0.4, "steady_start": 0.1}
LQR = {"use": "lqr", "Q1": Q1, "Q2": Q2}
ENTRY = ObserverSpec(mine.nudge, mine.Options, mine.design, True, "a share of a late innovation", "one clock")
SLIP = mine.nudge._replace(flow=lambda gains, memory, now: gains.Phi @ memory + gains.Gamma @ now.past_u(1))
FREE = {"name": "t", "observers": ["kf", "model-only"], "lti": {
    "A": [[0.0, 1.0], [-2.0, -0.5]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]], "x0": [1.0, 0.0], "sampling_period": 0.05,
    "delay": 0.05, "noise_std": 0.01, "tick": 0.01, "duration": 0.4, "steady_start": 0.1,
}}  # fmt: skip


def free(observers=("kf", "model-only"), **lti):
    return FREE | {"observers": list(observers), "lti": FREE["lti"] | lti}


def run_check(check, raw):
    return of_studies.CHECKS[check](parse.grid_of(raw, {}, []))


@pytest.mark.ci
def test_a_sound_study_passes_every_check():
    found = of_studies.findings(study(LQR, **SHORT))
    assert [f.check for f in found] == ["reads", *of_studies.CHECKS]
    assert {f.verdict for f in found} == {"passes"}, found
    assert found[0].why == "lti: 1 cell; kf"
    assert found[3].why == "no error in lti: kf"


def test_a_study_that_cannot_be_read_says_where_and_nothing_more():
    first, *others = of_studies.findings(free(observers=["dkff"]))
    assert (first.check, first.verdict) == ("reads", "fails")
    assert "did you mean 'kf'?" in first.why
    assert {f.verdict for f in others} == {"skipped"}


def test_a_refusal_of_gains_is_named_with_its_cell():
    raw = free(["kf"], C=[[0.0, 1.0]], A=[[0.0, 1.0], [0.0, -0.5]]) | {"axes": {"noise_std": [0.01, 0.02]}}
    with pytest.raises(
        UserError, match=r"got a refusal of kf in lti: '.* mode 0 is undetectable .*', expected gains in every"
    ):
        run_check("gains", raw)
    assert (
        run_check("gains", free() | {"axes": {"noise_std": [0.001 * i for i in range(1, 21)]}})
        == "found in 6 of 20 cells"
    )


def test_a_loop_that_does_not_settle_is_named_with_its_eigenvalue():
    bad = {"use": "state-feedback", "K": [[0.0] * 3] * 2}
    with pytest.raises(UserError, match="state-feedback does not stabilise the plant of lti"):
        run_check("settles", study(bad, **SHORT))


@pytest.mark.ci
def test_a_slip_of_a_tick_is_found_in_a_study_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = Path(mine.__file__).read_text().replace("now.u,\n", "now.past_u(1),\n")
    (tmp_path / "slipped.py").write_text(text)
    with pytest.raises(UserError, match=r"got, from nudge in lti, an error of .* at tick [12], expected none"):
        run_check("perfect start", free(["slipped.py:nudge", "kf"]))


@pytest.mark.ci
def test_runs_that_leave_the_bound_are_a_note_and_a_plant_that_leaves_all_fails(folder):
    with pytest.raises(
        CheckNote, match=r"the error exceeds the divergence threshold of model-only in lti \(3 of 3 runs\)"
    ):
        run_check("runs", free(["model-only"], divergence_threshold=0.5))
    timing = {"dt": 0.001, "sampling_period": 0.01, "delay": 0.0, "noise_std": 0.1, "duration": 0.1}
    table = {"plant": "four.py:burst", "x0": [1.0], "observers": ["model-only"], "input": "zero"} | timing
    with pytest.raises(UserError, match=r"got a plant of t that is not finite after 0\.01\d* s"):
        run_check("runs", {"name": "t", "scenario": table})


def in_lqr(entry, **changes):
    s = parse.grid_of(study(LQR, **SHORT), {}, []).cells[0].scenario
    return observer.closed_loop(Candidate("mine", entry, mine.Options()), s.with_fields(**changes))


@pytest.mark.ci
def test_an_observer_that_slips_in_a_loop_has_an_error_or_says_so_and_stays_within_the_bound():
    slipped = ENTRY._replace(observer=SLIP)
    with pytest.raises(UserError, match=r"closed loop: got, in lti under lqr, an error of .* at tick 1, expected none"):
        in_lqr(slipped)
    modest = slipped._replace(knows_schedule=False)
    assert in_lqr(modest) == "its error in lti under lqr stays below the divergence threshold"
    with pytest.raises(
        UserError, match=r"an error beyond the scenario's divergence threshold at tick 1, expected one that stays"
    ):
        in_lqr(modest, divergence_threshold=1e-9)


@pytest.mark.nightly
def test_an_observer_that_knows_the_schedule_has_no_error_in_a_loop():
    assert in_lqr(ENTRY) == "no error in lti under lqr"


FILE = """
import jax.numpy as jnp
import pcbench
from pcbench.controllers import CONTROLLERS, lqr, state_feedback
from pcbench.observers import OBSERVERS
watch = OBSERVERS["model-only"]
law = state_feedback.PLAIN
prepare = lambda options, context: ()
common = {"output": lambda p, now, x: x, "states": ["x"], "operating_point": ([0.0], [0.0])}
fall = pcbench.make_plant(field=lambda p, now, x: now.u - x, **common)
burst = pcbench.make_plant(field=lambda p, now, x: now.u + 100 * x**2, **common)
late = {"base": "cart/white", "delay": 0.4}
number = 3
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "four.py").write_text(FILE)
    return tmp_path


@pytest.mark.ci
def test_what_a_name_stands_for_is_found_out(folder):
    for name, kind in (("watch", "observer"), ("law", "controller"), ("fall", "plant"), ("late", "scenario")):
        assert targets.kind_of(f"four.py:{name}") == kind
    assert {targets.kind_of(name) for name in ("motor.toml", "cart/white", "quick")} == {"study"}
    with pytest.raises(UserError) as said:
        checking.check("four.py:number")
    each = str(said.value)
    assert each.startswith("check: got a int called number, expected an observer (a pcbench.Observer")
    for kind in ("a plant (", "a controller (", "a scenario ("):
        assert kind in each
    with pytest.raises(
        UserError, match="'fell' is no observer, plant, controller or scenario there; did you mean 'fall'"
    ):
        checking.check("four.py:fell")


MISTAKES = {
    "a scenario of another plant": (("four.py:fall", "cart/white", {}), "whose plant is cart, expected a scenario of fall"),
    "a number of no plant": (("four.py:fall", None, {"mass": 1.0}), "'mass' is no number of fall"),
    "a scenario for a study": (("cart/white", "cart/white", {}), "got 'cart/white' for a study, expected none"),
    "no file": (("motor.toml", None, {}), "motor.toml: there is no such file"),
    "no scenario": (("four.py:watch", "cart/wite", {}), "check --scenario: 'cart/wite' is no scenario; did you mean"),
    "two scenarios": (("four.py:watch", "quick", {}), "expected one here; name a scenario"),
}  # fmt: skip


@pytest.mark.parametrize("name", MISTAKES)
def test_what_cannot_be_asked_is_one_sentence(folder, name):
    given, sentence = MISTAKES[name]
    with pytest.raises(UserError, match=sentence):
        checking.check(*given)


@pytest.mark.nightly
def test_each_kind_is_asked_what_it_should_be(folder):
    """A plant with a scenario of its own, a scenario as data, an observer in a loop that a file says."""
    (folder / "fall.toml").write_text(
        '[scenario]\nplant = "four.py:fall"\nx0 = [1.0]\ndt = 0.01\nsampling_period = 0.05\ndelay = 0.05\nnoise_std = 0.01\n'
        'observers = ["kf"]\n[controller]\nuse = "lqr"\nQ1 = 1.0\nQ2 = 1.0\n'
    )
    found = checking.check("four.py:fall", "fall.toml")
    assert (found.kind, found.label, found.scenario) == ("plant", "fall", "fall")
    assert any("a tick of 0.01 s" in f.why for f in found.findings)
    found = checking.check("four.py:late")
    assert (found.kind, found.label) == ("scenario", "late")
    assert {f.verdict for f in found.findings} == {"passes", "skipped"}
    found = checking.check("four.py:watch", "fall.toml")
    assert found.findings[-1].check == "closed loop"
    assert {f.verdict for f in found.findings} == {"passes"}


@pytest.mark.ci
def test_an_inexact_observer_of_pcbench_is_said_and_is_no_mistake_of_the_study(monkeypatch):
    monkeypatch.setattr(of_studies, "ROUNDING", -1.0)  # of which every observer has more
    with pytest.raises(
        CheckNote, match=r"an error remains of kf in lti \(.* of the largest state\).*use a shorter tick"
    ):
        run_check("perfect start", free(["kf"]))


STIFF = """
from typing import NamedTuple
import jax.numpy as jnp
import pcbench
class Numbers(NamedTuple):
    k: float = 2000.0
def field(n, now, x):
    return jnp.stack([x[1], n.k * (1 - x[0] ** 2) * x[1] - x[0] + now.u[0]])
stiff = pcbench.make_plant(
    field=field,
    output=lambda n, now, x: x[:1],
    states=["a [m]", "b [m/s]"],
    numbers=Numbers(),
    operating_point=([0.0, 0.0], [0.0]),
    summary="stiff",
)
"""


@pytest.mark.ci
def test_a_plant_that_is_not_finite_is_not_blamed_on_observers(tmp_path, monkeypatch):
    (tmp_path / "stiff.py").write_text(STIFF)
    monkeypatch.chdir(tmp_path)
    scenario = {"plant": "stiff.py:stiff", "x0": [2.0, 3.0], "dt": 1e-3, "sampling_period": 0.1, "delay": 0.1}
    scenario |= {"noise_std": 0.1, "duration": 2.0}
    with pytest.raises(SkipCheck, match="the state of st is not finite without noise"):
        run_check("perfect start", {"name": "st", "observers": ["ekf", "ukf"], "scenario": scenario})
