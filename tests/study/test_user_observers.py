"""Observers of a user's own by name: in a list, a table, a file, of an installed package; what cannot be is one sentence."""

import pickle
import shutil
import sys
from functools import partial
from pathlib import Path

import pytest

import pcbench
from pcbench import planning
from pcbench.dataset import serialize
from pcbench.dataset.task import Task
from pcbench.engine import runner
from pcbench.gains import parameters
from pcbench.observers import OBSERVERS
from pcbench.planning import plan
from pcbench.study import parse
from pcbench.study.plugins import user_code

SOURCE = Path(__file__).parents[1] / "support" / "own_observer.py"
BASE = {"name": "mine", "scenarios": ["cart/white"], "seeds": 8}


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A working folder with an observer in mine.py."""
    shutil.copy(SOURCE, tmp_path / "mine.py")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def study(**changes):
    return parse.grid_of(BASE | changes, {}, [])


def test_a_name_in_a_list_has_its_last_word_as_label(here):
    asked, (cell,) = study(observers=["mine.py:nudge", "kf"])
    assert asked.observers == ["nudge", "kf"]
    assert list(cell.options) == ["nudge", "kf"]
    assert cell.options["nudge"].share == 0.1
    assert cell.entry("nudge").observer is sys.modules[f"mine_{asked._plugins['nudge'].code.digest}"].nudge


def test_an_option_made_by_tunable_may_be_tuned_and_no_other(here):
    asked = {"observers": ["mine.py:nudge"]}
    assert parameters.tunable(study(**asked)[1][0].entry("nudge")) == []
    text = SOURCE.read_text()
    (here / "mine.py").write_text(text.replace("float = 0.1", "float = pcbench.tunable(0.1, between=(0, 1))"))
    assert parameters.tunable(study(**asked)[1][0].entry("nudge")) == ["share"]


def test_two_labels_may_use_one_observer_each_with_its_options(here):
    tables = {
        "kf": {},
        "soft": {"use": "mine.py:nudge", "share": 0.05},
        "hard": {"use": "mine.py:nudge", "share": 0.5},
    }
    asked, (cell,) = study(observers=tables)
    assert asked.observers == ["kf", "soft", "hard"]
    assert [cell.options[o].share for o in ("soft", "hard")] == [0.05, 0.5]
    assert cell.entry("soft").observer is cell.entry("hard").observer
    assert cell.options_digests["soft"] != cell.options_digests["hard"]


def test_a_variant_of_a_label_has_the_options_of_both(here):
    _, (cell,) = study(observers=["mine.py:nudge", "nudge-slow"], options={"nudge": {"share": 0.2}, "nudge-slow": {}})
    assert cell.options["nudge-slow"].share == 0.2


def test_a_path_is_relative_to_the_study_file(here, tmp_path, monkeypatch):
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "s.toml").write_text(
        'scenarios = ["cart/white"]\n[observers.near]\nuse = "../mine.py:nudge"\n[observers.kf]\n'
    )
    monkeypatch.chdir("/")
    asked = parse.grid_of(str(tmp_path / "deep" / "s.toml"), {}, []).study
    assert asked.observers == ["near", "kf"]
    assert asked._plugins["near"].code.module == "mine.py"


def test_files_beside_it_that_it_imports_belong_to_its_code(here):
    (here / "helps.py").write_text("import pairs\nHALF = pairs.TWO / 4\n")
    (here / "pairs.py").write_text("TWO = 2\n")
    text = (here / "mine.py").read_text().replace("import pcbench\n", "import pcbench\nfrom helps import HALF\n", 1)
    (here / "mine.py").write_text(text.replace("share: float = 0.1", "share: float = HALF"))
    asked, (cell,) = study(observers=["mine.py:nudge"])
    assert cell.options["nudge"].share == 0.5
    code = asked._plugins["nudge"].code
    assert [name for name, _ in code.files] == ["mine.py", "helps.py", "pairs.py"]
    (here / "pairs.py").write_text("TWO = 3\n")
    changed, (other,) = study(observers=["mine.py:nudge"])
    assert other.options["nudge"].share == 0.75, "not the old one that python has kept"
    assert changed._plugins["nudge"].code.digest != code.digest


def test_an_installed_package_offers_observers_by_plain_names(here, monkeypatch):
    (here / "site").mkdir()
    shutil.copy(SOURCE, here / "site" / "gentle_package.py")
    about = here / "site" / "gentle-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: gentle\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[pcbench.observers]\ngentle = gentle_package:nudge\n")
    monkeypatch.syspath_prepend(str(here / "site"))
    parse.grid_of(BASE | {"observers": ["kf"]}, {}, [])
    assert "gentle_package" not in sys.modules, "nothing is imported that is not named"
    asked, (cell,) = study(observers=["gentle", "kf"])
    assert asked.custom_observers == {"gentle": "gentle_package:nudge"}
    assert cell.entry("gentle").observer is sys.modules["gentle_package"].nudge


@pytest.mark.nightly
def test_it_is_the_program_of_the_same_observer_built_in(here):
    """Not merely as fast: compiled to the same text, for a copy of pcbench's own file."""
    shutil.copy(Path(pcbench.__file__).parent / "observers" / "model_only.py", here / "copied.py")
    programs = []
    for name in ("model-only", "copied.py:OBSERVER"):
        (p,) = plan(parse.grid_of(BASE | {"observers": [name]}, {}, []).study)
        job = runner.Job(p.problem, 0, range(4))
        programs.append(runner.program(p.layout._replace(width=4), job).call.as_text())
    plain = [strip_metadata(text).replace("OBSERVER", "model-only") for text in programs]
    assert plain[0] == plain[1]


