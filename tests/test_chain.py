"""The chain observer equals the index-based reference on every delay vector, starts perfectly, and its certificate is its map.

All vectors of a plant go through one compiled program: delays are data. Tolerances are of the largest value of each state.
"""

import json
from functools import cache

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import chain as ref

import pcbench
from pcbench import draws, machine, planning, recording, sampling, study_file
from pcbench.observers import chain
from pcbench.sampling import NEVER
from pcbench.synthesis import chain as synthesis
from pcbench.synthesis import shared_lyapunov

DELAYS = [[2, 5, 7], [7, 2, 5], [3, 3, 6], [4, 4, 4], [0, 2, 5], [1, 9, 1]]
OUTPUTS = {"chain": "updated", "chain-b": "deadbeat"}
OPTIONS = {
    "tank": {"chain": {"pole": 0.3}, "chain-b": {"gain": "riccati", "q": 1.0, "output": "deadbeat"}},
    "odd": {
        "chain": {"pole_per_tick": 0.6},
        "chain-b": {"gain": "riccati", "q": 0.5, "output": "deadbeat"},
    },
}


def random_plant():
    """Four states, two inputs, three outputs, D != 0, nothing symmetric; it barely decays."""
    rng = np.random.default_rng(11)
    A = rng.standard_normal((4, 4))
    A *= 0.97 / ref.radius(A)
    return ref.Plant(A, *(rng.standard_normal(shape) for shape in [(4, 2), (3, 4), (3, 2)]))


PLANTS = {"tank": ref.csth("10s"), "odd": random_plant()}
START = {"tank": np.array([0.5, 2e4, 5.0]), "odd": np.array([1.0, -2.0, 0.5, 3.0])}


def study(plant, xhat0=None):
    """A study of the plant with every delay vector as a cell; noise in every channel unless it starts perfectly."""
    p, x0 = PLANTS[plant], START[plant]
    dt, start = p.Ts, np.zeros_like(x0) if xhat0 is None else xhat0
    lti = {name: np.asarray(M).tolist() for name, M in zip("ABCD", p, strict=False)}
    lti |= {"dt": dt, "sampling_period": dt, "delay": 0.0, "noise_std": 0.0 if xhat0 is not None else [0.3, 0.1, 0.2]}
    lti |= {"input": "sine, square", "horizon": 40 * dt, "x0": x0.tolist(), "xhat0": list(start)}
    lti |= {"prior_std": np.abs(x0).tolist()}
    axes = {"delay": [[float(d * dt) for d in delays] for delays in DELAYS]}
    raw = {"name": plant, "lti": lti, "observers": list(OUTPUTS), "options": OPTIONS[plant], "axes": axes}
    return study_file.parse(raw, plant)


@cache
def recorded(plant, perfect=False):
    """Every cell, planned and recorded; one program serves them all."""
    with machine.float64():
        cells = planning.plan(study(plant, START[plant] if perfect else None))
        before = recording.compiled()._cache_size()
        runs = [recording.compiled()(p.layout, p.problem, np.asarray(0), np.asarray(3)) for p in cells]
        assert recording.compiled()._cache_size() - before <= 1
    return cells, jax.tree.map(np.asarray, runs)


def links_of(plant, p, label, delays):
    """The reference's links with the gains under test (gains have a test of their own)."""
    steps, masks = ref.shape(delays)[1:]
    gains = p.problem.gains[label].links
    K = [np.asarray(K) for K, d in zip(gains.K, gains.source - gains.stamp, strict=True) if d > 0][::-1]
    return [ref.link(PLANTS[plant], d, m, k, OUTPUTS[label]) for d, m, k in zip(steps, masks, K, strict=True)]


