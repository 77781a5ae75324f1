"""The checks of a user's observer: every built-in one passes, and each broken one fails exactly the check it should."""

import itertools
import re

import jax
import jax.numpy as jnp
import numpy as np
import own_observer as own
import pytest

from pcbench.checking import jaxpr_checks
from pcbench.checking.observer import CHECKS, findings, no_shift, record
from pcbench.checking.observer_fixtures import Candidate, trial
from pcbench.errors import UserError
from pcbench.observers import OBSERVERS, ObserverSpec
from pcbench.scenarios import SCENARIOS
from pcbench.synthesis.certificate import Design

WHERE = {"smo": "arm/sampled", "pio": "arm/sampled", "high-gain": "helicopter/constant"}  # what they are made for
QUICK = ("model-only", "kfbo", "no-delay")
ENTRY = ObserverSpec(own.nudge, own.Options, own.design, True, "a share of a late innovation", "one clock")
SEEN, SHARE, TIMES, COUNT = [], [0.1], [np.array([1])], itertools.count()


def verdicts(entry, scenario="cart/white"):
    return {f.check: f for f in findings(Candidate("mine", entry, entry.options()), SCENARIOS[scenario])}


def failing(found):
    return {f.check: f.why for f in found.values() if f.verdict == "fails"}


@pytest.mark.parametrize(
    "name", [pytest.param(o, marks=pytest.mark.nightly) if o not in QUICK else o for o in OBSERVERS]
)
def test_every_built_in_observer_passes(name):
    found = verdicts(OBSERVERS[name], WHERE.get(name, "cart/white"))
    assert not failing(found)
    if OBSERVERS[name].knows_schedule and name not in ("smo", "pio"):
        assert found["perfect start"].verdict == "passes"


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("name", "scenario"),
    [("ekf", "helicopter/constant"), ("kf", "csth/10s-noise"), ("chain", "csth/10s-noise"), ("kf", "arm/sampled")],
)
def test_they_pass_on_other_plants_too(name, scenario):
    assert not failing(verdicts(OBSERVERS[name], scenario))


@pytest.mark.ci
def test_an_observer_of_ones_own_passes_every_check():
    found = verdicts(ENTRY)
    assert list(found) == ["design", *CHECKS]
    assert {f.verdict for f in found.values()} == {"passes"}
    assert "6 schedules" in found["perfect start"].why


def narrow(gains, memory, now, arrival):
    late = (arrival.value - arrival.snapshot).astype(jnp.float32).astype(float)
    return memory + gains.L @ jnp.where(arrival.mask, late, 0.0)


def kept(gains, memory, now, arrival):
    SEEN.append(arrival.value)
    return own.correct(gains, memory, arrival)


def counted(gains, memory, now):
    return gains.Phi @ memory + gains.Gamma @ now.u + 1e-300 * next(COUNT)


def by_global(gains, memory, now, arrival):
    return memory + SHARE[0] * gains.C.T @ jnp.where(arrival.mask, arrival.value - arrival.snapshot, 0.0)


def sets_global(context, options):
    SHARE[0] = 0.1 / (1 + sum(context.noise_std))
    return own.design(context, options)


def by_global_table(gains, memory, now, arrival):
    late = jnp.where(arrival.mask, arrival.value - arrival.snapshot, 0.0)
    return memory + gains.L @ (jnp.asarray(TIMES[0]) * late)


def sets_global_table(context, options):
    TIMES[0] = np.array([1 + int(sum(context.noise_std) > 1)])
    return own.design(context, options)


def written(gains, memory, now, arrival):
    gains = gains._replace(L=jnp.array([[0.07], [0.3]]))
    return own.correct(gains, memory, arrival)


def called_back(gains, memory, now, arrival):
    y = jax.pure_callback(lambda y: np.asarray(y), jax.ShapeDtypeStruct((1,), float), arrival.value)
    return own.correct(gains, memory, arrival._replace(value=y))


def knows_the_present(gains, memory, now, arrival):
    L = gains.L * (1 + 1e-3 * now.past_u(arrival.age[0])[0])
    return own.correct(gains._replace(L=L), memory, arrival)