def strip_metadata(text):
    import re

    return re.sub(r", metadata=\{[^}]*\}", "", re.sub(r"HloModule [^\n]*|source_file[^\n]*", "", text))


def test_a_planned_cell_takes_its_code_along(here):
    """Another process needs no file: types of the user's own are found again in the code that travels."""
    (p,) = plan(parse.grid_of(BASE | {"observers": ["mine.py:nudge"]}, {}, []).study)
    sent = pickle.dumps(Task(p, ()))
    name = f"mine_{p.cell.user_observers['nudge'].code.digest}"
    del sys.modules[name]
    (here / "mine.py").unlink()
    parcel = pickle.loads(pickle.dumps(pickle.loads(sent))).parcel  # and is sent on
    assert isinstance(parcel, bytes)
    back = serialize.unpack(parcel)
    assert type(back.problem.gains["nudge"]) is sys.modules[name].Gains
    assert (back.problem.gains["nudge"].L == p.problem.gains["nudge"].L).all()
    assert back.layout.observers[0][1] is sys.modules[name].nudge


WRONG = {
    "no file": (["near.py:nudge"], "mine: nudge: 'near.py' is no file"),
    "a file nearly": (["mien.py:nudge"], "did you mean 'mine.py'?"),
    "no such name": (["mine.py:nudg"], "did you mean 'nudge'?"),
    "no observer": (["mine.py:design"], "got a function, expected a pcbench.Observer"),
    "no name": (["mine.py:"], "expected MODULE:NAME such as mine.py:nudge"),
    "two labels alike": (["mine.py:nudge", "mine:nudge"], "expected different labels; write [observers.LABEL]"),
    "a label of pcbench's": ({"kf": {"use": "mine.py:nudge"}}, "which is pcbench's own name"),
    "a label that is none": ({"a b": {"use": "mine.py:nudge"}}, "got the label 'a b', expected letters"),
    "options unknown": ({"own": {"use": "mine.py:nudge", "shore": 1.0}}, "did you mean 'share'?"),
    "an option of another kind": ({"own": {"use": "mine.py:nudge", "share": "much"}}, "options.own: share: got 'much'"),
    "no table": ({"own": "mine.py:nudge"}, "expected a table with `use` and options"),
    "no reference": ({"own": {"use": 3}}, "expected MODULE:NAME"),
    "an observer of pcbench's, otherwise": ({"own": {"use": "kf"}}, "write [observers.kf-own]"),
    "no module": (["no_such_module:nudge"], "there is no module 'no_such_module' here"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_is_wrong_is_one_sentence(here, what):
    observers, sentence = WRONG[what]
    with pytest.raises(pcbench.UserError) as error:
        study(observers=observers)
    assert sentence in str(error.value)
    assert "\n" not in str(error.value)


def test_what_an_import_raises_has_its_line(here):
    (here / "bad.py").write_text("import pcbench\n\n\nnudge = 1 / 0\n")
    with pytest.raises(pcbench.UserError, match=r"bad.py cannot be imported: ZeroDivisionError.*bad.py line 4"):
        study(observers=["bad.py:nudge"])


MODEL, DESIGN = "class Options(BaseModel):", "def design(context, options):"
BROKEN = {  # by what is wrong: a text of the file, what stands there instead with its line marked, and what is said
    "no model": (
        (MODEL, "class Options:  # here"),
        "got another class as Options, mine.py line {}, expected a pydantic model",
    ),
    "a table": (
        (MODEL, "Options = {'a': 0.1}  # here\nclass Other:"),
        "got {{'a': 0.1}} as Options, mine.py line {}, expected",
    ),
    "a validator": (
        (MODEL, f"{MODEL}\n    def model_post_init(self, context):\n        self.share / None  # here\n"),
        "for /: 'float' and 'NoneType', mine.py line {}, expected options or a ValueError",
    ),
    "a refusal": (
        (
            MODEL,
            f"{MODEL}\n    def model_post_init(self, context):\n        raise ValueError('an odd share')  # here\n",
        ),
        "expected an odd share",
    ),
    "a design": (
        (DESIGN, f"{DESIGN}\n    options.shore  # here"),
        "observer nudge: design got AttributeError: 'Options'",
    ),
    "a design's line": ((DESIGN, f"{DESIGN}\n    options.shore  # here"), "mine.py line {}, expected Design"),
    "a design of other arguments": ((DESIGN, "def design(context):  # here"), "design got TypeError: design() takes 1"),
    "its line": ((DESIGN, "def design(context):  # here"), "but 2 were given, mine.py line {}, expected Design"),
    "no design": ((DESIGN, f"{DESIGN}  # here\n    return 1"), "design returned int, mine.py line {}, expected Design"),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_a_file_does_wrong_is_one_sentence_with_its_line_and_nothing_is_written(here, what):
    (old, new), sentence = BROKEN[what]
    text = (here / "mine.py").read_text()
    assert text.count(old) == 1
    (here / "mine.py").write_text(text.replace(old, new))
    line = 1 + next(i for i, row in enumerate((here / "mine.py").read_text().splitlines()) if row.endswith("# here"))
    for ask in (
        partial(pcbench.run, out="out", seeds=4, observers=["mine.py:nudge"]),
        partial(pcbench.design, observer="mine.py:nudge"),
    ):
        with pytest.raises(pcbench.UserError) as error:
            ask("cart/white")
        assert sentence.format(line) in str(error.value)
        assert "\n" not in str(error.value)
    assert not (here / "out").exists()


def test_what_pcbench_itself_does_wrong_is_no_mistake_of_a_users():
    """A traceback is what its authors need."""

    def broken(context, options):
        raise TypeError

    broken.__module__ = "pcbench.observers.kf"
    with pytest.raises(TypeError):
        planning.run_design("kf", OBSERVERS["kf"]._replace(design=broken), None, None)


def test_two_contents_of_one_file_stand_side_by_side(here):
    first = user_code.code_of("mine.py:nudge", "x")
    old = user_code.module_of(first, "x", here)
    (here / "mine.py").write_text((here / "mine.py").read_text().replace("0.1", "0.2"))
    new = user_code.module_of(user_code.code_of("mine.py:nudge", "x"), "x", here)
    assert old.Options().share == 0.1
    assert new.Options().share == 0.2
    assert user_code.module_of(first, "x") is old
