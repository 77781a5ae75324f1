"""What once was a traceback, a hang, a quiet guess or half a sentence; each is refused at once in one that says what to do."""

import numpy as np
import pytest
from hanging import in_time

from pcbench import planning
from pcbench.dynamics import linear
from pcbench.errors import LONGEST, UserError, brief_repr, first_sentence
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study import parse, times

CART = "scenarios = ['cart/nominal']\n"
LTI = {
    "A": "[[0.0, 1.0], [-4.0, -0.5]]",
    "B": "[[0.0], [1.0]]",
    "C": "[[1.0, 0.0]]",
    "sampling_period": "0.1",
    "delay": "0.1",
    "noise_std": "0.1",
    "duration": "1.0",
}
DEEP, LONG, HEXADECIMAL = "[" * 5000, "1" + "0" * 5000, "0x" + "f" * 5000
MANY = [i / 1000 for i in range(1, 1001)]


def lti(**changes):
    """A study of a plant of one's own, as text, with some keys changed."""
    return "[lti]\n" + "\n".join(f"{key} = {value}" for key, value in (LTI | changes).items())


REFUSED = {
    # not TOML, in ways that tomllib does not call so
    "a number of 5001 digits": (f"x = {LONG}", "got what is not valid TOML .*4300 digits"),
    "lists 5000 deep": (f"x = {DEEP}", "got what is not valid TOML .*nested deeper than 64"),
    # numbers that no float can hold, or no text
    "an integer beyond floats": (
        CART + f"axes.delay = [1{'0' * 400}]",
        r"axes\.delay\[0\]: got 10+\.\.\.0+, .* at most 1e",
    ),
    "an integer beyond text": (
        lti(loss=HEXADECIMAL),
        r"lti\.loss: got a value of type int that is too long .*, expected a",
    ),
    # names
    "a key of two lines": (CART + '"a\\nb" = 1', r"'a\\nb' is no key here; "),
    "a key of a million letters": (CART + "x" * 1_000_000 + " = 1", r"'x+\.\.\.x+' is no key here"),
    "the folder above": (CART + "name = '..'", r"name: got '\.\.', expected a string that should match"),
    "a name longer than a file's": (
        CART + f"name = '{'x' * 300}'",
        "name: got 'x.*expected a string .* at most 100 char",
    ),
    "a label of two lines": (CART + '[options."kf-a\\nb"]\nR = 1.0', r"'kf-a\\nb' is no observer with options"),
    "observers of a plant": (lti(observers="['kff']"), r"lti\.observers: 'kff' is no observer; did you mean 'kf'\?"),
    "an observer twice": (lti(observers="['kf', 'kf']"), r"lti\.observers: got 'kf' twice"),
    "a number for an observer's file": (
        CART + "custom_observers.mine = 0",
        r"custom_observers\.mine: got 0, expected a valid string",
    ),
    "a list for an observer's file": (
        CART + "custom_observers.mine = []",
        r"custom_observers\.mine: got \[\], expected a valid string",
    ),
    # the same thing said twice
    "an option twice": (CART + "[options.kfbo]\nlag-aware = true\nlag_aware = false", "kfbo: got lag-aware twice"),
    "an axis twice": (CART + "[axes]\n'plant.lam' = [1.0]\nplant.lam = [2.0]", r"axes: got plant\.lam twice"),
    # what was taken for a number
    "true for a number": (CART + "[options.kfbo]\nR = true", r"options\.kfbo: R: got True, expected a valid number"),
    "a text for a number": (CART + "[options.kfbo]\nR = '1'", r"options\.kfbo: R: got '1', expected a valid number"),
    "a text for a switch": (
        CART + "[options.kfbo]\nlag-aware = 'yes'",
        "lag_aware: got 'yes', expected a valid boolean",
    ),
    "a text for a period": (
        lti(sampling_period="'0.1'"),
        r"lti\.sampling_period: got '0\.1', expected a valid number or",
    ),
    "true in a matrix": (lti(B="[[0.0], [true]]"), r"lti\.B\[1\]\[0\]: got True, expected a valid number"),
    # sizes
    "a huge option": (CART + "[options.kf]\nR = 1e308", r"options\.kf\.R: got 1e\+308, expected 0 or a number of"),
    "a huge option in a list": (
        CART + "[options.pco]\nKp = [[1e200]]",
        r"options\.pco\.Kp: got 1e\+200, expected 0 or",
    ),
    "an endless start": (
        CART + "[options.scenario]\ninitial-spread = inf",
        "initial-spread: got inf, expected 0 or a number",
    ),
    "a huge start": (
        lti(x0="[1e300, 1.0]"),
        r"lti\.x0\[0\]: got 1e\+300, expected less than or equal to 1000000000000",
    ),
    "a huge matrix": (lti(A="[[1e308, 0.0], [0.0, 0.0]]"), r"lti\.A\[0\]\[0\]: got 1e\+308, expected less"),
    "a matrix told from 0 by nothing": (lti(C="[[1e-300, 0.0]]"), r"lti\.C\[0\]\[0\]: got 1e-300, expected 0 or"),
    "a prior below 0": (
        lti(prior_std="[-1.0, 1.0]"),
        r"lti\.prior_std\[0\]: got -1\.0, expected greater than or equal to 0",
    ),
    "a band below 0": (lti(settle_band="[1.0, -1.0]"), r"lti\.settle_band\[1\]: got -1\.0, expected greater than or"),
    "a plant that outgrows floats": (
        lti(A="[[1e3, 0.0], [0.0, 0.0]]"),
        r"lti\.A: got a plant that grows by 1e434 over",
    ),
    "no states": (lti(A="[]"), r"lti\.A: got 0 x 0, expected 1 x 1"),
    "a B of no columns": (lti(B="[[], []]"), r"lti\.B: got 2 x 0, expected 2 x 1"),
    "more states than 50": (lti(A=str(np.eye(51).tolist())), "got 51 states, .* expected at most 50 of each"),
    # hours, or memory that is not there
    "ticks of 1e-300 s": (lti(tick="1e-300"), r"lti\.tick: got 1e-300, expected 0 or a number of at least"),
    "a billion ticks": (
        lti(tick="1e-9", sampling_period="1e-9"),
        "got a duration of 1 s at a tick of 1e-09 s, expected at most",
    ),
    "an age of the world": (
        lti(duration="1e12"),
        r"got a duration of 1e\+12 s at a tick of 0\.001 s, expected at most 1,000,000",
    ),
    "a horizon within a tick": (
        lti(duration="1e-5"),
        "got a duration of 1e-05 s at a tick of 0.001 s, expected at least two",
    ),
    "a period of 1e-300 s": (
        lti(sampling_period="1e-300"),
        r"lti\.sampling_period: got 1e-300, expected 0 or a number",
    ),
    "a delay of years": (lti(delay="1e9"), r"lti\.delay: got 1e\+09 s, expected at most the duration"),
    "a sample every tick": (
        lti(duration="1e3", sampling_period="1e-3"),
        r"got a sample every 0\.001 s over 1000 s, expected at most 100,000 .* of at least 0\.01\.",
    ),
    "samples on their way": (
        lti(duration="100.0", sampling_period="1e-3", delay="50.0"),
        r"got delays of up to 50 s with samples every 0\.001 s, expected at most 10,000 samples",
    ),
    "samples out of order": (
        lti(duration="9.0", sampling_period="1e-3", delay_jitter="5.0"),
        "got samples that may arrive after up to 4,999 newer ones, expected at most 1,000",
    ),
    "a million cells": (
        CART + f"axes.noise_std = {MANY}\naxes.sampling_period = {MANY}",
        "axes: got 1,000,000 grid points of 10,000 ticks, expected at most 10,000",
    ),
    "cells of many ticks": (
        f"scenarios = ['arm/sampled']\naxes.noise_std = {MANY}\naxes.parameter_drift = [0.0, 0.1, 0.2, 0.3, 0.4, 0.5]",
        "axes: got 6,000 grid points of 20,001 ticks, expected at most 4,999",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_it_is_refused_before_any_work_in_one_sentence(what, tmp_path):
    text, expected = REFUSED[what]
    path = tmp_path / "study.toml"
    path.write_text(text)
    with in_time(), pytest.raises(UserError, match=expected) as error:
        parse.load(str(path))
    sentence = str(error.value)
    assert sentence.startswith(f"{path}: ")
    assert sentence.isprintable()
    assert sentence.endswith(".")
    assert len(sentence) < 1000


@pytest.mark.parametrize("name", ["x" * 5000, "x" * 5000 + ".toml", "a\0b.toml", "a\0b"])
def test_a_name_that_no_file_can_have_is_refused_in_one_sentence(name):
    with pytest.raises(UserError, match=r"expected a TOML file|is no study") as error:
        parse.load(name)
    assert str(error.value).isprintable()
    assert len(str(error.value)) < 1000


def test_a_change_by_set_holds_one_value():
    """A second key after a line's end was dropped without a word."""
    with pytest.raises(UserError, match=r"seeds: got '1\\nroot_seed = 2', expected a valid integer"):
        parse.load("cart/nominal", ["seeds=1\nroot_seed = 2"])


def test_what_is_quoted_is_short_and_of_one_line():
    for value in ("x" * 1000, list(range(1000)), {i: [[[i]]] for i in range(100)}, 10**400, int(HEXADECIMAL, 16), "\n"):
        assert len(brief_repr(value)) <= LONGEST
        assert str(UserError(f"got {brief_repr(value)}.")).isprintable()
    assert first_sentence(ValueError("Failed to converge. Try\nanother one.")) == "Failed to converge"


def plan_study(text, tmp_path):
    (tmp_path / "study.toml").write_text(text)
    with config.float64():
        return planning.plan(parse.load(str(tmp_path / "study.toml")))


def test_the_limits_leave_room_for_what_is_published(tmp_path):
    for name in SCENARIOS:
        parse.load(name)
    (cell,) = plan_study(lti(duration="100.0", sampling_period="0.1"), tmp_path)
    assert cell.cell.times.ticks == 100_000 < times.TICKS


def test_a_riccati_equation_without_noise_is_refused_in_one_sentence(tmp_path):
    """Q = B B' = 0 was divided by."""
    text = lti(B="[[0.0], [0.0]]", A="[[0.0, 1.0], [-4.0, 0.0]]", observers="['kfbo']")
    with pytest.raises(UserError, match=r"kfbo in lti: .*expected"):
        plan_study(text, tmp_path)


def test_the_noise_over_a_tick_in_which_a_fast_mode_dies():
    """Van Loan's exponential over it overflows: e^{1e6}. 20 doublings leave 2^20 roundings: 1e-9."""
    rates, tick = np.array([1e8, 3.0]), 0.01
    Q = linear.noise_over_tick(-np.diag(rates), np.array([[2.0, 1.0], [1.0, 4.0]]), tick)
    both = rates[:, None] + rates
    np.testing.assert_allclose(Q, np.array([[2.0, 1.0], [1.0, 4.0]]) * -np.expm1(-both * tick) / both, rtol=1e-9)


def test_a_plant_with_a_fast_mode_is_planned(tmp_path):
    (cell,) = plan_study(lti(A="[[-1e9, 1.0], [-4.0, -0.5]]", observers="['kf']\n[options.kf]\nq = 0.1"), tmp_path)
    assert cell.certificates["kf"].margin > 0