@pytest.mark.parametrize("label", OUTPUTS)
@pytest.mark.parametrize("case", range(len(DELAYS)), ids=lambda i: str(DELAYS[i]))
@pytest.mark.parametrize("plant", PLANTS)
def test_it_equals_the_index_based_reference(plant, case, label):
    cells, runs = recorded(plant)
    p, run, delays = cells[case], runs[case], DELAYS[case]
    with machine.float64():
        v = np.asarray(draws.measurement_noise(0, 3, len(run.x), 3)).T * p.problem.noise_std
    u, model = p.problem.inputs, PLANTS[plant]
    x, y = ref.simulate(model, u, START[plant], None, v)
    size = np.abs(x).max(0)
    np.testing.assert_array_less(np.abs(run.x - x).max(0), 1e-12 * size)
    want = ref.chain(model, links_of(plant, p, label, delays), u, ref.received(y, delays), delays, 0 * START[plant])
    np.testing.assert_array_less(
        np.abs(run.estimates[label] - want).max(0), 1e-12 * np.maximum(size, np.abs(want).max(0))
    )
    assert np.abs(x - want)[20:].max() > 1e-3, "noise is on"


@pytest.mark.parametrize("case", range(len(DELAYS)), ids=lambda i: str(DELAYS[i]))
@pytest.mark.parametrize("plant", PLANTS)
def test_perfect_start_is_exact(plant, case):
    run = recorded(plant, True)[1][case]
    for label in OUTPUTS:
        assert (np.abs(run.x - run.estimates[label]) < 1e-13 * np.abs(run.x).max(0)).all(), label


@pytest.mark.parametrize("what", ["tau", "stamp", "source"])
@pytest.mark.parametrize("slip", [-1, 1])
def test_a_sample_of_slip_anywhere_is_caught(what, slip):
    """From a wrong start: from a perfect one the deviations that are filtered are zero, whenever they are read."""
    cells, runs = recorded("odd")
    p, gains = cells[0], cells[0].problem.gains["chain"]
    one = slip * np.array([0, 1, 0])
    links = gains.links if what == "tau" else gains.links._replace(**{what: getattr(gains.links, what) + one})
    slipped = gains._replace(links=links, tau=gains.tau + one if what == "tau" else gains.tau)
    wrong = p.problem._replace(gains=p.problem.gains | {"chain": slipped})
    with machine.float64():
        run = jax.tree.map(np.asarray, recording.compiled()(p.layout, wrong, np.asarray(0), np.asarray(3)))
    assert np.abs(run.estimates["chain"] - runs[0].estimates["chain"]).max() > 1e-3


@pytest.mark.parametrize("case", range(len(DELAYS)), ids=lambda i: str(DELAYS[i]))
@pytest.mark.parametrize("label", OUTPUTS)
def test_its_map_of_one_sample_is_the_certificates_and_the_references(case, label):
    """The map of the functions themselves, column by column, in shift coordinates: all channels known, y - C xbar = 0."""
    cells, _ = recorded("odd")
    p, delays = cells[case], DELAYS[case]
    gains, theta, n, k = jax.tree.map(jnp.asarray, p.problem.gains[label]), max(delays), 4, 50
    with machine.float64():
        start = chain.init(gains, jnp.zeros(n))
        ring = len(start.past) - 1
        place = start.place._replace(tick=jnp.asarray(k), sample=jnp.asarray(k))
        heard = tuple(jnp.ones_like(known) for known in start.known)
        start = start._replace(place=place, known=heard, fresh=jnp.ones(3, bool))

        @jax.jit
        def step(errors):
            slots = (k - 1 - np.arange(theta)) % ring
            memory = start._replace(past=start.past.at[slots].set(errors.reshape(theta, n)))
            now = pcbench.types.Now(
                jnp.asarray(0.0), jnp.asarray(k), jnp.asarray(1.0), jnp.zeros(2), lambda age: jnp.zeros(2)
            )
            return chain.flow(gains, memory, now).past[(k - np.arange(theta)) % ring].reshape(-1)

        J = np.stack([np.asarray(step(e)) for e in np.eye(n * theta)], 1)
    model, links = PLANTS["odd"], links_of("odd", p, label, delays)
    found = [synthesis.Link(one.d, np.array(one.mask, float), one.F, one.K, one.V, one.W) for one in links]
    np.testing.assert_allclose(J, ref.jacobian(model, links), atol=1e-12 * np.abs(J).max())
    np.testing.assert_allclose(synthesis.one_sample(found, model.C), J, atol=1e-12 * np.abs(J).max())
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


