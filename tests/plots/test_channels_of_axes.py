"""Axes with one value per channel: their values are numbers of the channels that change, or words that name each channel."""

import json

import pytest

import pcbench
from pcbench import plots
from pcbench.plots import frames
from pcbench.report import experiment, explorer

PLANT = {
    "A": [[0.0, 1.0], [-2.0, -0.5]],
    "B": [[0.0], [1.0]],
    "C": [[1.0, 0.0], [0.0, 1.0]],
    "states": ["angle [rad]", "speed [rad/s]"],
    "sampling_period": 0.1,
    "delay": [0.0, 0.1],
    "noise_std": [0.01, 0.1],
    "x0": [1.0, 0.0],
    "duration": 2.0,
}
AXES = {
    "one": {"delay": [[0.0, 0.1], [0.0, 0.2], [0.0, 0.4]]},
    "all": {"delay": [0.1, 0.2]},
    "each": {"delay": [[0.1, 0.2], [0.3, 0.2], [0.3, 0.4]]},
    "noise": {"noise_std": [[0.01, 0.1], [0.01, 0.3]]},
}
pytestmark = [pytest.mark.ci, pytest.mark.usefixtures("in_a_hurry")]


@pytest.fixture(scope="module")
def result():
    made = {}

    def result(name):
        if name not in made:
            study = {"name": name, "lti": PLANT, "observers": ["kf", "model-only"], "seeds": 2, "axes": AXES[name]}
            made[name] = pcbench.run(study)
        return made[name]

    return result


@pytest.mark.parametrize(
    ("name", "label", "values", "first"),
    [
        ("one", "delay of y2 [s]", [0.1, 0.2, 0.4], "delay of y2: 0.1 s"),
        ("all", "delay [s]", [0.1, 0.2], "delay 0.1 s"),
        ("noise", "noise std of y2 [rad/s]", [0.1, 0.3], "noise std of y2: 0.1 rad/s"),
        (
            "each",
            "delay [s]",
            ["y1: 0.1, y2: 0.2", "y1: 0.3, y2: 0.2", "y1: 0.3, y2: 0.4"],
            "delay y1: 0.1 s, y2: 0.2 s",
        ),
    ],
)
def test_values_of_an_axis_name_their_channels(result, name, label, values, first):
    (axis,) = AXES[name]
    rows = frames.rows(result(name), "lti", "angle", "steady_rmse")
    titles = frames.axis_titles(result(name), rows)
    assert frames.label(axis, titles) == label
    assert list(dict.fromkeys(rows[axis])) == values
    assert frames.format_axis(axis, values[0], titles) == first
    shown = explorer.numbers(result(name), "steady_rmse")
    assert f'"label":"{label}"' in shown
    (ax,) = plots.curves(result(name), axis).axes
    assert ax.get_xlabel() == label
    if not isinstance(values[0], str):
        assert sorted(ax.get_lines()[0].get_xdata()) == values


def test_experiment_names_channels(result):
    facts = {fact.what: fact.text for fact in experiment.experiment(result("one"), "lti").facts}
    assert facts["delay"] == "y1: 0 s, y2: 0.1 s | y1: 0 s, y2: 0.2 s | y1: 0 s, y2: 0.4 s"
    assert facts["sampling period"] == "0.1 s"


def test_successive_equal_channels_are_one():
    names = [f"y{i}" for i in range(1, 7)]
    assert frames.name_values(names, ["0", "0", "0", "7", "7", "7"]) == "y1 to y3: 0, y4 to y6: 7"
    assert frames.name_values(names[:3], ["1", "2", "2"]) == "y1: 1, y2 and y3: 2"


def test_values_of_channels_have_the_units_of_their_channels():
    """They had none: "noise std y1: 1, y2 and y3: 0.1"."""
    units = (("y1", "mm"), ("y2", "degC"), ("y3", "degC"))
    titles = {"noise_std": frames.AxisTitle("mm, degC", "", units)}
    texts = {
        "y1: 1, y2 and y3: 0.1": "noise std y1: 1 mm, y2 and y3: 0.1 degC",
        "y1 to y3: 0.1": "noise std y1 to y3: 0.1",
        "y2: 0.1": "noise std y2: 0.1 degC",
    }
    assert {value: frames.format_axis("noise_std", value, titles) for value in texts} == texts
    states = {"process_std": frames.AxisTitle("m, m/s", "", (("x", "m"), ("x dot", "m/s")))}
    assert frames.format_axis("process_std", "x: 1, x dot: 2", states) == "process std x: 1 m, x dot: 2 m/s"


@pytest.mark.ci
def test_axes_of_plants_with_several_units_have_the_unit_of_each_channel():
    axes = {"noise_std": [[1.0, 0.1, 0.1], [0.1, 0.01, 0.01]], "delay": [0.0, 10.0], "loss": [0.0, 0.2]}
    study = {"name": "units", "scenarios": ["csth/10s-noise"], "observers": ["kf", "model-only"], "seeds": 2}
    found = pcbench.run(study | {"axes": axes})
    panels = plots.winners(found, "delay", "loss").axes
    titles = [ax.get_title("left").split("\n↑")[0].replace("\n", " ") for ax in panels]
    assert titles == ["noise std y1: 1 mm, y2 and y3: 0.1 degC", "noise std y1: 0.1 mm, y2 and y3: 0.01 degC"]


def test_infinity_is_what_it_means_on_its_axis_and_has_no_unit():
    said = {"processor_speed": "processor speed no limit", "student_t_dof": "student t dof Gaussian"}
    assert {axis: frames.format_axis(axis, float("inf")) for axis in said} == said
    assert frames.format_axis("processor_speed", 2e5) == "processor speed 2·10⁵ multiplications/s"


def test_explorer_calls_infinity_as_figures_do():
    study = {"name": "tails", "scenarios": ["cart/white"], "observers": ["kf"], "seeds": 2}
    result = pcbench.run(study | {"axes": {"student_t_dof": [float("inf"), 3.0]}})
    (axis,) = json.loads(explorer.numbers(result, "steady_rmse"))["scenarios"][0]["axes"]
    figure = plots.curves(result, "student_t_dof")
    assert axis["words"] == [t.get_text() for t in figure.axes[0].get_xticklabels()] == ["Gaussian", "3"]
