"""Observers that live elsewhere: they see what the simulation's observers see, and are judged as those are."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from documents import blocks

import pcbench
from pcbench.dataset import verify
from pcbench.errors import UserError
from pcbench.external import entry, export_draws, score
from pcbench.study import parse
from pcbench.study.plugins import registry

SCENARIO = {
    "base": "cart/white",
    "duration": 3.0,
    "steady_start": 1.0,
    "sampling_jitter": 0.05,
    "delay_jitter": 0.6,
    "loss": 0.2,
}
STUDY = {"name": "away", "scenario": SCENARIO, "observers": ["kf"], "seeds": 3, "axes": {"noise_std": [0.1, 0.5]}}
PROMPT = {"base": "cart/white", "duration": 3.0, "steady_start": 1.0, "delay": 0.0}
NOW = {"name": "now", "scenario": PROMPT, "observers": ["kf"], "seeds": 1}
KALMAN = blocks("python", "export_to_c.md")[0]
WRONG = """

def raises(cell, xhat0):
    raise ValueError("no gain")


def short(cell, xhat0):
    class Short:
        def step(self, t, u, arrivals):
            return [0.0]

    return Short()
"""
FILTERPY = """import numpy as np
from filterpy.kalman import KalmanFilter


class Filter:
    def __init__(self, cell, xhat0):
        m = {name: np.array(value) for name, value in cell["model"].items()}
        n, q = len(xhat0), len(cell["noise_std"])
        self.f, self.first = KalmanFilter(dim_x=n, dim_z=q, dim_u=m["Gamma"].shape[1]), True
        self.f.x, self.f.P, self.f.F, self.f.B = xhat0.reshape(-1, 1), np.array(cell["P0"]), m["Phi"], m["Gamma"]
        self.f.Q, self.f.H, self.f.R = np.zeros((n, n)), m["C"], np.diag(np.square(cell["noise_std"]))

    def step(self, t, u, arrivals):
        if not self.first:
            self.f.predict(u.reshape(-1, 1))
        self.first = False
        for a in arrivals:
            self.f.update(a.value)
        return self.f.x.ravel()
"""


def traces(study, observer="kf"):
    """The simulation's own estimates of every run of a study, as somebody else would leave them."""
    rows = []
    for cell, noise in enumerate(study["axes"]["noise_std"]):
        for seed in range(study["seeds"]):
            run = pcbench.simulate({**study, "axes": {"noise_std": [noise]}}, observer, seed=seed)
            names = {f"{observer}.{s}": s for s in ("position", "velocity")}
            found = run[list(names)].rename(columns=names)
            rows.append(found.assign(scenario="away", cell=cell, seed=seed, tick=np.arange(len(found))))
    return pd.concat(rows, ignore_index=True)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    """The draws of a study, and estimates of all its runs, which are zero."""
    folder = tmp_path_factory.mktemp("away")
    export_draws.write(parse.grid_of(dict(STUDY), {}, []), folder / "out")
    runs = [(cell, seed) for cell in range(2) for seed in range(STUDY["seeds"])]
    keys = pd.DataFrame([(*run, tick) for run in runs for tick in range(3000)], columns=["cell", "seed", "tick"])
    return folder / "out", keys.assign(scenario="away", position=0.0, velocity=0.0)


@pytest.mark.ci
def test_samples_that_arrive_are_those_of_the_simulation(study):
    folder, _ = study
    samples = pd.read_parquet(folder / "draws" / "samples.parquet")
    run = pcbench.simulate({**STUDY, "axes": {"noise_std": [0.5]}}, "kf", seed=2)
    mine = samples[(samples.cell == 1) & (samples.seed == 2)]
    assert mine.arrived_tick.isna().any(), "some are lost"
    each = samples.dropna().sort_values("sampled").groupby(["cell", "seed"])
    assert each.arrived.diff().min() < 0, "some overtake"
    held = np.full(len(run), np.nan)
    for tick, rows in mine.dropna().groupby("arrived_tick"):
        held[int(tick) :] = rows.sort_values("sampled").value.iloc[-1]
    np.testing.assert_allclose(held, run.y1, rtol=0, atol=1e-12)
    text = (folder / "draws" / "README.md").read_text()
    assert all(f"| `{name}` |" in text for name in samples.columns)
    assert not {"position", "x"} & set(samples.columns), "the true values are not exported"


