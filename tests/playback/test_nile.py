"""A log not of our making: the Nile's yearly flow at Aswan, 1871 to 1970, in the public domain, as statsmodels brings it.

Durbin and Koopman, Time Series Analysis by State Space Methods (2001), section 2.2.5: a level that walks, measured with noise;
the most likely variances are 1469.1 and 15099. `nile.csv` is `statsmodels/datasets/nile/nile.csv`, byte for byte.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from reference import logs as reference

import pcbench
from pcbench.recordings import readers
from pcbench.recordings.survey import channel_rows, survey

HERE = Path(__file__).parents[1] / "support" / "nile.csv"
WALK, NOISE, WIDE = 1469.1, 15099.0, 1e7
LEVEL = {
    "name": "level",
    "lti": {
        **{"A": [[1.0]], "B": [[0.0]], "C": [[1.0]], "dt": 1.0, "states": ["flow [1e8 m3]"]},
        **{"sampling_period": 1.0, "delay": 0.0, "noise_std": NOISE**0.5, "process_std": WALK**0.5},
        **{
            "prior_std": [WIDE**0.5],
            "duration": 100.0,
            "x0": [0.0],
            "input": "zero",
            "settle_band": [1.0],
            "divergence_threshold": 1e6,
        },
    },
}
TOML = """
log = "nile.csv"
[channels.flow]
field = "volume"
unit = "1e8 m3"
sampled = "year"
delay = 0.0
"""


@pytest.fixture(scope="module")
def nile(tmp_path_factory):
    folder = tmp_path_factory.mktemp("nile")
    shutil.copy(HERE, folder)
    (folder / "nile.toml").write_text(TOML)
    return folder / "nile.toml"


def test_the_log_is_a_hundred_years_without_a_gap(nile):
    (row,) = channel_rows(survey(readers.open_log(nile)))
    assert (row["samples"], row["first"], row["last"], row["gaps"], row["doubled"]) == (100, 1871.0, 1970.0, 0, 0)
    assert (row["interval_least"], row["interval_most"]) == (1.0, 1.0)


def test_the_notebook_of_a_recording_has_the_same_flows():
    notebook = json.loads((HERE.parents[2] / "notebooks" / "14_a_recording.ipynb").read_text())
    code = "".join(line for cell in notebook["cells"] for line in cell["source"])
    written = code.split('flows = """')[1].split('"""')[0].split()
    assert written == [line.split(",")[1] for line in HERE.read_text().splitlines()[1:]]


def test_the_filter_with_the_books_variances_is_consistent_and_its_innovations_white(nile):
    found = pcbench.replay(nile, LEVEL, "kf")
    y = np.loadtxt(HERE, delimiter=",", skiprows=1)[:, 1]
    one = np.eye(1)
    nu, s = reference.kalman(one, 0 * one, WALK * one, one, NOISE, np.zeros(1), WIDE * one, np.zeros((100, 1)), y)
    (row,) = found.innovations.to_dict("records")
    Q, p = reference.ljung_box(nu / np.sqrt(s), 20)
    assert row["nis"] == pytest.approx(np.mean(nu**2 / s), rel=1e-10)
    assert row["log_likelihood"] == pytest.approx(np.mean(-0.5 * (np.log(2 * np.pi * s) + nu**2 / s)), rel=1e-10)
    assert (row["ljung_box"], row["ljung_box_p"]) == (pytest.approx(Q, rel=1e-10), pytest.approx(p, rel=1e-8))
    assert row["verdict"] == "consistent"
    assert p > 0.05
    assert np.sum(-0.5 * (np.log(2 * np.pi * s) + nu**2 / s)[1:]) == pytest.approx(
        -632.54, abs=0.02
    )  # the book's, diffuse


def test_a_level_that_hardly_walks_is_seen_to_be_wrong(nile):
    stiff = LEVEL | {"lti": LEVEL["lti"] | {"process_std": 1.0}}
    (row,) = pcbench.replay(nile, stiff, "kf").innovations.to_dict("records")
    assert row["ljung_box_p"] < 0.001
    assert row["verdict"] == "optimistic"
