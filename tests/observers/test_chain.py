"""The chain observer, and its rivals between samples and with wrong beliefs, equal the index-based reference.

All delay vectors of a plant go through one compiled program: delays are data. Tolerances are of the largest value of a state.
"""

import jax
import numpy as np
import pytest
import scipy.linalg
from chains import DELAYS, OUTPUTS, PLANTS, SLOW, START, links_of, record_cells, slow
from hypothesis import given, settings
from hypothesis import strategies as st
from reference import chain as ref

import pcbench
from pcbench import planning
from pcbench.observers import chain
from pcbench.runtime import config
from pcbench.simulation import rng, trajectory
from pcbench.simulation.schedule import common_times
from pcbench.simulation.schedule.common_times import NEVER

CASES = [
    pytest.param(i, id=str(each), marks=[pytest.mark.nightly] if each in SLOW else []) for i, each in enumerate(DELAYS)
]


@pytest.mark.parametrize("label", OUTPUTS)
@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("plant", ["tank", pytest.param("odd", marks=pytest.mark.nightly)])
def test_it_equals_the_index_based_reference(plant, case, label):
    cells, runs = record_cells(plant)
    p, run, delays = cells[case], runs[case], DELAYS[case]
    with config.float64():
        v = np.asarray(rng.measurement_noise(0, 3, len(run.x), 3)).T * p.problem.noise_std
    u, model = p.problem.inputs, PLANTS[plant]
    x, y = ref.simulate(model, u, START[plant], None, v)
    size = np.abs(x).max(0)
    np.testing.assert_array_less(np.abs(run.x - x).max(0), 1e-12 * size)
    want = ref.chain(model, links_of(plant, p, label, delays), u, ref.received(y, delays), delays, 0 * START[plant])
    np.testing.assert_array_less(
        np.abs(run.estimates[label] - want).max(0), 1e-12 * np.maximum(size, np.abs(want).max(0))
    )
    assert np.abs(x - want)[20:].max() > 1e-3, "noise is on"


@pytest.mark.parametrize("case", CASES)
@pytest.mark.parametrize("plant", ["tank", pytest.param("odd", marks=pytest.mark.nightly)])
def test_perfect_start_is_exact(plant, case):
    run = record_cells(plant, True)[1][case]
    for label in OUTPUTS:
        assert (np.abs(run.x - run.estimates[label]) < 1e-13 * np.abs(run.x).max(0)).all(), label


@pytest.mark.ci
@pytest.mark.parametrize("what", ["tau", "stamp", "source"])
@pytest.mark.parametrize("slip", [-1, 1])
def test_a_sample_of_slip_anywhere_is_caught(what, slip):
    """From a wrong start: from a perfect one the deviations that are filtered are zero, whenever they are read."""
    cells, runs = record_cells("odd")
    p, gains = cells[0], cells[0].problem.gains["chain"]
    one = slip * np.array([0, 1, 0])
    links = gains.links if what == "tau" else gains.links._replace(**{what: getattr(gains.links, what) + one})
    slipped = gains._replace(links=links, tau=gains.tau + one if what == "tau" else gains.tau)
    wrong = p.problem._replace(gains=p.problem.gains | {"chain": slipped})
    with config.float64():
        run = jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, wrong, np.asarray(0), np.asarray(3)))
    assert np.abs(run.estimates["chain"] - runs[0].estimates["chain"]).max() > 1e-3


def reference_chain(label, model, u, r, assumed_delays, xhat0):
    if label == "equal-delay":
        d = min(assumed_delays)
        K = d**d / (d + 1) ** (d + 1) * model.A @ np.linalg.inv(model.C)
        return ref.classic(model, u, r, xhat0, K, [d] * 2)
    if label == "no-delay-plain":
        return ref.classic(model, u, r, xhat0, (model.A - 0.4 * np.eye(2)) @ np.linalg.inv(model.C), [0, 0])
    links = ref.design(model, assumed_delays, pole=0.4)
    if label == "chain-riccati":
        A, b, Q, steps = np.array([[0.0, 1.0], [-2.0, -0.3]]), np.array([[0.0], [1.5]]), np.zeros((2, 2)), 400
        for i in range(steps):  # noise through the input over a sample, by sums at midpoints
            E = scipy.linalg.expm(A * 0.1 * (i + 0.5) / steps)
            Q += 2.0 * E @ b @ b.T @ E.T * 0.1 / steps
        links = ref.design(model, assumed_delays, "riccati", Q=Q, R=1e-12 * np.eye(2))
    return ref.chain(model, links, u, r, assumed_delays, xhat0)


@pytest.mark.nightly
def test_between_samples_they_follow_the_model():
    """The reference at the samples, the held model's motion between them."""
    study, fine, model = slow()
    d = pcbench.simulate(study, SLOW)
    u = d[["u1"]].to_numpy()
    _, y = ref.simulate(model, u[::10], np.array([1.0, -2.0]))
    for label in SLOW:
        got = d[[f"{label}.x1", f"{label}.x2"]].to_numpy()
        want = reference_chain(label, model, u[::10], ref.received(y, [2, 5]), [2, 5], np.zeros(2))
        rough = 1e-5 if label == "chain-riccati" else 1e-12  # the reference's Q is a sum, its P an iteration
        np.testing.assert_allclose(got[::10], want, atol=rough, err_msg=label)
        for k in range(400):
            if (k + 1) % 10:
                np.testing.assert_allclose(got[k + 1], fine[0] @ got[k] + fine[1] @ u[k], atol=1e-12)


