"""What is cited is what a study used: every observer and scenario has its paper, each entry is whole and stands once."""

import re
from pathlib import Path

import pytest

from pcbench import citing
from pcbench.errors import UserError
from pcbench.observers.methods import METHODS
from pcbench.scenarios import SCENARIOS

ROOT = Path(__file__).parents[2]
CITATION = (ROOT / "CITATION.cff").read_text()
ENTRIES = {r.key: r.text for r in citing.references()}
NEEDED = {"article": {"author", "title", "journal", "year"}, "book": {"author", "title", "publisher", "year"}}


def fields(entry):
    return dict(re.findall(r"^  (\w+) = \{(.*)\},?$", entry, re.M))


@pytest.mark.parametrize("observer", [name for name, method in METHODS.items() if method.source])
def test_every_observer_has_its_paper(observer):
    assert len(citing.find_citations([METHODS[observer].source])) == {"ukf": 2}.get(
        observer, 1
    )  # and the cubature filter's


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_every_scenario_has_its_paper(scenario):
    assert len(citing.find_citations([SCENARIOS[scenario].source])) == 1


@pytest.mark.parametrize("key", ENTRIES)
def test_an_entry_is_whole(key):
    entry, found = ENTRIES[key], fields(ENTRIES[key])
    kind = re.match(r"@(\w+)\{", entry)[1]
    assert NEEDED.get(kind, {"author", "title"}) <= found.keys()
    assert entry.count("{") == entry.count("}")
    assert entry.isascii()
    assert re.fullmatch(r"10\.\d{4,}/\S+", found.get("doi", "10.1000/x"))


def test_papers_are_those_of_the_citation_file_with_the_same_numbers():
    for doi, year, start in re.findall(r"year: (\d+)\n    start: (\d+)\n(?:    end: \d+\n)?    doi: (\S+)", CITATION):
        year, start, doi = doi, year, start
        (entry,) = [fields(e) for e in ENTRIES.values() if fields(e).get("doi") == doi]
        assert entry["year"] == year
        assert entry["pages"].startswith(start)
    said = {doi for method in METHODS.values() for doi in re.findall(r"doi (10\.[^\s,;]+)", method.source)}
    assert len(said) >= 4
    assert said <= {fields(e).get("doi") for e in ENTRIES.values()}


def cited(what=None):
    return set(re.findall(r"^@\w+\{([\w-]+),", citing.bibtex(what), re.M))


def test_a_result_cites_what_it_used_and_nothing_else(whole):
    assert cited(whole) == {"pcbench", "jax", "numpy", "scipy", "mohammed2017", "cvxpy", "clarabel"}
    assert re.search(r"% releases: pcbench \S+, jax \S+", citing.bibtex(whole))


def test_a_study_that_has_not_run_cites_no_solver():
    assert cited("csth/10s-noise") == {"pcbench", "jax", "numpy", "scipy", "alipouri2021", "kalman1960"}
    assert "not run yet" in citing.bibtex("csth/10s-noise")


def test_of_nothing_in_particular_it_cites_everything():
    assert cited() == set(ENTRIES)


def test_an_own_observer_is_named_for_the_user_to_cite(tmp_path):
    (tmp_path / "mine.py").write_text("from pcbench.observers import OBSERVERS\nnudge = OBSERVERS['kf']\n")
    (tmp_path / "s.toml").write_text(f'scenarios = ["cart/white"]\nobservers = ["{tmp_path}/mine.py:nudge"]\n')
    assert "your own, cite it yourself: nudge" in citing.bibtex(str(tmp_path / "s.toml"))
    with pytest.raises(UserError, match="is no study"):
        citing.bibtex("nowhere")
