"""A run has the same bits alone, in a block, in another block, on one device or two, and with other observers present."""

import jax.numpy as jnp
import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench import planning
from pcbench.dataset import verify
from pcbench.engine import runner
from pcbench.planning import build, run_local
from pcbench.scenarios import SCENARIOS
from pcbench.simulation.rng import measurement_noise, normals, run_keys
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("as_users_have_it")
EVERYONE = ["pccebo", "kfbo", "kf", "model-only"]
TWO = ["pccebo", "kf"]
SEVEN = np.array([7])


def results(
    seeds,
    observers=EVERYONE,
    scenarios=("cart/gaussian-fast",),
    devices=2,
    random_initial_state=True,
    axes=None,
    engine=None,
):
    raw = {"name": "bits", "scenarios": list(scenarios), "observers": observers, "axes": axes or {}, "engine": engine}
    raw |= {"seeds": len(seeds)}  # calls are as wide as they ask for
    chosen = parse.parse(raw | {"options": {"scenario": {"random_initial_state": random_initial_state}}}, "bits")
    done = list(run_local.execute(chosen, planning.plan(chosen), seeds=np.asarray(seeds), devices=devices))
    return {d.plan.cell.scenario.name + str(d.plan.cell.number): d.results for d in done}


def same(a, b, place, observers=EVERYONE):
    """Every metric of the only run in a equals, bit for bit, the run at `place` in b."""
    for observer in observers:
        for metric, values in a[observer].items():
            np.testing.assert_array_equal(
                values[..., 0], b[observer][metric][..., place], err_msg=f"{observer} {metric}"
            )


@pytest.fixture(scope="module")
def alone(as_users_have_it):
    return results(SEVEN)["cart/gaussian-fast0"]


@pytest.fixture(scope="module", params=[TWO, pytest.param(EVERYONE, marks=pytest.mark.nightly)], ids=str)
def some(request, as_users_have_it):
    """Observers and their run alone."""
    return request.param, results(SEVEN, request.param)["cart/gaussian-fast0"]


@pytest.mark.ci
def test_alone_equals_in_a_block(some):
    observers, alone = some
    same(alone, results(np.arange(20), observers)["cart/gaussian-fast0"], 7, observers)


@pytest.mark.nightly
def test_alone_equals_in_a_full_block_and_in_the_next_one(alone):
    """Alone in a call of 64 lanes."""
    block = results(np.concatenate([np.arange(100, 100 + runner.WIDTH), SEVEN]))["cart/gaussian-fast0"]
    same(alone, block, runner.WIDTH)
    same(alone, results(np.concatenate([np.arange(100, 99 + runner.WIDTH), SEVEN]))["cart/gaussian-fast0"], -1)


@pytest.mark.ci
def test_one_device_equals_two(some):
    observers, alone = some
    same(alone, results(SEVEN, observers, devices=1)["cart/gaussian-fast0"], 0, observers)


@pytest.mark.ci
def test_alone_equals_without_another_observer(some):
    """Other observers make another program, the same bits."""
    observers, among = some
    same(results(SEVEN, observers[-1:])["cart/gaussian-fast0"], among, 0, observers[-1:])


@pytest.mark.nightly
@pytest.mark.parametrize("observers", [["kfbo", "pccebo"], ["pccebo"], ["kfbo"], ["kf"]], ids=str)
def test_alone_equals_without_the_other_observers(alone, observers):
    only = results(SEVEN, observers=observers)["cart/gaussian-fast0"]
    same(only, alone, 0, observers)


@pytest.mark.nightly
def test_alone_equals_among_other_cells_and_scenarios(alone):
    """Other cells make the network's ring larger: another program, the same bits."""
    many = results(SEVEN, scenarios=("cart/nominal", "cart/gaussian-fast"), axes={"delay": [0.6, 3.0]})
    same(alone, many["cart/gaussian-fast0"], 0)


PRESENT = {  # the first: none
    "outlier_probability": [0.0, 0.3],
    "quantization_step": [0.0, 1.0],
    "student_t_dof": [float("inf"), 3.0],
}  # the first: none
KINDS = [  # scenario, observers, axes: a shared schedule, a random one, nonlinear plants
    ("cart/gaussian", ["kf"], {"process_std": [[0.02, 0.0]]}, "steps"),
    ("cart/gaussian", ["kf"], {"loss": [0.2]}, "steps"),
    *(
        pytest.param(*kind, engine, marks=pytest.mark.nightly)
        for engine in ("steps", "definition")
        for kind in (
            ("cart/gaussian", TWO, {"process_std": [[0.02, 0.0]]}),
            ("cart/gaussian", TWO, {"loss": [0.2]}),
            ("arm/sampled", ["ekf"], {}),
            ("reactor/batch", ["ekf", "ukf"], {}),
        )
    ),
]


@pytest.mark.ci
@pytest.mark.parametrize(("scenario", "observers", "axes", "engine"), KINDS)
def test_run_equals_alone_among_cells_with_outliers_rounding_and_students_noise(scenario, observers, axes, engine):
    """They share a program, in which its samples are outliers with probability 0 and are rounded to steps of 0."""
    alone = results(SEVEN, observers, (scenario,), axes=axes, engine=engine)
    many = results(SEVEN, observers, (scenario,), axes=axes | PRESENT, engine=engine)
    assert len(many) == 8
    same(alone[scenario + "0"], many[scenario + "0"], 0, observers)


