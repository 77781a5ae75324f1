"""The variance theorem of PI-PCO by Monte Carlo through the library, with its sign change; and `reproduce pi-pco`."""

import numpy as np
import pytest

from pcbench.papers import pi_pco
from pcbench.runtime import config


@pytest.fixture(scope="module")
def found():
    with config.float64():
        return list(pi_pco.monte_carlo(pi_pco.GRID, 1024))


@pytest.mark.nightly
def test_monte_carlo_confirms_the_closed_form_within_four_standard_errors(found):
    for c in found:
        assert max(np.abs(c.deviations)) < 4, c
        assert max(c.errors[:2]) < 0.02 * max(c.pi, c.pco), "an error bar that proves something"


@pytest.mark.nightly
def test_the_sign_of_the_integrals_effect_changes_where_the_theorem_says(found):
    lowers = {(c.F, c.k): c.difference < 0 for c in found if abs(c.difference) > 4 * c.errors[2]}
    assert len(lowers) >= len(found) - 2, "nearly every difference is significant"
    assert lowers == {(F, k): F < 0 and k < -2 * F for F, k in lowers}
    assert set(lowers.values()) == {True, False}


@pytest.mark.nightly
def test_the_printed_ordering_holds_for_an_amplifying_gain_only():
    with config.float64():
        claims = list(pi_pco._ordering())
    assert [c.verdict for c in claims] == ["does not hold", "does not hold", "reproduced", "does not hold"]


@pytest.mark.nightly
def test_every_claim_has_its_verdict():
    claims = pi_pco.claims()
    verdicts = [c.verdict for c in claims if c.verdict != "finding"]
    assert verdicts == [
        *("does not hold", "does not hold", "reproduced", "does not hold", "does not hold"),
        *("not determinable", "not determinable", "misprint", "misprint"),
        *("reproduced", "does not hold"),
    ]
    ours = [c for c in claims if c.verdict == "finding"]
    assert len(ours) == len(pi_pco.GRID)
    assert all("; agrees with the closed form" in c.reproduced for c in ours)
