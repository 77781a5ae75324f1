"""equal-delay and no-delay: what they compute is the delayed output error, and they fail as they must.

The tank with sensors 2, 5 and 7 samples late; other delay vectors; a plant with D != 0 on which losses occur.
"""

from functools import cache

import jax
import numpy as np
import pytest
from chains import DELAYS, SLOW, START
from reference import chain as ref

import pcbench
from pcbench import planning
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.simulation import trajectory
from pcbench.study import parse
from pcbench.synthesis.certificate import is_certified

NAMES = ["volume", "enthalpy", "jacket_temperature"]
TANK, ZERO = ref.csth("10s"), np.zeros(3)
INV = np.linalg.inv(TANK.C)
K_NONE = (TANK.A - 1e-4 * np.eye(3)) @ INV
LABELS = {
    "equal-delay": {},
    "equal-delay-one": {"variant": "theorem1"},
    "no-delay": {},
    "no-delay-plain": {"variant": "plain"},
}


def estimates(frame, label, names=NAMES):
    return frame[[f"{label}.{name}" for name in names]].to_numpy()


VECTORS = [d for d in DELAYS if d != [4, 4, 4]] + [[2, 2, 2]]


@cache
def recorded():
    """Every delay vector, by one compiled program: (inputs, estimates by label)."""
    axes = {"delay": [[10.0 * d for d in delays] for delays in VECTORS]}
    raw = {
        "name": "rivals",
        "scenarios": ["csth/10s"],
        "options": LABELS,
        "axes": axes,
        "observers": [*LABELS, "chain"],
    }
    with config.float64():
        cells = planning.plan(parse.parse(raw, "rivals"))
        runs = [trajectory.jit_record()(p.layout, p.problem, np.asarray(0), np.asarray(0)) for p in cells]
    found = [jax.tree.map(np.asarray, run.estimates) for run in runs]
    return {tuple(d): (p.problem.inputs, run) for d, p, run in zip(VECTORS, cells, found, strict=True)}


def reference_estimates(label, u, r, delays):
    d = max(min(delays), 1)
    held = d**d / (d + 1) ** (d + 1) * TANK.A @ INV
    if label == "equal-delay":
        return ref.classic(TANK, u, r, ZERO, held, [d] * 3)
    if label == "equal-delay-one":
        return ref.theorem1(TANK, u, r, ZERO, ref.design(TANK, [d] * 3)[0].K, d)
    return ref.classic(TANK, u, r, ZERO, K_NONE, [0] * 3 if label.endswith("plain") else delays)


@pytest.mark.parametrize("label", LABELS)
@pytest.mark.parametrize(
    "delays",
    [pytest.param(vector, id=str(vector), marks=[pytest.mark.nightly] if vector in SLOW else []) for vector in VECTORS],
)
def test_they_equal_the_reference(label, delays):
    u, found = recorded()[tuple(delays)]
    _, y = ref.simulate(TANK, u, START["tank"])
    want = reference_estimates(label, u, ref.received(y, delays), delays)
    got = found[label]
    size = np.maximum.accumulate(np.abs(want), 0).max(1)[:, None] * START["tank"] / 2e4  # aligned grows without bound
    assert (np.abs(got - want) < 1e-10 * np.maximum(size, 0.1 * START["tank"])).all()


@pytest.mark.parametrize(
    ("label", "k", "printed"),
    [
        ("equal-delay-one", 50, [2.5, 2.8465044559e5, 4.5680733741]),
        ("equal-delay", 50, [2.4999999732, 2.7097829450e5, 4.3700995126]),
        ("no-delay-plain", 50, [2.1, 2.8633309485e5, 4.8157140620]),
        ("no-delay", 20, [-4.9909949017e-1, -3.2243678333e3, -1.1434965267e1]),
        ("chain", 5, [1.4999999950, 4.3183484563e4, 6.2595275690e-1]),
        ("chain", 8, [2.1, 7.9115477771e4, 5.4659753915]),
        ("chain", 10, [2.5, 1.0126034014e5, 5.5226189110]),
    ],
)
def test_the_worked_trajectories_come_out(label, k, printed):
    np.testing.assert_allclose(recorded()[2, 5, 7][1][label][k], printed, rtol=1e-10)


@pytest.mark.ci
def test_aligned_starts_perfectly_until_rounding_has_grown():
    start = list(START["tank"])
    s = SCENARIOS["csth/10s"]
    SCENARIOS["perfect"] = s.with_fields(name="perfect", xhat0=tuple(start))
    try:
        d = pcbench.simulate("perfect", "no-delay")
    finally:
        del SCENARIOS["perfect"]
    x = d[NAMES].to_numpy()
    assert (np.abs(x - estimates(d, "no-delay"))[:20] < 1e-13 * np.abs(x).max(0)).all()


