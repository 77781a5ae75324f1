"""The README's picture of a report is what the report looks like.

PCBENCH_SCREENSHOT=write python -m pytest -m slow tests/house/test_screenshot.py     draws it anew
"""

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import pcbench
from pcbench.report import page

PICTURE = Path(__file__).parents[2] / "notebooks" / "report.png"
CHROMIUM = next(
    (found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None
)
SIZE = (900, 1460)


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no browser here")
def test_the_picture_in_the_readme_is_of_this_report(tmp_path):
    pcbench.run("cart/white", seeds=256, out=tmp_path / "run")
    page.write(tmp_path / "run", tmp_path / "report.html")
    drawn = tmp_path / "drawn.png"
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars", "--virtual-time-budget=8000"]
    words += [f"--window-size={SIZE[0]},{SIZE[1]}", f"--screenshot={drawn}", (tmp_path / "report.html").as_uri()]
    subprocess.run(words, capture_output=True, timeout=900, check=True)
    if os.environ.get("PCBENCH_SCREENSHOT") == "write":
        Image.open(drawn).convert("P", palette=Image.Palette.ADAPTIVE, colors=64).save(PICTURE, optimize=True)
    new, old = (np.asarray(Image.open(p).convert("L").resize((90, 140)), float) for p in (drawn, PICTURE))
    assert np.abs(new - old).mean() < 12, "of 255: fonts differ between machines, a page does not"
    assert (new < 250).mean() > 0.1, "something is drawn"