@pytest.mark.ci
@pytest.mark.parametrize(
    "errors",
    [
        {"quantization_step": [0.5]},
        {"quantization_step": [0.5], "dither": [1]},
        {"outlier_probability": [0.3]},
        {"send_threshold": [2.0]},
    ],
    ids=str,
)
def test_errors_of_the_sensor_are_in_the_draws(tmp_path, errors):
    study = {**STUDY, "seeds": 2, "axes": {"noise_std": [0.5], **errors}}
    export_draws.write(parse.grid_of(study, {}, []), tmp_path / "out")
    drawn = pd.read_parquet(tmp_path / "out" / "draws" / "samples.parquet")
    usual = {**STUDY, "seeds": 2, "axes": {"noise_std": [0.5]}}
    for seed in range(2):
        run = pcbench.simulate(study, "kf", seed=seed).y1.to_numpy()
        held = np.full(len(run), np.nan)
        for tick, rows in drawn[drawn.seed == seed].dropna().groupby("arrived_tick"):
            held[int(tick) :] = rows.sort_values("sampled").value.iloc[-1]
        np.testing.assert_allclose(held, run, rtol=0, atol=1e-12)
        assert np.nanmax(np.abs(held - pcbench.simulate(usual, "kf", seed=seed).y1)) > 0.01


@pytest.mark.ci
@pytest.mark.parametrize(
    ("wrong", "assumed"),  # a log has the stamps of the sensor; what is wrongly assumed of them is in the plant file
    [
        ({"timestamp_offset": 0.05, "clock_skew": 2e4}, 0.0),
        ({"timestamp_jitter": 0.02}, 0.0),
        ({"assumed_delay_error": 0.1}, 0.1),
    ],
)
def test_stamps_of_draws_are_those_that_observers_get(tmp_path, wrong, assumed):
    scenario = {"base": "cart/white", "duration": 2.0, "steady_start": 1.0}
    study = {
        "name": "wrong",
        "scenario": scenario,
        "observers": ["model-only"],
        "axes": {k: [v] for k, v in wrong.items()},
    }
    export_draws.write(parse.grid_of(study | {"seeds": 1}, {}, []), tmp_path / "out")
    drawn = pd.read_parquet(tmp_path / "out" / "draws" / "samples.parquet").dropna().sort_values("sample")
    pcbench.simulate(study, "model-only", log=tmp_path / "log")
    logged = pd.read_parquet(tmp_path / "log" / "measurements.parquet").dropna().sort_values("arrived")
    true = np.round(0.2 * np.arange(len(drawn)), 3)
    assert np.abs(drawn.sampled - true)[1:].max() > 0.005, "stamps are wrong"
    logged = logged[: len(drawn)].assign(sampled=np.maximum(logged.sampled - assumed, 0.0))
    for name in ("sampled", "arrived", "value"):
        np.testing.assert_allclose(drawn[name], logged[name], rtol=0, atol=1e-12, err_msg=name)


@pytest.mark.nightly
def test_the_simulations_own_estimates_score_as_in_the_simulation(study, tmp_path):
    folder, said = study[0], []
    traces(STUDY).to_parquet(tmp_path / "kf.parquet", index=False)
    result = score.score(folder, tmp_path / "kf.parquet", "my-kf", on_warning=said.append)
    assert any("cannot be checked" in sentence and "trusted" in sentence for sentence in said)
    key = ["cell", "signal", "metric"]
    ours, theirs = (
        result.stats[result.stats.observer == name].set_index(key)[["n", "mean", "se"]] for name in ("kf", "my-kf")
    )
    pd.testing.assert_frame_equal(ours, theirs, rtol=1e-9, atol=1e-9)
    pairs = result.pairs[(result.pairs.metric == "rmse") & (result.pairs.n == STUDY["seeds"])]
    assert len(pairs) == 2 * 2
    assert np.abs(pairs.mean_diff).max() < 1e-9
    assert not verify.verify(str(folder), None, 0).differing
    again = pcbench.run(folder / "study.toml", out=folder)
    assert set(again.stats.observer) == {"kf", "my-kf"}
    with pytest.raises(UserError, match=r"got no estimates of my-kf for 2 runs, expected them scored"):
        pcbench.run(folder / "study.toml", seeds=5, out=folder)


