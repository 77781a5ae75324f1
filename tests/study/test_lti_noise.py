"""Process noise on a plant of one's own: what pushes the plant, what designers are told, the bound, and what does not fit."""

import numpy as np
import pytest
from reference import irregular, linear, moments
from scipy.linalg import sqrtm

import pcbench
from pcbench import planning
from pcbench.errors import UserError
from pcbench.runtime import config
from pcbench.simulation import rng
from pcbench.study import parse
from pcbench.study.grid import cells_of

TICK, TICKS = 0.01, 80
PLANT = {  # three states, two inputs, two outputs of two clocks, no symmetry; noise enters by two columns, correlated
    "A": [[-1.0, 2.0, 0.3], [-4.0, -0.5, 1.0], [0.2, -0.7, 0.1]],
    "B": [[1.0, 0.0], [0.5, -2.0], [0.0, 3.0]],
    "C": [[1.0, 0.2, 0.0], [0.0, -0.4, 1.5]],
    "input": "sine, square",
    "sampling_period": [0.04, 0.03],
    "delay": [0.06, 0.01],
    "noise_std": [0.1, 0.3],
    "tick": TICK,
    "duration": TICK * TICKS,
    "x0": [1.0, -2.0, 0.5],
}
G = [[1.0, 0.0], [0.5, 0.2], [0.0, -1.0]]
QN = [[4.0, 1.0], [1.0, 2.0]]
FULL = PLANT | {"G": G, "QN": QN}
W = np.array(G) @ np.array(QN) @ np.array(G).T
MODEL = linear.Model(*(np.array(PLANT[k]) for k in "ABC"), TICK)
SLOW = np.eye(3) + TICK * MODEL.A  # of a discrete plant


def study(given=FULL, **changes):
    return {"name": "own", "lti": given | changes, "observers": ["kf", "ekf"]}


def the_cell(**asked):
    (cell,) = cells_of(parse.parse(study() | asked, "own"))
    return cell


def draw_normals(seed):
    """The standard normals of a run, [N+1, n]."""
    with config.float64():
        keys = rng.run_keys(np.asarray(0), np.array([seed]), "process", 3)
        return np.stack([np.asarray(rng.normals(keys, [k] * 3))[:, 0] for k in range(TICKS + 1)])


@pytest.mark.parametrize(
    ("given", "root"),
    [
        (FULL, np.real(sqrtm(linear.process_noise(MODEL.A, W, TICK)))),
        pytest.param(PLANT | {"process_std": [0.1, 0.0, 0.3]}, np.diag([0.1, 0.0, 0.3]), marks=pytest.mark.nightly),
        pytest.param(
            PLANT | {"dt": TICK, "A": SLOW.tolist(), "QN": [0.04, 0.0, 0.09]},
            np.diag([0.2, 0.0, 0.3]),
            marks=pytest.mark.nightly,
        ),
    ],
    ids=["G and QN", "process_std", "discrete"],
)
def test_the_plant_is_pushed_by_the_root_of_the_covariance_of_a_tick(given, root):
    d = pcbench.simulate(study(given), ["kf"], seed=2)
    x, u = d[["x1", "x2", "x3"]].to_numpy(), d[["u1", "u2"]].to_numpy()
    Phi, Gamma = linear.discretise(MODEL.A, MODEL.B, TICK)
    if "dt" in given:
        Phi, Gamma = SLOW, MODEL.B
    want, w = [np.array(PLANT["x0"])], draw_normals(2) @ root.T
    for k in range(TICKS):
        want.append(Phi @ want[k] + Gamma @ u[k] + w[k])
    np.testing.assert_allclose(x, want, rtol=0, atol=1e-10 * np.abs(want).max())


@pytest.mark.ci
def test_filters_equal_the_reference_that_knows_the_intensity():
    d = pcbench.simulate(study(), ["kf", "ekf"], seed=2)
    u, y = d[["u1", "u2"]].to_numpy(), d[["y1", "y2"]].to_numpy()
    samples = []
    for j, (te, late) in enumerate(((4, 6), (3, 1))):
        for i, taken in enumerate(range(0, len(u) - late, te)):
            samples.append(linear.Sample(taken + late, taken, j, i, y[taken + late, j]))
    P0, R = np.diag([1.0, 4.0, 0.25]), np.array([0.01, 0.09])
    want = irregular.kf(MODEL, u, samples, np.zeros(3), P0, R, W)
    for observer in ("kf", "ekf"):
        got = d[[f"{observer}.x{i}" for i in (1, 2, 3)]].to_numpy()
        np.testing.assert_allclose(got, want, rtol=0, atol=1e-10 * np.abs(want).max(), err_msg=observer)


def test_the_bound_is_that_of_the_noise_that_there_is_whatever_designers_assume():
    R, P0 = np.array([0.01, 0.09]), np.diag([1.0, 4.0, 0.25])
    P = moments.posterior_covariance(MODEL, TICKS, [4, 3], [6, 1], R, P0, W)
    want = np.sqrt(np.diagonal(P, axis1=1, axis2=2)[24:-1].mean(0))
    for changes in ({}, {"assumed_process_std": 0.5}):
        (p,) = planning.plan(parse.parse(study(**changes), "own"))
        np.testing.assert_allclose(p.bound, want, rtol=1e-10)


