"""A replay reports the delay that observers estimate, on a plant without such a signal too: in a column and in the summary."""

import numpy as np
import pandas as pd
import pytest
from logged import MOTOR

import pcbench

TRUE = 0.1  # s
ASSUMED = MOTOR | {"lti": MOTOR["lti"] | {"delay": 0.15, "noise_std": 0.01}}


@pytest.fixture(scope="module")
def replayed(tmp_path_factory):
    """A run with a delay of 0.1 s, replayed without its stamps by observers that assume 0.15 s."""
    folder = tmp_path_factory.mktemp("late")
    pcbench.simulate(MOTOR | {"lti": MOTOR["lti"] | {"noise_std": 0.01}}, "kf", seed=4, log=folder / "log")
    options = {"mmae-delay": {"stamps": False, "delays": [0.05, 0.08, 0.1, 0.13, 0.2]}, "ekf-delay": {"stamps": False}}
    found = pcbench.replay(
        folder / "log", ASSUMED | {"options": options}, ["mmae-delay", "ekf-delay", "kf"], out=folder
    )
    return pd.read_parquet(folder / "estimates.parquet"), found.summary


@pytest.mark.ci
@pytest.mark.parametrize("observer", ["mmae-delay", "ekf-delay"])
def test_delay_is_a_column_and_in_the_summary(replayed, observer):
    estimates, summary = replayed
    column = estimates[f"{observer}.delay"].to_numpy()
    assert column[0] != pytest.approx(column[-1])
    (row,) = (each for each in summary["delays"] if each["observer"] == observer)
    assert row["estimate"] == pytest.approx(column[-1], abs=1e-12)
    if observer == "mmae-delay":  # ekf-delay may be biased, as its docstring says
        assert row["estimate"] == pytest.approx(TRUE, abs=0.01)
    assert any(
        said.startswith(f"{observer}: estimated delay of y1 {row['estimate']:.4g} s") for said in summary["notes"]
    )


@pytest.mark.ci
def test_other_observers_have_no_delay(replayed):
    estimates, summary = replayed
    assert "kf.delay" not in estimates
    assert [each["observer"] for each in summary["delays"]] == ["mmae-delay", "ekf-delay"]
    assert np.isfinite([each["std"] for each in summary["delays"]]).all()


@pytest.mark.ci
def test_recording_of_the_scenario_with_a_wrong_assumed_delay_is_replayed(tmp_path):
    pcbench.simulate("cart/unknown-delay", "mmae-delay", log=tmp_path / "log")
    found = pcbench.replay(tmp_path / "log", "cart/unknown-delay", "mmae-delay")
    assert found.summary["delays"][0]["estimate"] == pytest.approx(0.2, abs=0.01)
    assert list(found.estimates).count("mmae-delay.delay") == 1
