"""A map of many cells is an image: every cell where it belongs, lines where the value is, marks at their place."""

import numpy as np
import pytest
from matplotlib.colors import to_hex, to_rgb

from pcbench.plots import maps
from pcbench.plots.layout import PAPER
from pcbench.plots.maps import Cell, Side
from pcbench.plots.palette import ink_on

X = Side("sampling period [s]", [round(0.01 * i, 2) for i in range(1, 31)])
Y = Side("delay [s]", [round(0.02 * i, 2) for i in range(30)])
COLOURS = ("#112233", "#DDEEFF")


def a_map(value, title="kf"):
    """A map of a value over both axes, in two colours: above 0.3 and below."""
    return title, {(a, b): Cell(COLOURS[value(a, b) < 0.3], value=value(a, b)) for a in X.values for b in Y.values}


@pytest.fixture
def figure():
    three = [a_map(lambda a, b: a + b), a_map(lambda a, b: a - b + 1, "kfbo"), a_map(lambda a, b: 1.0 + 1e-6 * a)]
    return maps.draw(three, X, Y, "error [m]", [], PAPER, False, {"Table 2": (0.2, 0.21)})


def test_what_is_fine_has_many_values_on_an_axis_of_numbers():
    few = Side("x", X.values[:16])
    assert maps.is_fine(X, few)
    assert not maps.is_fine(few, few)
    assert not maps.is_fine(X, Side("y", ["none", "uniform"]))


def test_every_cell_has_its_colour_at_its_place(figure):
    (image,) = figure.axes[0].images
    pixels = np.asarray(image.get_array())
    assert pixels.shape == (30, 30, 3)
    for i, a in enumerate(X.values):
        for j, b in enumerate(Y.values):
            assert tuple(pixels[j, i]) == to_rgb(COLOURS[a + b < 0.3])
    assert image.origin == "lower"


def test_lines_stand_where_the_value_is_and_none_where_it_does_not_vary(figure):
    first, second, third = figure.axes
    lines = [line for collection in first.collections for line in collection.get_paths()]
    assert lines
    assert second.collections
    assert not third.collections
    for path in (line for line in lines if len(line.vertices)):
        across, up = path.vertices.T
        values = np.interp(across, np.arange(30), X.values) + np.interp(up, np.arange(30), Y.values)
        np.testing.assert_allclose(values, values[0], atol=1e-12)


def test_values_of_lines_are_read_on_their_colour_and_none_is_cut(figure):
    """Dark words on a dark map could not be read, and the frame cut "2.45" to ".45"."""
    for ax in figure.axes[:2]:
        texts = [text for text in ax.texts if text.get_text() != "Table 2"]
        assert texts
        for text in texts:
            assert to_hex(text.get_color()).upper() == ink_on(COLOURS[float(text.get_text()) < 0.3])
            box, frame = text.get_window_extent(), ax.bbox
            assert frame.x0 <= box.x0 <= box.x1 <= frame.x1
            assert frame.y0 <= box.y0 <= box.y1 <= frame.y1


@pytest.mark.parametrize("maps_", [1, 4])
def test_every_word_of_a_map_has_its_label(maps_):
    """A column without a label: the delays of three sensors leave little room for their noises."""
    noise = Side("noise std [m]", ["y1: 1, y2 and y3: 0.1", "y1: 0.1, y2 and y3: 0.01"])
    delay = Side("delay [s]", ["y1 to y3: 40", "y1: 30, y2: 40, y3: 50"])
    cells = {(a, b): Cell("#112233", ("1",)) for a in noise.values for b in delay.values}
    for ax in maps.draw([("kf", cells)] * maps_, noise, delay, "error [m]", [], PAPER).axes:
        boxes = [label.get_window_extent() for label in ax.get_xticklabels()]
        assert [label.get_text().replace("\n", " ") for label in ax.get_xticklabels()] == noise.values
        assert boxes[0].x1 < boxes[1].x0


def test_a_mark_stands_between_cells_at_its_values(figure):
    for ax in figure.axes:
        (cross,) = [line for line in ax.lines if line.get_marker() == "x"]
        assert cross.get_xdata()[0] == pytest.approx(19.0)
        assert cross.get_ydata()[0] == pytest.approx(10.5)
        assert [text.get_text() for text in ax.texts if text.get_text() == "Table 2"] == ["Table 2"]


def test_ticks_are_few_and_say_their_cells_values(figure):
    ax = figure.axes[0]
    for axis, over in ((ax.xaxis, X), (ax.yaxis, Y)):
        ticks = axis.get_ticklocs()
        assert 4 <= len(ticks) <= 7
        said = [label.get_text() for label in axis.get_ticklabels()]
        assert all(not word or float(word) == over.values[int(t)] for t, word in zip(ticks, said, strict=True))


def test_a_grid_has_values_across_and_up():
    grid = maps.grid_of(a_map(lambda a, b: a + 10 * b)[1], X, Y)
    assert grid[3, 5] == X.values[5] + 10 * Y.values[3]


def test_where_all_runs_diverge_there_are_no_lines():
    figure = maps.draw([a_map(lambda a, b: np.nan)], X, Y, "error [m]", [], PAPER)
    assert not figure.axes[0].collections