REFUSALS = {
    "a run is missing": (lambda t: t[t.seed != 1], "got 2 of 3 runs (seed 1 is missing), expected all"),
    "a tick is missing": (lambda t: t[(t.seed != 2) | (t.tick != 7)], "ticks of seed 2, expected each of 0 .. 2,999 once"),
    "a tick stands twice": (lambda t: pd.concat([t, t[t.tick == 3]]), "expected each of 0 .. 2,999 once"),
    "a tick stands for another": (lambda t: t.assign(tick=t.tick.where(t.tick != 7, 6)), "each of 0 .. 2,999 once"),
    "a cell is missing": (lambda t: t[t.cell == 0], "cell 1: got no rows, expected 3 runs"),
    "a state is missing": (lambda t: t.drop(columns="position"), "got no column 'position', expected every state"),
    "no signal": (lambda t: t[["scenario", "cell", "seed", "tick"]], "expected one for each signal, position, velocity"),
    "no seed": (lambda t: t.drop(columns="seed"), "'seed' is no column of it"),
    "words": (lambda t: t.assign(position="here"), "column position got"),
}  # fmt: skip


@pytest.mark.ci
@pytest.mark.parametrize("what", REFUSALS)
def test_estimates_that_are_not_whole_are_refused(study, tmp_path, what):
    folder, found = study
    change, sentence = REFUSALS[what]
    change(found).to_parquet(tmp_path / "e.parquet", index=False)
    before = sorted(p for p in folder.rglob("*") if p.is_file())
    with pytest.raises(UserError) as error:
        score.score(folder, tmp_path / "e.parquet", "theirs")
    assert sentence in str(error.value)
    assert sorted(p for p in folder.rglob("*") if p.is_file()) == before, "nothing is written"


@pytest.mark.ci
@pytest.mark.parametrize(
    ("name", "words"), [("kf-2", "no name that begins as one of pcbench's own"), ("a b", "expected letters")]
)
def test_the_name_of_an_external_estimator_is_its_own(study, name, words):
    with pytest.raises(UserError, match=words):
        score.score(study[0], "nothing.parquet", name)


def test_a_study_with_an_external_estimator_is_the_same_whatever_stands_in_pcbenchs_own_file(tmp_path, monkeypatch):
    """Else a release that edits the file would not know the estimators that an earlier one has scored."""
    before = registry.load("observer", entry.REFERENCE, "test").code
    (tmp_path / "entry.py").write_text(Path(entry.__file__).read_text() + "# edited\n")
    monkeypatch.setattr(entry, "__file__", str(tmp_path / "entry.py"))
    after = registry.load("observer", entry.REFERENCE, "test").code
    assert (before, before.digest) == (after, registry.ELSEWHERE)


def test_closed_loops_have_no_draws(tmp_path):
    with pytest.raises(UserError, match="got a closed loop, expected an open one"):
        export_draws.write(parse.grid_of("helicopter/constant", {"seeds": 1}, []), tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_covariance_of_correlated_noise_is_whole(tmp_path):
    """Of noise that is correlated between channels; of a channel without noise it is tiny, so that it has an inverse."""
    lti = {
        "A": [[0.0, 1.0], [0.0, 0.0]],
        "B": [[0.0], [1.0]],
        "C": [[1.0, 0.0], [0.0, 1.0]],
        "tick": 0.1,
        "duration": 1.0,
    }
    lti |= {
        "sampling_period": 0.1,
        "delay": 0.0,
        "noise_std": [0.3, 0.2],
        "noise_correlation": [[1.0, 0.5], [0.5, 1.0]],
    }
    study = {"name": "both", "lti": lti, "observers": ["kf"], "seeds": 1}
    export_draws.write(parse.grid_of(study, {}, []), tmp_path / "out")
    (cell,) = json.loads((tmp_path / "out" / "draws" / "cells.json").read_text())
    np.testing.assert_allclose(cell["R"], [[0.09, 0.03], [0.03, 0.04]], rtol=1e-12)


def _estimates(tmp_path, text):
    """What an external estimator makes of one run without delay, and what `kf` does."""
    (tmp_path / "mine.py").write_text(text)
    export_draws.write(parse.grid_of(dict(NOW), {}, []), tmp_path / "out")
    entry.main(str(tmp_path / "out"), f"{tmp_path}/mine.py:Filter", str(tmp_path / "e.parquet"))
    found = pd.read_parquet(tmp_path / "e.parquet")
    run = pcbench.simulate(dict(NOW), "kf")
    return found[["position", "velocity"]].to_numpy(), run[["kf.position", "kf.velocity"]].to_numpy()[:-1]


@pytest.mark.ci
def test_a_kalman_filter_of_ten_lines_is_kf_where_nothing_is_late(tmp_path):
    theirs, ours = _estimates(tmp_path, KALMAN)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-10)


