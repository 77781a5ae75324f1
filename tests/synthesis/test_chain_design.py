"""Gains of the chain equal the reference's, and its certificate is its map: taken from its own functions, column by column."""

import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from chains import DELAYS, OUTPUTS, PLANTS, START, links_of, record_cells, slow
from reference import chain as ref

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.observers import chain
from pcbench.runtime import config
from pcbench.study import parse
from pcbench.study.grid import cells
from pcbench.synthesis import chain as synthesis


@pytest.mark.parametrize("case", range(len(DELAYS)), ids=lambda i: str(DELAYS[i]))
@pytest.mark.parametrize("label", OUTPUTS)
@pytest.mark.nightly
def test_its_map_of_one_sample_is_the_certificates_and_the_references(case, label):
    """The map of the functions themselves, column by column, in shift coordinates: all channels known, y - C xbar = 0."""
    cells, _ = record_cells("odd")
    p, delays = cells[case], DELAYS[case]
    gains, theta, n, k = jax.tree.map(jnp.asarray, p.problem.gains[label]), max(delays), 4, 50
    with config.float64():
        start = chain.init(gains, jnp.zeros(n))
        ring = len(start.past) - 1
        run = start.run._replace(tick=jnp.asarray(k), sample=jnp.asarray(k))
        heard = tuple(jnp.ones_like(known) for known in start.has_arrived)
        start = start._replace(run=run, has_arrived=heard, mask=jnp.ones(3, bool))

        @jax.jit
        def step(errors):
            slots = (k - 1 - np.arange(theta)) % ring
            memory = start._replace(past=start.past.at[slots].set(errors.reshape(theta, n)))
            now = pcbench.protocols.Now(
                jnp.asarray(0.0), jnp.asarray(k), jnp.asarray(1.0), jnp.zeros(2), lambda age: jnp.zeros(2)
            )
            return chain.flow(gains, memory, now).past[(k - np.arange(theta)) % ring].reshape(-1)

        J = np.stack([np.asarray(step(e)) for e in np.eye(n * theta)], 1)
    model, links = PLANTS["odd"], links_of("odd", p, label, delays)
    found = [synthesis.Link(one.d, np.array(one.mask, float), one.F, one.K, one.V, one.W) for one in links]
    np.testing.assert_allclose(J, ref.jacobian(model, links), atol=1e-12 * np.abs(J).max())
    np.testing.assert_allclose(synthesis.sample_map(found, model.C), J, atol=1e-12 * np.abs(J).max())
    rate = max(ref.radius(one.F) ** (1 / one.d) for one in links)
    certificate = synthesis.certify(found, model.C, "test")
    assert certificate.margin == pytest.approx(1 - ref.radius(J), abs=1e-6)
    assert 1 - certificate.margin == pytest.approx(rate, rel=1e-6)


@pytest.mark.parametrize("delays", DELAYS)
def test_designs_equal_the_references(delays):
    Q, R, _ = ref.csth_noise(10.0)
    cases = {
        "poles": ({}, {}),
        "slow": ({"pole_per_tick": 0.8}, {"pole_per_tick": 0.8}),
        "companion": ({"gain": "companion"}, {"kind": "companion"}),
        "riccati": ({"gain": "riccati"}, {"kind": "riccati", "Q": Q, "R": R}),
        "deadbeat": (
            {"gain": "riccati", "output": "deadbeat"},
            {"kind": "riccati", "output": "deadbeat", "Q": Q, "R": R},
        ),
    }
    model, X, Y = ref.csth("10s"), START["tank"], np.array([15.9, 0.77, 5.0])  # sizes of states and outputs
    for options, other in cases.values():
        overrides = [f"options.chain.{key}={value!r}" for key, value in options.items()]
        overrides.append(f"axes.delay=[{[10.0 * d for d in delays]}]")
        gains = pcbench.design("csth/10s", "chain", overrides=overrides).gains.links
        real = np.flatnonzero(np.asarray(gains.source) > np.asarray(gains.stamp))[::-1]
        for i, want in zip(real, ref.design(model, delays, **other), strict=True):
            assert gains.source[i] - gains.stamp[i] == want.d
            for name, left, right in (("F", X, X), ("K", X, Y), ("V", Y, Y), ("W", Y, X)):
                got, wanted = (M / left[:, None] * right for M in (getattr(gains, name)[i], getattr(want, name)))
                np.testing.assert_allclose(got, wanted, rtol=0, atol=1e-9)


def test_sensors_that_repeat_each_other_share_a_gain():
    """A fast and a slow sensor of one quantity, and three outputs for two states."""
    for C in ([[1.0, 0.0], [2.0, 0.0]], [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]):
        lti = {"C": C, "D": None, "delay": [0.2, 0.5, 0.5][: len(C)]}
        study, _, _ = slow(**lti)
        gains = pcbench.design(study, "chain").gains.links
        for F in gains.F[np.asarray(gains.source) > np.asarray(gains.stamp)]:
            poles = np.sort(np.linalg.eigvals(F))
            np.testing.assert_allclose(poles, [0.36, 0.4] if len(C) == 2 else [0.4, 0.4], rtol=1e-6)


