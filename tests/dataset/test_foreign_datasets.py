"""A dataset from somebody else: commands that read it run no code and open no file, wherever its study names some."""

import re
import shutil
import sys
import tomllib
from pathlib import Path

import pytest
import tomli_w

import pcbench
from pcbench.cli.commands import ALL, app

pytestmark = pytest.mark.usefixtures("in_a_hurry")

PAGE = Path(pcbench.__file__).parents[1] / "SECURITY.md"
READS = {  # commands that run no code of a dataset, by what is said after their name; the others run it, or take no dataset
    "status": ["ds", "--json"],
    "report": ["ds", "-q"],
    "tables": ["ds"],
    "cite": ["ds"],
    "merge": ["ds", "ds2", "--out", "merged"],
    "compare": ["ds", "ds2", "-q"],
    "verify": ["ds", "--sample", "0", "-q"],
    "run": ["cart/slow", "--out", "ds", "--observers", "kf", "--seeds", "2", "-q"],
    "find-limit": [
        "cart/slow",
        "--threshold",
        "1",
        "--axis",
        "noise_std",
        "--range",
        "0.1",
        "0.5",
        "--out",
        "ds",
        "-q",
    ],
}
SLOW = ("run", "find-limit", "report")  # asked only where the study is refused
CODE = """
import pathlib
pathlib.Path(__file__).with_name("MARK").touch()
sc = {"base": "cart/slow"}
"""


def in_use(study, reference):
    study["custom_observers"] = {"nudge": reference}
    study["observers"] = ["kf", "nudge"]


def in_tables(study, **table):
    study["tables"] = {"mine": {"base": "cart/slow"} | table}


