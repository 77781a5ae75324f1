"""Size of the error over time: the figure shows the quantiles, the assumed deviation and the arrivals of the runs' frame."""

import numpy as np
import pytest
from matplotlib.text import Text

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import errors_over_time, one_run

STUDY = {
    "name": "bands",
    "scenarios": ["cart/white"],
    "observers": ["kf", "pccebo", "model-only"],
    "seeds": 2,
    "options": {"scenario": {"consistency": True, "random_initial_state": True}},
}


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    result = pcbench.run(STUDY, out=tmp_path_factory.mktemp("bands") / "out")
    return result, one_run.frame_of(result.study, "cart/white", result.out), plots.error_bands(result)


@pytest.mark.ci
def test_each_observer_has_a_panel_with_its_quantiles_and_assumed_deviation(drawn):
    _, frame, figure = drawn
    part = frame[frame.signal == "position"]
    floor = errors_over_time.DEPTH * part[part.kind.isin(one_run.SIZES)].value.max()
    assert [ax.get_title("left") for ax in figure.axes] == STUDY["observers"]
    for ax, observer in zip(figure.axes, STUDY["observers"], strict=True):
        mine = {kind: rows.value.to_numpy() for kind, rows in part[part.series == observer].groupby("kind")}
        step = -(-len(mine["abs_p50"]) // errors_over_time.POINTS)
        lines = ax.get_lines()
        np.testing.assert_array_equal(lines[0].get_ydata(), np.maximum(mine["abs_p50"][::step], floor))
        for band, ends in zip(ax.collections, (("abs_p05", "abs_p95"), ("abs_p25", "abs_p75")), strict=True):
            edge = band.get_paths()[0].vertices[:, 1]
            low, high = (np.maximum(mine[end][::step], floor) for end in ends)
            assert (edge.min(), edge.max()) == (low.min(), high.max())
            assert (low <= lines[0].get_ydata()).all()
            assert (lines[0].get_ydata() <= high).all()
        assert len(lines) == 2 + ("sigma" in mine)
        assert ("sigma" in mine) == (observer == "kf")
        if "sigma" in mine:
            np.testing.assert_array_equal(lines[1].get_ydata(), np.maximum(mine["sigma"][::step], floor))
        arrivals = frame.t[frame.kind == "arrival"]
        np.testing.assert_array_equal(lines[-1].get_xdata()[::3], arrivals)
        assert ax.get_yscale() == "log"
        assert ax.get_ylim() == figure.axes[0].get_ylim()
    said = " ".join(t.get_text() for t in figure.findobj(Text))
    for part in ("[m]", "32 runs", "median", "50 %", "90 %", "assumed std", "arrival", "t [s]"):
        assert part in said.replace("\n", " ")


@pytest.mark.ci
def test_arrivals_that_would_be_a_bar_are_left_out(drawn, monkeypatch):
    """Over samples of a millisecond they were a dark bar below the errors."""
    result, frame, _ = drawn
    for most, is_drawn in (((frame.kind == "arrival").sum(), True), ((frame.kind == "arrival").sum() - 1, False)):
        monkeypatch.setattr(errors_over_time, "ARRIVALS", most)
        figure = plots.error_bands(result)
        assert any(t.get_text() == "arrival" for t in figure.findobj(Text)) is is_drawn
        assert any(len(line.get_xdata()) == 0 for line in figure.axes[0].get_lines()) is not is_drawn


@pytest.mark.ci
def test_runs_without_noise_have_no_bands():
    result = pcbench.run(STUDY | {"scenarios": ["cart/nominal"], "options": {}})
    with pytest.raises(UserError, match="with noise on one schedule"):
        plots.error_bands(result)
