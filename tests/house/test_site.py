"""The site builds without a warning, every link of it leads somewhere, and a browser shows its pages without a complaint.

Needs the group `docs` (pip install --group docs); without it these tests are skipped.
"""

import re
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest
from browser import CHROMIUM
from documents import PAGES, ROOT

pytest.importorskip("mkdocs")
pytest.importorskip("mkdocstrings")
SHOWN = {
    "index.html": "Find out which observer",
    "reference/python.html": "pcbench.find_limit",
    "pcbench/guide/wrong_assumptions.html": "pccebo-riccati",
    "notebooks/01_first_look.html": "<img",
    "reference/pcbench.observers.kf.html": "delay-compensated discrete Kalman filter",
    "REPRODUCTION.html": "misprint",
}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """The whole site, notebooks executed."""
    out = tmp_path_factory.mktemp("site") / "site"
    done = subprocess.run([sys.executable, ROOT / ".ci" / "site", out], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    assert "WARNING" not in done.stderr
    return out


class Links(HTMLParser):
    """What a page links to and shows, and what may be linked to in it."""

    def __init__(self):
        super().__init__()
        self.to, self.names = [], {""}

    def handle_starttag(self, tag, attrs):
        said = dict(attrs)
        self.names |= {said[key] for key in ("id", "name") if said.get(key)}
        self.to += [said[key] for key in ("href", "src") if said.get(key)]


def read(path):
    parsed = Links()
    parsed.feed(path.read_text())
    return parsed


@pytest.mark.nightly
def test_every_link_of_the_site_leads_somewhere(site):
    pages = {path.resolve(): read(path) for path in site.rglob("*.html") if path.name != "404.html"}
    assert len(pages) > 300
    broken = []
    for path, page in pages.items():
        for link in page.to:
            if re.match(r"[a-z]+:", link):
                continue
            file, _, name = unquote(link).partition("#")
            there = (path.parent / file.partition("?")[0]).resolve() if file else path
            there = there / "index.html" if there.is_dir() else there
            if not there.exists() or (there in pages and name not in pages[there].names and not name.startswith("__")):
                broken.append((str(path.relative_to(site.resolve())), link))
    assert broken == []


@pytest.mark.nightly
def test_it_has_every_page_and_module(site):
    for name in PAGES:
        html = name.replace("README.md", "index.html").replace(".md", ".html")
        assert (site / "pcbench" / "guide" / html).exists()
    for path in (ROOT / "pcbench" / "observers").glob("*.py"):
        if path.stem != "__init__":
            assert (site / "reference" / f"pcbench.observers.{path.stem}.html").exists()


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="no browser here")
def test_search_finds_the_right_page_first_and_asks_no_other_host(site):
    done = subprocess.run([sys.executable, ROOT / ".ci" / "search", site], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout


@pytest.mark.nightly
def test_notebooks_have_their_figures(site):
    for path in sorted((ROOT / "notebooks").glob("*.ipynb")):
        assert "data:image/png;base64" in (site / "notebooks" / f"{path.stem}.html").read_text(), path.stem


@pytest.mark.nightly
@pytest.mark.skipif(CHROMIUM is None, reason="no browser here")
@pytest.mark.parametrize("name", SHOWN)
def test_a_browser_shows_it_without_a_complaint(site, name):
    words = [CHROMIUM, "--headless", "--no-sandbox", "--disable-gpu", "--virtual-time-budget=8000"]
    words += ["--enable-logging=stderr", "--v=0", "--dump-dom", Path(site / name).as_uri()]
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, check=False)
    assert SHOWN[name] in done.stdout
    complaints = [
        line for line in done.stderr.splitlines() if "CONSOLE" in line and "ERR_INTERNET_DISCONNECTED" not in line
    ]
    assert complaints == []