@pytest.mark.ci
def test_filterpys_filter_is_kf_where_nothing_is_late(tmp_path):
    pytest.importorskip("filterpy", reason="filterpy is not installed: pip install filterpy")
    theirs, ours = _estimates(tmp_path, FILTERPY)
    np.testing.assert_allclose(theirs, ours, rtol=0, atol=1e-10)


@pytest.mark.ci
def test_csv_draws_suffice_for_a_filter_with_process_noise(tmp_path):
    """A Kalman filter that reads only the CSV files and cells.json equals kf, process noise and assumed values included."""
    scenario = PROMPT | {"process_std": [0.01, 0.1], "assumed_noise_scale": 3.0}
    study = NOW | {"scenario": scenario}
    folder = export_draws.write(parse.grid_of(study, {}, []), tmp_path / "out", csv=True) and tmp_path / "out" / "draws"
    tables = {name: list(csv.DictReader((folder / f"{name}.csv").open())) for name in ("samples", "inputs", "starts")}
    (cell,) = json.loads((folder / "cells.json").read_text())
    assert set(cell) == set(export_draws.CELL)
    assert all(f"| `{name}` |" in (folder / "README.md").read_text() for name in export_draws.CELL)
    np.testing.assert_allclose(cell["Q"], np.diag([1e-4, 1e-2]), rtol=1e-12)
    assert cell["R"] == [[pytest.approx(9 * parse.grid_of(study, {}, []).cells[0].scenario.sampling.noise_std[0] ** 2)]]
    Phi, Gamma, C = (np.array(cell["model"][name]) for name in ("Phi", "Gamma", "C"))
    x, P = np.array([float(tables["starts"][0][name]) for name in ("x1", "x2")]), np.array(cell["P0"])
    values = {int(row["arrived_tick"]): float(row["value"]) for row in tables["samples"] if row["arrived_tick"]}
    found, u = [], None
    for tick, row in enumerate(tables["inputs"]):
        if u is not None:  # the input of the tick before
            x, P = Phi @ x + Gamma @ u, Phi @ P @ Phi.T + np.array(cell["Q"])
        if tick in values:
            K = P @ C.T @ np.linalg.inv(C @ P @ C.T + np.array(cell["R"]))
            x, P = x + K @ (values[tick] - C @ x), (np.eye(2) - K @ C) @ P
        u = np.array([float(row["u1"])])
        found.append(x)
    run = pcbench.simulate(study, "kf")[["kf.position", "kf.velocity"]].to_numpy()
    np.testing.assert_allclose(found, run[: len(found)], rtol=0, atol=1e-10)
    export_draws.write(parse.grid_of(study, {}, []), tmp_path / "out")
    assert not list(folder.glob("*.csv")), "no table of an earlier call remains"


@pytest.mark.nightly
def test_an_external_estimator_enters_the_tables_marked_and_its_mistakes_are_sentences(tmp_path):
    (tmp_path / "mine.py").write_text(KALMAN + WRONG)
    folder = tmp_path / "out"
    export_draws.write(parse.grid_of(dict(NOW), {"seeds": 2}, []), folder)
    for name, words in (
        ("raises", "ValueError: no gain, mine.py line"),
        ("short", "step returned 1 numbers, expected 2"),
    ):
        with pytest.raises(UserError, match=words):
            score.run(folder, f"{tmp_path}/mine.py:{name}", "theirs")
    with pytest.raises(UserError, match="got no function 'nothing' in"):
        score.run(folder, f"{tmp_path}/mine.py:nothing", "theirs")
    result = score.run(folder, f"{tmp_path}/mine.py:Filter", "theirs")
    means = result.stats[(result.stats.metric == "rmse") & (result.stats.signal == "position")].set_index("observer")[
        "mean"
    ]
    assert means["theirs"] == pytest.approx(means["kf"], rel=1e-9)
    assert "external: one run at a time" in json.dumps(result.provenance["certificates"])
    with pytest.raises(UserError, match="contains no draws"):
        score.run(tmp_path, f"{tmp_path}/mine.py:Filter", "theirs")
