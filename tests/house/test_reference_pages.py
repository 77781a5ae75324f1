"""The reference pages are those that the code's records make, and the facts that a record states are true."""

import pytest
from documents import PAGES
from exports import REFUSED
from reference_pages import PAGES as REFERENCE

import pcbench
from pcbench.observers import OBSERVERS
from pcbench.observers.methods import METHODS

CART = {"base": "cart/white", "dt": 0.01, "duration": 0.8, "steady_start": 0.4}
ARM = {"base": "arm/sampled", "duration": 0.1005, "steady_start": 0.05}  # whose input is unknown


@pytest.mark.parametrize("name", REFERENCE)
def test_page_equals_what_the_code_makes(name):
    assert PAGES[f"{name}.md"] == REFERENCE[name](), "run: python tests/support/reference_pages.py"


def test_every_observer_has_a_method():
    assert METHODS.keys() == OBSERVERS.keys()


def test_observers_without_c_export_are_those_that_export_refuses():
    assert {name for name, method in METHODS.items() if not method.c_export} == set(REFUSED)


@pytest.mark.nightly
@pytest.mark.parametrize("name", [name for name in METHODS if name != "high-gain"])  # it has no linear plant
def test_observer_has_exact_moments_if_its_record_states_it(name):
    scenario = ARM if name in ("smo", "pio") else CART
    study = {"name": "affine", "observers": [name], "scenario": scenario, "options": {"particle": {"particles": 10}}}
    (row,) = pcbench.exact_moments(study).stats.query("metric == 'mse'").head(1).itertuples()
    assert (row.method == "exact") == METHODS[name].exact_moments, row.reason
