"""`pcbench reproduce field`: its part of the page, its sources and marks, and its numbers by other means."""

import re
from pathlib import Path

import numpy as np
import pytest
from reference import linear
from scipy.integrate import solve_ivp

from pcbench.papers import field
from pcbench.papers.claim import FINDING, NOT_OBTAINED, REPRODUCED, VERDICTS, all_digits
from pcbench.papers.field import batch_reactor, intermittent, quadruple_tank
from pcbench.papers.page import _paper
from pcbench.plants.quadruple_tank import linearize
from pcbench.runtime import config
from pcbench.synthesis import network_bounds

PAGE = (Path(__file__).parents[2] / "REPRODUCTION.md").read_text()
PART = "## field\n" + PAGE.partition("\n## field\n")[2]


@pytest.fixture(scope="module")
def computed():
    with config.float64():
        return field.claims_of(field.EXAMPLES)


@pytest.mark.ci
def test_computed_claims_are_in_the_page_as_they_come_out(computed):
    """Byte for byte and in order; a row of the page that is computed from runs, or not obtained, may be between them."""
    tables = [line for line in _paper("field", computed) if line.startswith("|")]
    page = iter(PART.splitlines())
    assert all(line in page for line in tables)


def test_field_has_claims_with_a_source_and_a_mark(computed):
    claims = [row for row in computed if row.verdict in VERDICTS]
    assert len(claims) >= 25
    assert all(re.search(r"[12]\d{3}.* \[[VS]\]$", row.source) for row in claims)
    assert {row.verdict for row in computed} <= {*VERDICTS, FINDING}
    assert len({row.claim for row in computed}) == len(computed)


def test_every_number_that_is_not_obtained_has_its_source_and_no_verdict():
    rows = field.unobtained.rows()
    assert {row.verdict for row in rows} == {NOT_OBTAINED}
    assert all(row.source and row.claim and row.reproduced for row in rows)
    for source in ("Gopalakrishnan", "2210.03368", "2102.10652", "2108.04591", "Raff", "Schenato", "Mazenc", "Karafyllis",
                   "Ahmed-Ali", "Signal Processing 114", "2512.20354"):  # fmt: skip
        assert any(source in row.source for row in rows), source


@pytest.mark.parametrize(
    ("printed", "values", "verdict"),
    [
        ("1.99, -0.50 +2.1i", [1.9949, -0.504 + 2.149j], "reproduced"),
        ("1.99, -0.50 +2.1i", [1.9949, -0.504 + 2.151j], "does not hold"),
        ("1.99, -0.50 +2.1i", [1.9949, -0.504 - 2.149j], "does not hold"),
        ("62, 90", [62.3, 90.3, 1.0], "does not hold"),
        ("4, 4", [4, 4], "reproduced"),
    ],
)
def test_every_printed_number_is_compared_to_its_last_digit(printed, values, verdict):
    assert all_digits("x", printed, values).verdict == verdict


@pytest.mark.parametrize(("factor", "settles"), [(0.99, True), (1.01, False)])
def test_round_robin_interval_is_where_the_held_loop_stops_settling(factor, settles):
    """Plant, controller and held values of both outputs by an integrator, without the matrices of the ledger."""
    A, B = batch_reactor.ncs_reactor.A, batch_reactor.ncs_reactor.B
    C = np.array(batch_reactor.ncs_reactor.C)

    def motion(t, s):
        x, xc, y = s[:4], s[4:6], s[6:]
        u = np.array([-2 * xc[0] - 2 * y[1], 8 * xc[1] + 5 * y[0]])
        return np.concatenate([np.dot(A, x) + np.dot(B, u), [y[1], y[0]], [0.0, 0.0]])

    limit = network_bounds.round_robin_limit(batch_reactor.network(), batch_reactor.LONGEST)
    interval, columns = factor * limit, []
    for unit in np.eye(8):
        s = unit
        for node in (0, 1):
            s = solve_ivp(motion, (0, interval), s, method="DOP853", rtol=1e-11, atol=1e-13).y[:, -1]
            s[6 + node] = C[node] @ s[:4]
        columns.append(s)
    assert (np.abs(np.linalg.eigvals(np.array(columns).T)).max() < 1) == settles


@pytest.mark.parametrize("name", intermittent.EXAMPLES)
def test_least_rate_of_one_output_follows_from_the_unstable_eigenvalues(name):
    """With one output it is 1 - 1 / (the product of the unstable eigenvalues)^2."""
    _, A, C = intermittent.EXAMPLES[name]
    unstable = [abs(z) for z in np.linalg.eigvals(A) if abs(z) > 1]
    want = 1 - 1 / np.prod(unstable) ** 2
    assert intermittent.sufficient_rate(np.array(A), np.array(C)) == pytest.approx(want, abs=1e-6)


@pytest.mark.parametrize("point", quadruple_tank.LEVELS)
def test_gain_of_the_tanks_is_singular_at_their_zeros(point):
    model = linearize(quadruple_tank.CONSTANTS[point], np.array(quadruple_tank.LEVELS[point]))
    for zero in quadruple_tank.zeros(model):
        G = model.C @ np.linalg.solve(zero * np.eye(4) - model.A, model.B)
        assert abs(np.linalg.det(G)) < 1e-10 * np.linalg.norm(G) ** 2


def test_periods_next_to_the_limit_settle_and_do_not():
    def radius(period):
        Phi, Gamma = linear.discretise(np.array([[0.0, 1.0], [0.0, -0.1]]), np.array([[0.0], [0.1]]), period)
        return np.abs(np.linalg.eigvals(Phi - Gamma @ np.array([[3.75, 11.5]]))).max()

    row = field.two_state.rows()[1]
    limit = float(row.reproduced)
    assert row.verdict == REPRODUCED
    assert radius(limit - 1e-5) < 1 < radius(limit + 1e-5)