@pytest.mark.ci
def test_those_who_pretend_one_delay_start_perfectly_where_it_is_so():
    s = SCENARIOS["csth/10s"]
    SCENARIOS["perfect"] = s.with_fields(name="perfect", xhat0=s.truth.x0, delay=(20.0,) * 3, options=LABELS)
    try:
        d = pcbench.simulate("perfect", ["equal-delay", "equal-delay-one"])
    finally:
        del SCENARIOS["perfect"]
    x = d[NAMES].to_numpy()
    for label in ("equal-delay", "equal-delay-one"):
        assert (np.abs(x - estimates(d, label)) < 1e-13 * np.abs(x).max(0)).all()


@pytest.mark.nightly
def test_aligned_is_reported_as_diverged_with_its_time_and_the_others_stay_clean():
    result = pcbench.run("csth/10s", observers=["chain", "no-delay"], seeds=2)
    assert result.runs.groupby("observer").diverged.all().to_dict() == {"chain": False, "no-delay": True}
    u = recorded()[2, 5, 7][0]
    x, y = ref.simulate(TANK, u, START["tank"])
    e = np.abs(x - ref.classic(TANK, u, ref.received(y, [2, 5, 7]), ZERO, K_NONE, [2, 5, 7]))
    first = np.flatnonzero((e > 1e6 * START["tank"]).any(1))[0]
    assert set(result.runs[result.runs.diverged].divergence_time) == {10.0 * first}
    lost = result.stats[(result.stats.observer == "no-delay") & (result.stats.metric == "mae")]
    assert lost.n.tolist() == [0] * 3
    assert lost["mean"].isna().all()


def test_the_radius_with_the_delays_as_they_are_is_reported_and_decides_whether_gains_are_certified():
    proof = pcbench.design("csth/10s", "no-delay").certificate
    assert not is_certified(proof._asdict())
    numbers = proof.numbers
    assert numbers["radius_with_these"] == pytest.approx(1.1623446, abs=5e-8)
    assert numbers["radius_without_delays"] == pytest.approx(1e-4, rel=1e-6)
    assert pcbench.design("csth/10s", "equal-delay").certificate.numbers["radius"] == pytest.approx(2 / 3, abs=1e-7)


@pytest.mark.nightly
def test_losses_and_feedthrough_are_what_the_page_says():
    """No correction from a channel that brings nothing; D u of the assumed time is taken off."""
    rng = np.random.default_rng(5)
    A = np.array([[0.9, 0.2, 0.0], [-0.1, 0.8, 0.1], [0.05, 0.0, 0.7]])
    model = ref.Plant(
        A, rng.standard_normal((3, 2)), np.eye(3) + 0.2 * rng.standard_normal((3, 3)), rng.standard_normal((3, 2))
    )
    delays = [1, 3, 2]
    lti = {name: np.asarray(M).tolist() for name, M in zip("ABCD", model, strict=False)}
    lti |= {"dt": 1.0, "sampling_period": 1.0, "delay": [1.0, 3.0, 2.0], "noise_std": [0.1, 0.2, 0.1], "loss": 0.3}
    lti |= {"input": "sine, square", "duration": 60.0, "x0": [1.0, -2.0, 0.5]}
    options = LABELS | {"equal-delay-one": {"variant": "theorem1", "delay": 2}, "no-delay": {"pole": 0.3}}
    d = pcbench.simulate({"name": "odd", "lti": lti, "options": options}, list(LABELS), seed=1)
    u, held = d[["u1", "u2"]].to_numpy(), d[["y1", "y2", "y3"]].to_numpy()
    r = np.where(np.vstack([np.isnan(held[:1]), held[1:] == held[:-1]]), np.nan, held)  # what came is what changed
    assert 0.2 < np.isnan(r[5:]).mean() < 0.4
    inv = np.linalg.inv(model.C)
    want = {
        "equal-delay": ref.classic(model, u, r, ZERO, A @ inv / 4, [1, 1, 1]),
        "equal-delay-one": ref.theorem1(model, u, r, ZERO, ref.design(model, [2, 2, 2])[0].K, 2),
        "no-delay": ref.classic(model, u, r, ZERO, (A - 0.3 * np.eye(3)) @ inv, delays),
        "no-delay-plain": ref.classic(model, u, r, ZERO, (A - 0.3 * np.eye(3)) @ inv, [0, 0, 0]),
    }
    for label, xhat in want.items():
        got = estimates(d, label, ["x1", "x2", "x3"])
        grown = np.maximum.accumulate(np.abs(xhat).max(1))[:, None]
        assert (np.abs(got - xhat) < 1e-11 * np.maximum(grown, 1.0)).all(), label
