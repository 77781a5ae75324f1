"""Lists on the guide's pages are those of the code: who has a covariance, who takes which clocks, whose gains are proven."""

import re

import pytest
from documents import PAGES

from pcbench import plots
from pcbench.checking import observer
from pcbench.engine import runner
from pcbench.observers import OBSERVERS
from pcbench.planning import plan
from pcbench.protocols import Observer
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.study import STUDIES, parse
from pcbench.synthesis.certificate import is_certified


def named(page, begin):
    """What stands in code in the sentence of a page that begins so, on whatever lines."""
    (sentence,) = re.findall(rf"{re.escape(begin)}(.*?)[.:;](?:\s|$)", re.sub(r"\s+", " ", PAGES[page]))
    return re.findall(r"`([^`]+)`", sentence)


def observers(holds):
    return {name for name, entry in OBSERVERS.items() if holds(entry)}


@pytest.mark.parametrize(
    ("page", "begin", "holds"),
    [
        ("limitations.md", "Channels may have different sampling times with", lambda e: e.takes == "any schedule"),
        (
            "limitations.md",
            "Channels may have different constant delays also with",
            lambda e: e.takes == "constant delays",
        ),
        ("limitations.md", "Only open loops are supported by", lambda e: not e.loops),
        ("consistency.md", "These observers report a covariance:", lambda e: e.observer.covariance),
        (
            "consistency.md",
            "These observers report no `nis`:",
            lambda e: e.observer.covariance and not e.observer.innovation,
        ),
    ],
)
def test_the_observers_that_a_sentence_names_are_all_of_them(page, begin, holds):
    assert sorted(named(page, begin)) == sorted(observers(holds))


@pytest.mark.nightly
def test_the_observers_whose_gains_nothing_proves_are_all_of_them():
    elsewhere = {"high-gain": "helicopter/constant", "smo": "arm/sampled", "pio": "arm/sampled"}
    asked = {"cart/gaussian": [name for name in OBSERVERS if name not in elsewhere]}
    for name, scenario in elsewhere.items():
        asked.setdefault(scenario, []).append(name)
    proofs = {}
    with config.float64():
        for scenario, names in asked.items():
            (planned,) = plan(parse.grid_of(scenario, {"observers": names}, []).study)
            proofs |= planned.certificates
    unproven = [name for name, proof in proofs.items() if is_certified(proof._asdict()) is False]
    assert len(proofs) == len(OBSERVERS)
    assert sorted(named("limitations.md", "There is no certificate for")) == sorted(unproven)


def test_every_check_of_an_observer_is_named():
    assert named("your_own_observer.md", "`check` tests") == [*observer.CHECKS, "closed loop"]


def test_every_optional_function_of_an_observer_is_named():
    optional = Observer._field_defaults
    assert f"{ {5: 'Five'}[len(optional)] } functions are optional" in PAGES["your_own_observer.md"]
    section = PAGES["your_own_observer.md"].split("## Optional functions")[1].split("\n## ")[0]
    for name in optional:
        assert re.search(rf"`{name}[(`]", section), name


def test_every_plot_is_named():
    page = PAGES["results.md"].split("## In Python")[1].split("\n## ")[0]
    for name in plots.__all__:
        assert re.search(rf"(?:plots\.|`){name}\b", page) or name == "styles", name


def test_how_many_runs_a_call_has():
    widths = sorted({*runner.NARROW, runner.WIDTH})
    assert "an array over {}, {} or {} runs".format(*widths) in " ".join(PAGES["how_it_works.md"].split())


def test_how_many_scenarios_of_the_cart_the_study_has():
    cart = [name for name in SCENARIOS if name.startswith("cart/")]
    words = {6: "six", 10: "ten"}
    said = f"{words[len(STUDIES['cart'].scenarios)]} of the {words[len(cart)]} scenarios on the cart"
    assert said in PAGES["quickstart.md"]