PLACES = {  # where a name of code may stand in a study: what puts a reference there
    "scenarios": lambda s, ref: s["scenarios"].append(ref),
    "a table of scenarios": lambda s, ref: s.update(scenarios={"mine": {"base": ref}}),
    "use of a table of scenarios": lambda s, ref: s.update(scenarios={"cart/slow": {}, "mine": {"use": ref}}),
    "base of scenario": lambda s, ref: s.update(scenario={"name": "mine", "base": ref}),
    "plant of scenario": lambda s, ref: s.update(scenario={"name": "mine", "base": "cart/slow", "plant": ref}),
    "base of tables": lambda s, ref: in_tables(s, base=ref),
    "plant of tables": lambda s, ref: in_tables(s, plant=ref),
    "controller of tables": lambda s, ref: in_tables(s, controller=ref),
    "observers of tables": lambda s, ref: in_tables(s, observers=[ref]),
    "controller": lambda s, ref: s.update(controller={"use": ref}),
    "use": in_use,
    "observers": lambda s, ref: s.update(observers=["kf", ref]),
    "a table of observers": lambda s, ref: s.update(observers={"kf": {}, "mine": {"use": ref}}),
}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A dataset of one run, to be copied."""
    out = tmp_path_factory.mktemp("foreign") / "ds"
    pcbench.run("cart/slow", observers=["kf"], seeds=2, out=out)
    return out


@pytest.fixture
def here(made, tmp_path, monkeypatch):
    """A folder with two copies of a dataset, and a module that leaves a mark if it is run."""
    for name in ("ds", "ds2"):
        shutil.copytree(made, tmp_path / name)
    (tmp_path / "evil_module.py").write_text(CODE)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def edit(here, change):
    """Change the study of the dataset."""
    for name in ("ds", "ds2"):
        path = here / name / "study.toml"
        study = tomllib.loads(path.read_text())
        change(study)
        path.write_text(tomli_w.dumps(study))


def sentence_of(name, words):
    """What a command says in place of an answer; empty where it gives one."""
    try:
        app([name, *words], prog_name="pcbench", standalone_mode=False)
    except pcbench.UserError as error:
        return str(error)
    return ""


@pytest.mark.ci
@pytest.mark.parametrize("reference", ["evil_module.py:sc", "evil_module:sc"])
@pytest.mark.parametrize("place", PLACES)
def test_reading_a_dataset_runs_no_code_that_its_study_names(here, place, reference, capsys):
    edit(here, lambda study: PLACES[place](study, reference))
    refused = "scenario" in place or place in ("base of tables", "plant of tables")
    for name in [name for name in READS if refused or name not in SLOW]:
        sentence = sentence_of(name, READS[name])
        assert "\n" not in sentence
        assert not (here / "MARK").exists(), f"{name}: {sentence}"
        assert "evil_module" not in sys.modules
        if refused:
            assert re.match(r"ds2?/study.toml: .*evil_module", sentence), name
        if "scenarios" in place or place == "base of scenario":
            assert "expected a table" in sentence, name
        shutil.rmtree(here / "merged", ignore_errors=True)


LTI = {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "sampling_period": 0.1, "delay": 0.1, "noise_std": 0.1}
FILES = {  # where a file of numbers may stand in a study: what puts a name there
    "input of lti": lambda s: s.update(lti=LTI | {"input": "private.csv"}),
    "unknown input of lti": lambda s: s.update(lti=LTI | {"unknown-input": " PRIVATE.CSV", "E": [[1.0]]}),
    "delay of lti": lambda s: s.update(lti=LTI | {"delay": "from:private"}),
    "input of scenario": lambda s: s.update(scenario={"name": "mine", "base": "cart/slow", "input": "../private.csv"}),
    "delay of scenario": lambda s: s.update(scenario={"name": "mine", "base": "cart/slow", "delay": "in-turn:private"}),
    "input of tables": lambda s: in_tables(s, input="private.csv"),
    "unknown input of tables": lambda s: in_tables(s, unknown_input="private.csv"),
    "delay of tables": lambda s: in_tables(s, delay="from:private.csv"),
    "a table of scenarios": lambda s: s.update(scenarios={"mine": {"base": "cart/slow", "input": "private.csv"}}),
}


@pytest.mark.ci
@pytest.mark.parametrize("place", FILES)
def test_reading_a_dataset_opens_no_file_that_its_study_names(here, place, monkeypatch):
    from pcbench.recordings import readers
    from pcbench.study import lti_inputs

    opened = []
    monkeypatch.setattr(readers, "open_log", lambda *given: opened.append(given))
    monkeypatch.setattr(lti_inputs, "_read", lambda path: opened.append(path))
    edit(here, FILES[place])
    for name, words in READS.items():
        sentence = sentence_of(name, words)
        assert re.match(r"ds2?/study.toml: .*(put|delay): got '.*private.*', expected numbers", sentence, re.I), name
    assert opened == []


def test_a_model_of_a_study_opens_no_file(tmp_path):
    """Not by its validators, which know of no gate."""
    from pcbench.study.lti import Lti

    (tmp_path / "private.csv").write_text("t,u1\n0,42\n")
    assert Lti(**LTI, input=str(tmp_path / "private.csv")).input == str(tmp_path / "private.csv")


def test_an_installed_scenario_is_not_imported_for_a_dataset(here, monkeypatch):
    from pcbench.study.plugins import registry

    offered = {"theirs": registry.PackagePlugin("evil_module:sc", "theirs")}
    monkeypatch.setattr(registry, "find_plugins", lambda kind: offered if kind == "scenario" else {})
    edit(here, lambda study: study["scenarios"].append("theirs"))
    assert "expected a table" in sentence_of("status", ["ds"])
    assert not (here / "MARK").exists()


def test_the_security_page_says_of_every_command_what_it_runs():
    """Its table has the commands of READS in rows that run no code of the dataset, and all others that take one."""
    rows = [row.split("|")[1:-1] for row in PAGE.read_text().splitlines() if row.startswith("| `pcbench")]
    named = re.compile(r"`pcbench ((?:external )?[\w-]+)")
    none = {name for row in rows if row[1].strip().startswith("none") for name in named.findall(row[0])}
    runs = {name for row in rows if "the copy" in row[1] for name in named.findall(row[0])}
    assert none == {*READS}
    assert runs == {"verify", "external score", "external run"}
    assert all(row[2].strip().startswith("none") for row in rows)


def test_every_command_is_known_to_read_a_dataset_or_not():
    takes_none = {
        "list",
        "guide",
        "show",
        "new",
        "simulate",
        "info",
        "convert",
        "replay",
        "design",
        "tune",
        "export",
        "check",
        "reproduce",
    }
    runs_its_code = {"external score", "external run"}
    writes_one = {"external prepare"}
    assert {*READS} | takes_none | runs_its_code | writes_one == set(ALL)