BEFORE = {  # the estimate is kept as it was before the jump
    "init": lambda gains, xhat0: (xhat0, xhat0),
    "snapshot": lambda gains, memory, now: gains.C @ memory[0],
    "jump": lambda gains, memory, now, arrival: (own.correct(gains, memory[0], arrival), memory[1]),
    "flow": lambda gains, memory, now: (gains.Phi @ memory[0] + gains.Gamma @ now.u,) * 2,
    "estimate": lambda gains, memory: memory[1],
}
BROKEN = {
    "no certificate": ("design", {"design": lambda s, o: own.design(s, o).gains}, "got Gains, expected Design"),
    "a word among gains": ("design", {"design": lambda s, o: Design({"L": "0.1"}, own.design(s, o)[1])}, "got a str among"),
    "a design that divides by zero": ("design", {"design": lambda s, o: 1 // 0}, "ZeroDivisionError.*test_checking.py line"),
    "estimate of one state": ("shapes", {"estimate": lambda gains, memory: memory[:1]}, r"estimate returned shape \(1,\)"),
    "a list outside": ("purity", {"jump": kept}, "a traced value that jump stores outside"),
    "a counter": ("purity", {"flow": counted}, "two programs when flow was traced twice"),
    "a global": ("gains", {"jump": by_global, "design": sets_global}, "other numbers in the program of jump"),
    "a global table of whole numbers": (
        "gains",
        {"jump": by_global_table, "design": sets_global_table},
        "other numbers in the program of jump",
    ),
    "a matrix written in": ("gains", {"jump": written}, r"an array of shape \[2, 1\] written into jump"),
    "float32": ("float64", {"jump": narrow}, "got float32 in jump"),
    "a callback": ("many runs", {"jump": called_back}, "jump in vmap"),
    "an old input": (
        "perfect start",
        {"flow": lambda gains, memory, now: gains.Phi @ memory + gains.Gamma @ now.past_u(1)},
        "an error of .* at tick 1,",
    ),
    "the input of the present": ("delay 0", {"jump": knows_the_present}, "estimate of tick 200 that depends on the input"),
    "channels that are not fresh": (
        "no peeking",
        {"jump": lambda gains, memory, now, arrival: memory + gains.L @ (arrival.value - arrival.snapshot)},
        "value of channel 1 where arrival.mask is False",
    ),
    "before the jump": ("after the jump", BEFORE, "an arrival of tick .* at tick"),
}  # fmt: skip


def broken(changes):
    functions = {name: f for name, f in changes.items() if name != "design"}
    return ENTRY._replace(observer=own.nudge._replace(**functions), design=changes.get("design", own.design))


@pytest.mark.ci
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_observer_fails_exactly_the_check_it_should(name):
    check, changes, sentence = BROKEN[name]
    found = failing(verdicts(broken(changes)))
    assert list(found) == [check], found
    assert re.search(sentence, found[check])
    assert found[check].endswith(".")
    assert "; " in found[check]


def test_there_is_a_broken_observer_for_every_check():
    assert {check for check, _, _ in BROKEN.values()} == {"design", *CHECKS}


@pytest.mark.ci
def test_an_input_that_is_not_yet_there_is_peeking():
    def ahead(gains, memory, now):
        return gains.Phi @ memory + gains.Gamma @ now.past_u(-1)

    assert "no peeking" in failing(verdicts(broken({"flow": ahead})))


@pytest.mark.ci
def test_a_memory_changed_in_place_is_no_pure_function():
    def jump(gains, memory, now, arrival):
        memory["x"] = own.correct(gains, memory["x"], arrival)
        return memory

    changes = {
        "init": lambda gains, xhat0: {"x": xhat0},
        "snapshot": lambda gains, memory, now: gains.C @ memory["x"],
        "jump": jump,
        "flow": lambda gains, memory, now: {"x": gains.Phi @ memory["x"] + gains.Gamma @ now.u},
        "estimate": lambda gains, memory: memory["x"],
    }
    found = failing(verdicts(broken(changes)))
    assert list(found) == ["purity"]
    assert "changed arguments from jump" in found["purity"]


@pytest.mark.ci
def test_an_age_of_zero_is_no_divisor():
    def jump(gains, memory, now, arrival):
        return own.correct(gains._replace(L=gains.L / arrival.age[0]), memory, arrival)

    assert "not finite" in failing(verdicts(broken({"jump": jump})))["delay 0"]


@pytest.mark.ci
def test_an_observer_that_declares_not_to_know_the_schedule_is_not_asked_for_a_perfect_start():
    flow = {"flow": lambda gains, memory, now: gains.Phi @ memory}
    found = verdicts(broken(flow)._replace(knows_schedule=False))
    assert not failing(found)
    assert found["perfect start"].verdict == "skipped"


@pytest.mark.ci
def test_a_design_may_refuse_a_schedule_but_not_all():
    def picky(context, options):
        if context.delay[0] < late:
            raise UserError("mine: got a short delay, expected a long one; wait.")
        return own.design(context, options)

    late = 1
    found = verdicts(ENTRY._replace(design=picky))
    assert not failing(found)
    assert found["delay 0"].verdict == "skipped"
    late = 10**6
    assert "refusal of all 6 schedules" in failing(verdicts(ENTRY._replace(design=picky)))["design"]


@pytest.mark.ci
def test_a_shifted_packet_is_another_measurement():
    """What is added to a packet, to its values or its snapshots, shows from the tick on at which it arrives, and not before."""
    entry = OBSERVERS["pccebo"]
    t = trial(Candidate("pccebo", entry, entry.options()), SCENARIOS["cart/white"])
    p, number, step = next(case for case in t.cases if case.name == "one period late").problem, 2, 0.25
    nothing = no_shift(p)
    plain = record(t, p, nothing).estimates["pccebo"]
    arrives = int(np.flatnonzero((p.schedule.arrive == number).any(1))[0])
    for field in ("values", "snapshots"):
        shift = nothing._replace(**{field: getattr(nothing, field).at[number].set(step)})
        moved = np.abs(record(t, p, shift).estimates["pccebo"] - plain).max(1)
        assert np.flatnonzero(moved)[0] == arrives, field


def test_a_nan_that_is_written_into_a_program_is_the_same_twice():
    """As the place of a lookup that finds nothing is."""

    def f(x):
        return jnp.where(x > 0, x, jnp.nan)

    assert jaxpr_checks.is_same_program(jaxpr_checks.program(f, jnp.ones(2)), jaxpr_checks.program(f, jnp.ones(2)))