@pytest.mark.nightly
def test_on_the_arm_with_drift_too(monkeypatch):
    """Each run's own stiffness, a heavy plant's narrower calls, unknown inputs."""
    arm, three = SCENARIOS["arm/sampled"], ["smo", "pio", "kf"]
    monkeypatch.setitem(SCENARIOS, "arm/sampled", arm.with_fields(duration=0.5, steady_start=0.25))

    def found(seeds, devices=2):
        return results(seeds, three, ("arm/sampled",), devices, False, {"parameter_drift": [0.05]})["arm/sampled0"]

    alone, width = found(SEVEN), runner.HEAVY_WIDTH
    same(alone, found(np.arange(20)), 7, three)
    same(alone, found(np.concatenate([np.arange(100, 100 + width), SEVEN])), width, three)
    same(alone, found(SEVEN, devices=1), 0, three)


@pytest.mark.nightly
@pytest.mark.slow
@pytest.mark.parametrize(
    ("observer", "more"), [("ukf", {}), ("ekf-iterated", {}), ("pco", {}), ("kf-cloning", {"delay": 1.6})]
)
def test_a_study_has_the_same_bits_with_few_seeds_and_many_and_comes_out_again(observer, more, tmp_path):
    """A factorisation, or a product of large matrices, of many runs at once may depend on how many there are."""
    scenario = {"base": "cart/white", "name": "short", "duration": 2.0, "steady_start": 1.0, **more}
    study = {"name": "few", "scenario": scenario, "observers": [observer]}
    many, few = (pcbench.run(study, seeds=n, out=tmp_path / str(n)) for n in (130, 3))
    kept = many.runs[many.runs.seed < 3].sort_values(["signal", "seed"]).reset_index(drop=True)
    pd.testing.assert_frame_equal(
        kept, few.runs.sort_values(["signal", "seed"]).reset_index(drop=True), check_exact=True
    )
    for n in (130, 3):
        found = verify.verify(tmp_path / str(n), None, 0)
        assert (found.wrong, found.differing) == ([], [])
        assert found.recomputed


COUNTS = (1, 3, 8, 128, 2000)
FIVE = ["pccebo", "kfbo", "kf", "ukf", "kf-ignore-delay"]  # with ukf every call has 64 lanes


@pytest.mark.slow
@pytest.mark.parametrize(
    ("base", "engine", "every", "more"),
    [
        ("cart/white", "steps", FIVE, {}),
        ("cart/white", "definition", FIVE, {}),
        ("cart/white", "steps", TWO, {}),
        ("cart/white", "steps", TWO, {"sampling_period": 0.02, "delay_jitter": 0.05, "loss": 0.3}),
        ("ncs-two-state/held", "steps", ["kf"], {}),
        pytest.param("helicopter/constant", "steps", ["ekf"], {}, marks=pytest.mark.nightly),
        pytest.param("camera-target/following", "steps", ["kf", "kf-ignore-delay"], {}, marks=pytest.mark.nightly),
    ],
    ids=[
        "steps",
        "definition",
        "steps without ukf",
        "random schedules",
        "a loop",
        "a heavy loop",
        "a loop with late samples",
    ],
)
def test_a_run_has_the_same_bits_with_1_3_8_128_and_2000_seeds_and_one_observer_or_all(base, engine, every, more):
    scenario = {"base": base, "name": "short", "duration": 0.6, "steady_start": 0.3, "sampling_period": 0.2, **more}
    study = {"name": "counts", "scenario": scenario, "engine": engine}
    (cell,) = parse.grid_of(study | {"observers": every}, {}, []).cells
    assert {build.width(cell, n) for n in COUNTS} == ({64} if every == FIVE else {64, 256, build.width(cell)})

    def runs(n, observers=every):
        found = pcbench.run(study | {"observers": observers}, seeds=n).runs
        return found.set_index(["observer", "signal", "seed"]).sort_index()

    *small, many = map(runs, COUNTS)
    for few in (*small, *(runs(8, [observer]) for observer in every)):
        pd.testing.assert_frame_equal(
            many.loc[few.index].drop(columns="cell"), few.drop(columns="cell"), check_exact=True
        )


@pytest.mark.ci
def test_other_seeds_and_root_seeds_draw_other_noise():
    a, b, c = (np.asarray(measurement_noise(root, seed, 5)) for root, seed in ((0, 0), (0, 1), (1, 0)))
    assert len({a.tobytes(), b.tobytes(), c.tobytes()}) == 3
    long, several = np.asarray(measurement_noise(0, 0, 9)), np.asarray(measurement_noise(0, 0, 5, channels=3))
    np.testing.assert_array_equal(long[:, :5], a)
    np.testing.assert_array_equal(several[:1], a)
    assert len(np.unique(several)) == 15


@pytest.mark.nightly
def test_a_run_uses_the_studys_root_seed():
    raw = {"name": "roots", "scenarios": ["cart/white"], "observers": ["pccebo"], "seeds": 1}
    zero, one = (pcbench.run(raw | {"root_seed": root}).runs.mae[0] for root in (0, 1))
    assert zero != one
    trace = pcbench.simulate("cart/white", "pccebo", overrides=["root_seed=1"])
    assert (trace["position"] - trace["pccebo.position"]).abs()[:-1].mean() == pytest.approx(one, rel=1e-12)


@pytest.mark.ci
def test_streams_are_not_each_other():
    seeds = jnp.arange(4096)
    a, b = (normals(run_keys(jnp.asarray(0), seeds, s, 1), jnp.zeros(1, int))[0] for s in ("initial", "measurement"))
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(4096)


def test_draws_are_standard_normal():
    """Over 20,000 draws: mean within four standard errors of 0, variance within four of 1."""
    draws = np.asarray(measurement_noise(3, 0, 20_000)).ravel()
    assert abs(draws.mean()) < 4 / np.sqrt(20_000)
    assert abs(draws.var() - 1) < 4 * np.sqrt(2 / 20_000)