SLOW = ["chain", "chain-riccati", "equal-delay", "no-delay-plain"]


def slow(**lti):
    """Ten ticks to a sample, two sensors, D != 0."""
    A, B, C, D = [[0.0, 1.0], [-2.0, -0.3]], [[0.0], [1.5]], [[1.0, 0.0], [0.3, 1.0]], [[0.4], [-0.2]]
    given = {
        "A": A,
        "B": B,
        "C": C,
        "D": D,
        "tick": 0.01,
        "sampling_period": 0.1,
        "delay": [0.2, 0.5],
        "noise_std": 0.0,
    }
    given |= {"input": "square", "horizon": 4.0, "x0": [1.0, -2.0]}
    options = {
        "chain": {"pole": 0.4},
        "chain-riccati": {"gain": "riccati", "q": 2.0},
        "no-delay-plain": {"variant": "plain"},
    }
    study = {"name": "slow", "lti": given | lti, "options": options | {"no-delay": {"pole": 0.4}}, "observers": SLOW}
    matrices = [np.array(M) for M in (A, B, C, D)]
    fine = ref.discretise(matrices[0], matrices[1], 0.01)
    model = ref.Plant(*ref.discretise(matrices[0], matrices[1], 0.1), *matrices[2:], 0.1)
    return study, fine, model


def expected(label, model, u, r, believed, xhat0):
    if label == "equal-delay":
        d = min(believed)
        K = d**d / (d + 1) ** (d + 1) * model.A @ np.linalg.inv(model.C)
        return ref.classic(model, u, r, xhat0, K, [d] * 2)
    if label == "no-delay-plain":
        return ref.classic(model, u, r, xhat0, (model.A - 0.4 * np.eye(2)) @ np.linalg.inv(model.C), [0, 0])
    links = ref.design(model, believed, pole=0.4)
    if label == "chain-riccati":
        A, b, Q, steps = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.5]]), np.zeros((2, 2)), 400
        for i in range(steps):  # noise through the input over a sample, by sums at midpoints
            E = scipy.linalg.expm(A * 0.1 * (i + 0.5) / steps)
            Q += 2.0 * E @ b @ b.T @ E.T * 0.1 / steps
        links = ref.design(model, believed, "riccati", Q=Q, R=1e-12 * np.eye(2))
    return ref.chain(model, links, u, r, believed, xhat0)


def test_between_samples_they_follow_the_model():
    """The reference at the samples, the held model's motion between them."""
    study, fine, model = slow()
    d = pcbench.trace(study, SLOW)
    u = d[["u1"]].to_numpy()
    _, y = ref.simulate(model, u[::10], np.array([1.0, -2.0]))
    for label in SLOW:
        got = d[[f"{label}.x1", f"{label}.x2"]].to_numpy()
        want = expected(label, model, u[::10], ref.received(y, [2, 5]), [2, 5], np.zeros(2))
        rough = 1e-5 if label == "chain-riccati" else 1e-12  # the reference's Q is a sum, its P an iteration
        np.testing.assert_allclose(got[::10], want, atol=rough, err_msg=label)
        for k in range(400):
            if (k + 1) % 10:
                np.testing.assert_allclose(got[k + 1], fine[0] @ got[k] + fine[1] @ u[k], atol=1e-12)


@pytest.mark.parametrize("error", [0.1, -0.1])
def test_with_a_wrongly_believed_delay_they_are_the_references_with_that_belief(error):
    """What arrives is believed a sample older or younger than it is; none is believed taken before 0."""
    study, _, model = slow()
    off = round(error / 0.1)
    study |= {"axes": {"assumed_delay_error": [error]}}
    labels = ["chain", "equal-delay", "no-delay-plain"]
    d = pcbench.trace(study | {"observers": labels}, labels)
    u = d[["u1"]].to_numpy()[::10]
    _, y = ref.simulate(model, u, np.array([1.0, -2.0]))
    r = ref.received(y, [2, 5])
    for label in labels:
        want = expected(label, model, u, r, [2 + off, 5 + off], np.zeros(2))
        np.testing.assert_allclose(d[[f"{label}.x1", f"{label}.x2"]].to_numpy()[::10], want, atol=1e-11, err_msg=label)


