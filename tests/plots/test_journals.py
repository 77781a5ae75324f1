"""Figures for a journal have the widths of its columns and its font sizes; no text overlaps another or leaves the figure."""

import re
from itertools import combinations
from unittest.mock import patch

import matplotlib as mpl
import pytest
from matplotlib.text import Text

import pcbench
from pcbench import plots
from pcbench.errors import UserError
from pcbench.plots import layout
from pcbench.plots.labels import render_figure
from pcbench.report import figures

STUDY = {
    "name": "six-observers-of-a-cart",
    "scenarios": ["cart/white"],
    "observers": ["kf", "kf-shifted-innovation", "kf-ignore-delay", "kf-drop-delayed", "pccebo", "model-only"],
    "seeds": 4,
    "axes": {"delay": [0.2, 0.4], "noise_std": [0.1, 0.5, 2.0], "sampling_period": [0.1, 0.2]},
    "options": {"scenario": {"random_initial_state": True, "consistency": True}},
}
NEAR = 1.0  # points by which boxes of texts may touch: they have room above and below their letters


@pytest.fixture(scope="module")
def result(in_a_hurry):
    return pcbench.run(STUDY)


def texts(figure):
    """The texts that a figure draws, with boxes in points, without the room above and below their letters, and sizes."""
    out = []
    with mpl.rc_context({"text.hinting": "none"}), patch.object(Text, "draw", autospec=True) as draw:
        figure.draw_without_rendering()
        for text in dict.fromkeys(call.args[0] for call in draw.call_args_list):
            if text.get_visible() and text.get_text().strip():
                x0, y0, x1, y1 = 72 / figure.dpi * text.get_window_extent().extents
                cut = 0.18 * (y1 - y0)
                out.append((text.get_text(), x0, y0 + cut, x1, y1 - cut, text.get_fontsize()))
    return out


def complaints(figure):
    """The texts of a figure that overlap or leave it."""
    width, height = 72 * figure.get_size_inches()
    found = texts(figure)
    out = [f"leaves: {t}" for t, x0, y0, x1, y1, _ in found
           if min(x0, y0) < -NEAR or x1 > width + NEAR or y1 > height + NEAR]  # fmt: skip
    for a, b in combinations(found, 2):
        apart = a[3] <= b[1] + NEAR or b[3] <= a[1] + NEAR or a[4] <= b[2] + NEAR or b[4] <= a[2] + NEAR
        out += [] if apart else [f"overlap: {a[0]} / {b[0]}"]
    return out


def pictures(result, paper):
    shown = figures.DEFAULTS._replace(paper=paper)
    for place in figures.scenario_data(result, result.scenarios, shown).values():
        for _, each in figures.of_scenario(place):
            yield from each
    yield from figures.of_study(result, shown)


@pytest.mark.ci
@pytest.mark.parametrize("journal", plots.JOURNALS)
def test_figures_have_the_widths_and_fonts_of_a_journal(result, journal):
    paper, widths = plots.JOURNALS[journal], set()
    columns = [72 * each for each in (paper.width, paper.full)]
    for picture in pictures(result, paper):
        pdf = render_figure(picture.figure, "pdf")
        (width,) = re.findall(rb"/MediaBox \[ 0 0 ([\d.]+)", pdf)
        assert min(abs(float(width) - column) for column in columns) < 0.01, picture.name
        widths.add(round(float(width)))
        assert b"STIXGeneral" in pdf
        assert b"/FontFile2" in pdf, "letters, not outlines"
        svg = render_figure(picture.figure, "svg").decode()
        assert f'width="{float(width):.6g}'[:11] in svg
        assert re.findall(r"<text[^>]*>([^<]+)<", svg)
        assert "Times New Roman" in svg, "where the first font is not installed, the next is like it"
        sizes = {size for *_, size in texts(picture.figure)}
        assert {8.0, 7.0} <= sizes | {7.0}
        assert 6.0 <= min(sizes) <= max(sizes) == 8.0, picture.name
        assert complaints(picture.figure) == [], picture.name
    assert widths == {round(column) for column in columns}


@pytest.mark.ci
def test_texts_that_overlap_or_leave_a_figure_are_seen():
    with layout.sheet(plots.JOURNALS["ieee"], "title") as (figure, (ax,)):
        layout.set_range(ax, "y", [0, 1])
        ax.plot([0, 1], [0, 1], label="key")
    assert complaints(figure) == []
    for words in ("one", "two"):
        figure.text(0.5, 0.5, words)
    figure.text(0.99, 0.2, "outside")
    assert {line.split(":")[0] for line in complaints(figure)} == {"overlap", "leaves"}


def test_maps_of_six_are_three_and_three(result):
    figure = plots.heatmaps(result, at={"sampling_period": 0.1}, paper=plots.JOURNALS["ieee"])
    rows = [ax.get_subplotspec().rowspan.start for ax in figure.axes]
    assert rows == [0, 0, 0, 1, 1, 1]


def test_a_width_between_one_and_two_columns_is_that_of_both():
    paper = plots.JOURNALS["elsevier"]
    assert [72.27 * paper.fit_width(w / 72.27) for w in (100, 252, 253, 600)] == pytest.approx([252, 252, 522, 522])
    assert plots.Paper().fit_width(5.5) == 5.5
    with pytest.raises(UserError, match="--width"):
        paper._replace(width=0.1).validate()