@pytest.mark.parametrize("error", [pytest.param(0.1, marks=pytest.mark.nightly), -0.1])
def test_with_a_wrongly_assumed_delay_they_are_the_references_with_that_delay(error):
    """What arrives is assumed to be a sample older or younger than it is; none is assumed to be taken before 0.

    Between samples they follow the model all the same.
    """
    study, fine, model = slow()
    off = round(error / 0.1)
    study |= {"axes": {"assumed_delay_error": [error]}}
    labels = ["chain", "equal-delay", "no-delay-plain"]
    d = pcbench.simulate(study | {"observers": labels}, labels)
    held = d[["u1"]].to_numpy()
    u = held[::10]
    _, y = ref.simulate(model, u, np.array([1.0, -2.0]))
    r = ref.received(y, [2, 5])
    between = np.arange(1, len(d)) % 10 > 0
    for label in labels:
        got = d[[f"{label}.x1", f"{label}.x2"]].to_numpy()
        want = reference_chain(label, model, u, r, [2 + off, 5 + off], np.zeros(2))
        np.testing.assert_allclose(got[::10], want, atol=1e-11, err_msg=label)
        moved = got[:-1] @ fine[0].T + held[:-1] @ fine[1].T
        np.testing.assert_allclose(got[1:][between], moved[between], atol=1e-11, err_msg=label)


@pytest.mark.ci
@pytest.mark.parametrize("older", [1, 3])
def test_samples_assumed_to_be_from_before_0_are_left_out(older):
    """Samples are assumed to be older than they are, the first ones from before tick 0. All tests compile one program."""
    cells, _ = record_cells("odd")
    p, model, delays = cells[0], PLANTS["odd"], [2, 0, 4]
    N = len(p.problem.inputs) - 1
    sent = [common_times.Sample(j, k, k, k + delays[j]) for k in range(N + 1) for j in range(3)]
    assumed_delays = [d + older for d in delays]
    known = planning.context_of(p.cell)._replace(delay=tuple(assumed_delays), reach=9, error=older)
    gains = p.problem.gains | {"chain": chain.design(known, chain.Options(pole=0.4)).gains}
    plan = common_times.pad_slots(common_times.schedule(sent, N, 3, older), 3)
    problem = p.problem._replace(gains=gains, schedule=plan, noise_std=np.zeros(3))
    with config.float64():
        run = jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, problem, np.asarray(0), np.asarray(3)))
    _, y = ref.simulate(model, p.problem.inputs, START["odd"])
    links = links_of("odd", p._replace(problem=problem), "chain", assumed_delays)
    want = ref.chain(model, links, p.problem.inputs, ref.received(y, delays), assumed_delays, 0 * START["odd"])
    np.testing.assert_array_less(np.abs(run.estimates["chain"] - want).max(0), 1e-11 * np.abs(want).max(0))


@pytest.mark.ci
@settings(max_examples=15)
@given(
    delays=st.lists(st.integers(0, 9), min_size=3, max_size=3).filter(any),
    loss=st.floats(0.0, 0.6),
    pole=st.floats(-0.7, 0.9),
    seed=st.integers(0, 2**16),
)
def test_it_equals_the_reference_for_any_delays_and_losses(delays, loss, pole, seed):
    """Traced delays and any pattern of losses, a wrong start, D != 0; one compiled program for all examples."""
    cells, _ = record_cells("odd")
    p, model, rng = cells[0], PLANTS["odd"], np.random.default_rng(seed)
    N = len(p.problem.inputs) - 1
    lost = rng.random((N + 1, 3)) < loss
    sent = [(j, k, NEVER if lost[k, j] else k + delays[j]) for k in range(N + 1) for j in range(3)]
    plan = common_times.schedule([common_times.Sample(j, k, k, due) for j, k, due in sent], N, 3)
    known = planning.context_of(p.cell)._replace(delay=tuple(delays), reach=9)
    design = chain.design(known, chain.Options(pole=pole if abs(pole) > 0.05 else 0.05, gain="poles"))
    xhat0, x0 = rng.standard_normal(4), rng.standard_normal(4)
    changed = {"schedule": common_times.pad_slots(plan, 3), "xhat0": xhat0, "x0": x0, "noise_std": np.zeros(3)}
    problem = p.problem._replace(gains=p.problem.gains | {"chain": design.gains}, **changed)
    with config.float64():
        run = jax.tree.map(np.asarray, trajectory.jit_record()(p.layout, problem, np.asarray(0), np.asarray(3)))
    u = p.problem.inputs
    _, y = ref.simulate(model, u, x0)
    links = links_of("odd", p._replace(problem=problem), "chain", delays)
    heard = ref.received(np.where(lost, np.nan, y), delays)
    want = ref.chain(model, links, u, heard, delays, xhat0)
    np.testing.assert_array_less(np.abs(run.estimates["chain"] - want).max(0), 1e-11 * np.abs(want).max(0))