def test_sensors_that_repeat_each_other_share_a_gain():
    """A fast and a slow sensor of one quantity, and three outputs for two states."""
    for C in ([[1.0, 0.0], [2.0, 0.0]], [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]):
        lti = {"C": C, "D": None, "delay": [0.2, 0.5, 0.5][: len(C)]}
        study, _, _ = slow(**lti)
        gains = pcbench.design(study, "chain").gains.links
        for F in gains.F[np.asarray(gains.source) > np.asarray(gains.stamp)]:
            poles = np.sort(np.linalg.eigvals(F))
            np.testing.assert_allclose(poles, [0.36, 0.4] if len(C) == 2 else [0.4, 0.4], rtol=1e-6)


@pytest.mark.parametrize("options", [{}, {"pole_per_tick": 0.8}, {"gain": "riccati", "output": "deadbeat"}], ids=str)
def test_the_papers_condition_is_reported_with_a_p_that_proves_it(options):
    """(29) at the P and e that were found, with the couplings read from the reference's map of one sample."""
    given = [f"options.chain.{key}={json.dumps(value)}" for key, value in (options | {"shared": True}).items()]
    design = pcbench.design("csth/10s", "chain", overrides=given)
    numbers, links = design.certificate.numbers, design.gains.links
    S = np.diag([0.5, 2e4, 5.0])
    want = [ref.Link(int(a - b), list(m > 0), *each) for a, b, m, *each in zip(
        links.source, links.stamp, links.seen, links.F, links.K, links.V, links.W, strict=True)][::-1]  # fmt: skip
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
    links = [link._replace(seen=np.array([0.0])), link]
    assert synthesis.certify(links, np.eye(1), "test").margin == pytest.approx(0.1, abs=1e-6)
    assert not shared_lyapunov.check(links, np.ones(1), "test")["shared_margin"] > 0


@settings(max_examples=15, deadline=None)
@given(
    delays=st.lists(st.integers(0, 9), min_size=3, max_size=3).filter(any),
    loss=st.floats(0.0, 0.6),
    pole=st.floats(-0.7, 0.9),
    seed=st.integers(0, 2**16),
)
def test_it_equals_the_reference_for_any_delays_and_losses(delays, loss, pole, seed):
    """Traced delays and any pattern of losses, a wrong start, D != 0; one compiled program for all examples."""
    cells, _ = recorded("odd")
    p, model, rng = cells[0], PLANTS["odd"], np.random.default_rng(seed)
    N = len(p.problem.inputs) - 1
    lost = rng.random((N + 1, 3)) < loss
    sent = [(j, k, NEVER if lost[k, j] else k + delays[j]) for k in range(N + 1) for j in range(3)]
    plan = sampling.schedule([sampling.Sample(j, k, k, due) for j, k, due in sent], N, 3)
    known = planning.setting(p.cell)._replace(delay=tuple(delays), reach=9)
    design = chain.design(known, chain.Options(pole=pole if abs(pole) > 0.05 else 0.05, gain="poles"))
    xhat0, x0 = rng.standard_normal(4), rng.standard_normal(4)
    changed = {"schedule": sampling.pad_slots(plan, 3), "xhat0": xhat0, "x0": x0, "noise_std": np.zeros(3)}
    problem = p.problem._replace(gains=p.problem.gains | {"chain": design.gains}, **changed)
    with machine.float64():
        run = jax.tree.map(np.asarray, recording.compiled()(p.layout, problem, np.asarray(0), np.asarray(3)))
    u = p.problem.inputs
    _, y = ref.simulate(model, u, x0)
    links = links_of("odd", p._replace(problem=problem), "chain", delays)
    heard = ref.received(np.where(lost, np.nan, y), delays)
    want = ref.chain(model, links, u, heard, delays, xhat0)
    np.testing.assert_array_less(np.abs(run.estimates["chain"] - want).max(0), 1e-11 * np.abs(want).max(0))