@pytest.mark.ci
@pytest.mark.parametrize("options", [{}, {"pole_per_tick": 0.8}, {"gain": "riccati", "output": "deadbeat"}], ids=str)
def test_the_papers_condition_is_reported_with_a_p_that_proves_it(options):
    """(29) at the P and e that were found, with the couplings read from the reference's map of one sample."""
    given = [f"options.chain.{key}={json.dumps(value)}" for key, value in (options | {"shared": True}).items()]
    design = pcbench.design("csth/10s", "chain", overrides=given)
    numbers, links = design.certificate.numbers, design.gains.links
    S = np.diag([0.5, 2e4, 5.0])
    want = [ref.Link(int(a - b), list(m > 0), *each) for a, b, m, *each in zip(
        links.source, links.stamp, links.has_arrived, links.F, links.K, links.V, links.W, strict=True)][::-1]  # fmt: skip
    J, ends, worst = ref.jacobian(ref.csth("10s"), want), [2, 5, 7], []
    P, e = numbers["shared_P"], numbers["shared_epsilon"]
    for i, stamp in enumerate([0, 2, 5]):
        block = [np.linalg.solve(S, J[3 * stamp : 3 * stamp + 3, 3 * (end - 1) : 3 * end]) @ S for end in ends]
        coupled = sum(M.T @ P @ M for M in block[i + 1 :]) if block[i + 1 :] else np.zeros((3, 3))
        left = (1 + e) * block[i].T @ P @ block[i] + (2 - i) * (1 + 1 / e) * coupled - P
        worst.append(-np.linalg.eigvalsh(left).max())
    assert min(worst) > 0
    assert numbers["shared_margin"] == pytest.approx(min(*worst, np.linalg.eigvalsh(P).min()), rel=1e-6)


def test_the_papers_condition_is_not_needed():
    """Two links with rho(F) = 0.9 and a strong coupling: stable, and (29) has no P at any e."""
    link = synthesis.Link(
        1, np.array([1.0]), np.array([[0.9]]), np.array([[5.0]]), np.array([[1.0]]), np.array([[3.0]])
    )
    links = [link._replace(has_arrived=np.array([0.0])), link]
    assert synthesis.certify(links, np.eye(1), "test").margin == pytest.approx(0.1, abs=1e-6)
    assert synthesis.check(links, np.ones(1))["shared_margin"] <= 0
    loose = [each._replace(K=each.K / 100, W=each.W / 100) for each in links]
    assert synthesis.check(loose, np.ones(1))["shared_margin"] > 0, "with a weak coupling there is one"


def test_vanishing_poles_over_long_delays_are_certified():
    """An F of 0 is one of rounding: its root over many samples says nothing, and is no reason to refuse the gain."""
    given = ["axes.delay=[[600, 1200, 1800]]", "options.chain.pole=0"]
    assert 0.2 < pcbench.design("csth/10s", "chain", overrides=given).certificate.margin <= 1
    for seed in range(6):  # every pole of F at 0, in one chain of vectors: radii of 1e-6 to 1e-5 that are rounding
        rng = np.random.default_rng(seed)
        T = rng.standard_normal((3, 3))
        gains = [T @ np.diag([1.0, 1.0], 1) @ np.linalg.inv(T), *(rng.standard_normal((3, 3)) for _ in range(3))]
        links = [synthesis.Link(10, np.array([float(j <= i) for j in range(3)]), *gains) for i in range(3)]
        assert 0.5 < synthesis.certify(links, np.eye(3), "test").margin < 1
    for left in (
        7e-18,
        1e-22,
    ):  # what rounding leaves of a pole at 0, over 60 samples: the map of one rounds on its own
        F, none = np.diag([0.0, -left, 0.0]), np.zeros((3, 3))
        links = [synthesis.Link(60, np.array([float(j <= i) for j in range(3)]), F, none, none, none) for i in range(3)]
        assert 0.2 < synthesis.certify(links, np.eye(3), "test").margin <= 1
    links = [synthesis.Link(2, np.ones(1), *(np.full((1, 1), v) for v in (0.25, 1.0, 1.0, 1.0)))]
    assert synthesis.certify(links, np.eye(1), "test").margin == pytest.approx(0.5)


def test_a_model_that_outgrows_its_delay_is_refused():
    """By the design itself: a study's own plant is refused before, where it outgrows its horizon."""
    study, _, _ = slow(delay=[0.1, 3.9], steady_start=0.5)
    (cell,) = cells(parse.parse(study, "slow"), "lti")
    known = planning.context_of(cell)
    faster = known._replace(model=known.model._replace(A=np.array([[60.0, 1.0], [0.0, -1.0]])))
    with pytest.raises(UserError, match=r"grows by \d+ a sample over a delay of 39 samples.*shorten the delay"):
        chain.design(faster, chain.Options())
    with pytest.raises(UserError, match=r"lti\.A: got a plant that grows by 1e104 over the duration of 4 s"):
        pcbench.design(slow(A=[[60.0, 1.0], [0.0, -1.0]])[0], "chain")


def test_a_belief_that_is_no_whole_sample_is_refused_by_its_own_name():
    study, _, _ = slow()
    with pytest.raises(UserError, match=r"got an assumed_delay_error of 0\.05 s at a sampling period of 0\.1 s"):
        pcbench.design(study | {"axes": {"assumed_delay_error": [0.05]}}, "no-delay")
