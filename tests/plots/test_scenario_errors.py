"""The dot plot of scenarios has the numbers of the tables, and begins the report of one observer in several scenarios."""

import numpy as np
import pytest

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import scenario_errors
from pcbench.report import captions, figures

LOOP = {"base": "ncs-two-state/held", "duration": 6.0, "steady_start": 3.0}
STUDY = {
    "name": "periods",
    "scenarios": ["short", "long"],
    "tables": {name: LOOP | {"sampling_period": period} for name, period in (("short", 0.5), ("long", 1.5))},
    "observers": ["kf"],
    "seeds": 4,
}


@pytest.fixture(scope="module")
def result():
    return pcbench.run(STUDY)


@pytest.mark.ci
def test_each_row_has_mean_and_interval_of_its_scenario(result):
    (ax,) = plots.scenarios(result, metric="steady_tracking_rmse").axes
    (line,), (bars,) = ax.get_lines(), ax.collections
    stats = result.stats.query("metric == 'steady_tracking_rmse' and signal == 'position'").set_index("scenario")
    assert [t.get_text() for t in ax.get_yticklabels()] == STUDY["scenarios"]
    for place, (name, mean, segment) in enumerate(
        zip(STUDY["scenarios"], line.get_xdata(), bars.get_segments(), strict=True)
    ):
        assert (mean, line.get_ydata()[place]) == (stats["mean"][name], place)
        np.testing.assert_array_equal(segment[:, 0], stats.loc[name, ["ci_low", "ci_high"]].to_numpy(float))
        assert (segment[:, 1] == place).all()


@pytest.mark.ci
def test_the_report_of_one_observer_begins_with_the_error_from_the_set_point(result):
    first, *_ = figures.of_study(result, figures.DEFAULTS)
    table = scenario_errors.rows_of(result, "position", "steady_tracking_rmse")
    assert (first.name, first.text) == ("scenarios-position", captions.scenarios(table))
    assert first.text.startswith(f"short {table['mean'][0]:.3g}"[:9])


@pytest.mark.ci
def test_a_signal_that_is_not_a_main_one_is_drawn_and_an_unknown_name_is_a_sentence(result):
    (ax,) = plots.scenarios(result, signal="velocity").axes
    assert len(ax.get_lines()[0].get_xdata()) == 2
    for changes in ({"signal": "speed"}, {"metric": "steady_rms"}):
        with pytest.raises(UserError, match=r"did you mean|valid"):
            plots.scenarios(result, **changes)


@pytest.mark.ci
def test_one_scenario_is_refused_in_a_sentence():
    with pytest.raises(UserError, match=r"two scenarios or more with this signal, metric and grid point, got 1"):
        plots.scenarios(pcbench.run("cart/slow", observers=["kf"], seeds=2))
