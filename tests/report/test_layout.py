"""The page in a browser: nothing complains, is cut off or overlaps, on a phone, a desk and on paper; every picture is drawn."""

import pytest
from browser import CHROMIUM, inspect_page, print_page
from walked import STUDIES as SHORT

import pcbench
from pcbench.report import page

WIDTHS = [(390, False), (1024, False), (1400, False), (1500, False), (718, True)]  # phone, windows, a printed page
MOTOR = {
    "name": "motor",
    "seeds": 8,
    "observers": ["kf", "kf-load", "model-only"],
    "options": {"kf-load": {"bias_variance": 0.1}},
    "axes": {"plant.input_bias": [0.0, 0.2]},
    "lti": {
        "A": [[0.0, 1.0, 0.0], [0.0, -0.5, 20.0], [0.0, -2.0, -40.0]],
        "B": [[0.0], [0.0], [50.0]],
        "C": [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
        "states": ["angle [rad]", "speed [rad/s]", "current [A]"],
        "sampling_period": [0.04, 0.01],
        "delay": [0.06, 0.01],
        "noise_std": [0.002, 0.5],
        "process_std": [0.0, 0.0, 0.05],
        "x0": [0.5, 0.0, 0.0],
        "duration": 1.0,
    },
}
MAP = {
    "name": "map",
    "scenarios": ["cart/white"],
    "observers": ["pccebo", "kfbo", "kf"],
    "seeds": 4,
    "axes": {"delay": [0.2, 0.4], "noise_std": [0.1, 0.5], "sampling_period": [0.1, 0.2]},
}
PLANTS = {  # a page of several scenarios, whose signals and units differ
    "name": "plants",
    "scenarios": ["cart/nominal", "cart/white", "csth/10s-noise"],
    "observers": ["kf", "model-only"],
    "seeds": 4,
}
BROKEN = "<p style='position:absolute;left:1390px;white-space:nowrap'>this one is cut off</p>"


pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser here: the layout is not looked at")


@pytest.fixture(scope="module")
def drawn(tmp_path_factory):
    """Pages of studies by their names, each written once; of those that pcbench brings along in their short form."""
    made, known = {}, {"motor": MOTOR, "map": MAP, "plants": PLANTS}

    def drawn(name):
        if name not in made:
            folder = tmp_path_factory.mktemp(name)
            short = [word for word in SHORT.get(name, []) if "=" in word]
            seeds = None if name in known else 4
            pcbench.run(known.get(name, name), out=folder / "run", seeds=seeds, overrides=short)
            page.write(folder / "run", folder / "report.html")
            made[name] = folder
        return made[name]

    return drawn


def quiet(folder, width, paper):
    measured = inspect_page(folder / "report.html", folder, width, paper)
    assert width - 20 <= measured["wide"] <= width, "a scroll bar may stand beside it"
    figures = (folder / "report.html").read_text().count("<figure")
    assert measured["pictures"] == figures - paper > 0, "the interactive figure is not printed"
    assert measured["complaints"] == measured["console"] == []


@pytest.mark.nightly
@pytest.mark.parametrize(("width", "paper"), WIDTHS)
def test_a_motors_page_is_whole(drawn, width, paper):
    quiet(drawn("motor"), width, paper)


@pytest.mark.nightly
@pytest.mark.parametrize(("width", "paper"), WIDTHS)
@pytest.mark.parametrize("study", ["map", "quick", "plants", "helicopter", "unequal-delays", "equal-tuning"])
def test_the_page_of_a_study_is_whole(drawn, study, width, paper):
    quiet(drawn(study), width, paper)


@pytest.mark.ci
def test_printed_page_keeps_texts_of_figures_readable(drawn):
    """In the PDF of a browser: figures that shrink to a fraction of their size have texts of 2 points."""
    sizes = print_page(drawn("motor") / "report.html", drawn("motor"))
    assert len(sizes) > 300
    assert min(sizes) > 5.5


@pytest.mark.nightly
def test_what_overlaps_or_is_cut_off_is_seen(drawn, tmp_path):
    """The measure itself: a page that is broken in five ways has five complaints."""
    text = (drawn("motor") / "report.html").read_text()
    head, text_, rest = text.partition("<text")
    text = f'{head}<text x="9999" y="5">far</text><text x="1" y="9">a</text><text x="2" y="9">b</text>{text_}{rest}'
    text = text.replace("<h2>Repeat this study</h2>", BROKEN + "<svg width='9' height='9'></svg>")
    (tmp_path / "report.html").write_text(text.replace("function hints", "console.log('noise'); function hints"))
    measured = inspect_page(tmp_path / "report.html", tmp_path, 1400)
    for said in (
        "wider than its window",
        "leaves its picture: far",
        "overlap: b / a",
        "cut off: this one",
        "an empty picture",
    ):
        assert any(said in line for line in measured["complaints"]), said
    assert any("noise" in line for line in measured["console"])