def test_designers_are_told_the_noise_unless_the_study_says_what_they_assume():
    assumed = planning.context_of(the_cell()).process_noise
    np.testing.assert_allclose(assumed, linear.process_noise(MODEL.A, W, TICK), rtol=1e-10)
    wrong = planning.context_of(the_cell(lti=FULL | {"assumed_process_std": [0.1, 0.2, 0.3]})).process_noise
    np.testing.assert_allclose(wrong, np.diag([0.01, 0.04, 0.09]), rtol=1e-14)


def test_it_is_an_axis_of_which_designers_are_told():
    asked = study(PLANT) | {"axes": {"process_std": [0.0, [0.1, 0.0, 0.2]]}}
    quiet, noisy = cells_of(parse.parse(asked, "own"))
    assert (quiet.values["process_std"], noisy.values["process_std"]) == ([0.0] * 3, [0.1, 0.0, 0.2])
    np.testing.assert_array_equal(planning.context_of(noisy).process_noise, np.diag(np.square([0.1, 0.0, 0.2])))
    asked["lti"] = PLANT | {"assumed_process_std": 0.7}
    _, noisy = cells_of(parse.parse(asked, "own"))
    np.testing.assert_allclose(planning.context_of(noisy).process_noise, 0.49 * np.eye(3), rtol=1e-14)
    assert "process_std" not in the_cell().values, "a column only where it is an axis"


@pytest.mark.nightly
def test_the_tables_say_the_noise_of_every_cell_and_a_filter_attains_the_bound():
    """256 runs from the prior: efficiency 1 within four of its standard errors; none at all where the model is wrong."""
    asked = study(PLANT, duration=2.0, steady_start=0.5) | {
        "observers": ["kf"],
        "options": {"scenario": {"random_initial_state": True}},
    }
    stats = pcbench.run(asked, axes={"process_std": [0.05, [0.1, 0.0, 0.2]]}, seeds=256).stats
    rows = stats[stats.metric == "rms_efficiency"]
    assert {tuple(v) for v in rows.process_std} == {(0.05,) * 3, (0.1, 0.0, 0.2)}
    assert len(rows) == 6
    assert (np.abs(rows["mean"] - 1) < 4 * rows.se).all()


BAD = {
    "two ways": ({"process_std": 0.1, "QN": 1.0}, "got process_std and QN, expected one of the two ways"),
    "G alone": ({"G": G}, r"lti\.QN is missing, which G needs"),
    "G of two rows": ({"G": G[:2], "QN": 1.0}, r"lti\.G: got .*, expected 3 rows of the same length"),
    "QN of three": ({"G": G, "QN": [1.0, 2.0, 3.0]}, r"lti\.QN: got .*, expected a number, 2 numbers, or 2 x 2"),
    "QN not symmetric": (
        {"G": G, "QN": [[1.0, 0.5], [0.0, 1.0]]},
        r"lti\.QN: got .*, expected a covariance: symmetric",
    ),
    "QN indefinite": ({"G": G, "QN": [[1.0, 2.0], [2.0, 1.0]]}, "with no eigenvalue below 0"),
    "QN below 0": ({"QN": -1.0}, r"lti\.QN: got -1\.0, expected greater than or equal to 0"),
    "too few": ({"process_std": [0.1, 0.2]}, r"lti\.process_std: got 2 numbers, expected 3, one for each state"),
    "a text": ({"process_std": "small"}, r"lti\.process_std: got 'small', expected"),
    "below 0": ({"process_std": [0.1, -0.2, 0.0]}, r"lti\.process_std\[1\]: got -0\.2, expected greater than"),
    "assumed": ({"assumed_process_std": [0.1]}, r"lti\.assumed_process_std: got 1 numbers, expected 3"),
}


@pytest.mark.parametrize("what", BAD)
def test_what_does_not_fit_is_named_in_one_sentence_and_nothing_is_written(what, tmp_path):
    changes, sentence = BAD[what]
    with pytest.raises(UserError, match=sentence) as error:
        pcbench.run(study(PLANT, **changes), seeds=1, out=tmp_path / "out")
    assert "\n" not in str(error.value)
    assert not (tmp_path / "out").exists()


def test_an_axis_of_it_has_a_number_for_each_state(tmp_path):
    with pytest.raises(
        UserError, match=r"axes.process_std\[0\]: got 2 values, expected one or 3 \(a value for each state\)"
    ):
        pcbench.run(study(PLANT), axes={"process_std": [[0.1, 0.2]]}, seeds=1, out=tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_a_scenario_with_noise_tells_designers_that_of_the_axis():
    """The tank's designers are told the noise that there is; where it has none, they keep what they assume."""
    axes = {"process_std": [[0.1, 2.0, 0.3]]}
    (noisy,) = cells_of(parse.parse({"name": "tank", "scenarios": ["csth/10s-noise"], "axes": axes}, "tank"))
    np.testing.assert_allclose(planning.context_of(noisy).process_std, (0.1, 2.0, 0.3))
    (quiet,) = cells_of(parse.parse({"name": "tank", "scenarios": ["csth/10s"], "axes": axes}, "tank"))
    assert planning.context_of(quiet).process_std == quiet.scenario.belief.assumed_process_std
