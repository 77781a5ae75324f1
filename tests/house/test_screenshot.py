"""The README's pictures are what comes out: one run in time, and what a report looks like.

PCBENCH_SCREENSHOT=write python -m pytest -m slow tests/house/test_screenshot.py     draws them anew
"""

import io
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pcbench
from pcbench import plots
from pcbench.plots.labels import render_figure
from pcbench.report import page

FOLDER = Path(__file__).parents[2] / "notebooks"
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
SIZE = (900, 1460)
GAP = 40  # pixels between two pictures beside each other


def is_kept(drawn, name):
    """Hold a picture beside the one that the README shows; or keep it in its place."""
    if os.environ.get("PCBENCH_SCREENSHOT") == "write":
        drawn.convert("P", palette=Image.Palette.ADAPTIVE, colors=128).save(FOLDER / name, optimize=True)
    new, old = (np.asarray(p.convert("L").resize((90, 140)), float) for p in (drawn, Image.open(FOLDER / name)))
    assert np.abs(new - old).mean() < 12, "of 255: fonts differ between machines, a page does not"
    assert (new < 250).mean() > 0.1, "something is drawn"


@pytest.mark.nightly
def test_the_first_picture_in_the_readme_is_of_these_runs():
    result = pcbench.run("quick", observers=["kfbo", "pccebo", "kf"], seeds=32)
    figures = [plots.time(result, scenario=s, paper=plots.Paper(width=4.2)) for s in ("cart/nominal", "cart/white")]
    left, right = (Image.open(io.BytesIO(render_figure(figure, "png"))).convert("RGB") for figure in figures)
    both = Image.new("RGB", (left.width + GAP + right.width, max(left.height, right.height)), "white")
    both.paste(left, (0, 0))
    both.paste(right, (left.width + GAP, 0))
    is_kept(both, "first_look.png")


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="no browser here")
def test_the_picture_in_the_readme_is_of_this_report(tmp_path):
    pcbench.run("cart/white", seeds=256, out=tmp_path / "run")
    page.write(tmp_path / "run", tmp_path / "report.html")
    drawn = tmp_path / "drawn.png"
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000"]
    words += [f"--window-size={SIZE[0]},{SIZE[1]}", f"--screenshot={drawn}", (tmp_path / "report.html").as_uri()]
    subprocess.run(words, capture_output=True, timeout=900, check=True)
    is_kept(Image.open(drawn), "report.png")
