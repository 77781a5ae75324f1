"""Any TOML either runs or ends in one sentence that names the place and says what was expected: never a traceback."""

import re
import warnings

import numpy as np
import pytest
import tomli_w
from fuzzed import BUILT_IN, OWN, PUBLISHED, documents, extreme, keys, mutants, values
from hanging import in_time
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pcbench import api, planning
from pcbench.errors import UserError
from pcbench.runtime import config
from pcbench.study import observers_of, parse
from pcbench.study.grid import cells

pytestmark = pytest.mark.usefixtures("in_a_hurry")

FEW = {"derandomize": True, "suppress_health_check": list(HealthCheck), "print_blob": True}
MANY = FEW | {"derandomize": False}


def one_sentence(said):
    """One line, the place first, what was expected, and a full stop."""
    assert said.isprintable(), said
    assert re.match(r".+: \S", said), said
    assert re.search(r"expected|valid:|write ", said), said
    assert said.endswith("."), said
    assert len(said) < 1500, said


def outcome(path, changes=(), most=0):
    """Read a study and plan it where all its cells have at most so many ticks; None where it is refused in one sentence."""
    with in_time(), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            study = parse.load(str(path), list(changes))
            if ticks_of(study) <= most:
                with config.float64():
                    planning.plan(study)
        except UserError as error:
            one_sentence(str(error))
            return None
    return study


def ticks_of(study):
    """The ticks of all cells of a study, for all observers."""
    every = [(name, cell) for name in study.scenarios for cell in cells(study, name)]
    return sum(cell.times.ticks * len(observers_of(study, name)) for name, cell in every)


def write_study(folder, content):
    """Write a study (text, bytes or what TOML holds) to a file, and return its path."""
    path = folder / "study.toml"
    text = tomli_w.dumps(content) if isinstance(content, dict) else content
    path.write_bytes(text if isinstance(text, bytes) else text.encode("utf-8", "surrogatepass"))
    return path


OF_ONES_OWN = "a plant of one's own, changed"
CONTENT = {  # what a file may hold, and how many ticks of it are planned: by default, and in slow tests
    "any TOML": (documents, 0, 0),
    "no TOML": (st.text() | st.binary(), 0, 0),
    "a published study, changed": (mutants(PUBLISHED + BUILT_IN), 0, 50_000),
    OF_ONES_OWN: (mutants(OWN), 2_000, 20_000),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzzed")


@pytest.mark.ci
@pytest.mark.parametrize("what", [what for what, (_, planned, _) in CONTENT.items() if not planned])
@settings(max_examples=40, **FEW)
@given(data=st.data())
def test_a_file_is_read_or_refused_in_one_sentence(what, data, folder):
    outcome(write_study(folder, data.draw(CONTENT[what][0])))


@pytest.mark.ci
@settings(max_examples=10, **FEW)
@given(content=CONTENT[OF_ONES_OWN][0])
def test_a_plant_of_ones_own_is_planned_or_refused_in_one_sentence(content, folder):
    outcome(write_study(folder, content), most=CONTENT[OF_ONES_OWN][1])


@pytest.mark.nightly
@pytest.mark.parametrize("what", CONTENT)
@settings(max_examples=2_000, **MANY)
@given(data=st.data())
def test_many_files_are_planned_or_refused_in_one_sentence(what, data, folder):
    content, _, most = CONTENT[what]
    outcome(write_study(folder, data.draw(content)), most=most)


path_of_keys = st.lists(keys, max_size=4).map(".".join)
changes = st.builds("{}={}".format, path_of_keys, values | st.text(max_size=12)) | st.text(max_size=12)


@pytest.mark.ci
@settings(max_examples=40, **FEW)
@given(change=changes, study=st.sampled_from(OWN))
def test_a_change_by_set_is_made_or_refused_in_one_sentence(folder, change, study):
    outcome(write_study(folder, study), [change])


@pytest.mark.nightly
@settings(max_examples=2_000, **MANY)
@given(change=changes, study=st.sampled_from(OWN))
def test_many_changes_by_set_are_made_or_refused_in_one_sentence(folder, change, study):
    outcome(write_study(folder, study), [change], most=3_000)


def tables_hold_numbers(path):
    """Run a study to the end: every statistic of runs that did not diverge is a number, or it is refused in one sentence."""
    with in_time(), warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            stats = api.run(path).stats
        except UserError as error:
            one_sentence(str(error))
            return
    some = stats[(stats["n"] > 0) & (stats["metric"] != "rms_efficiency")]  # of no error at all there is no efficiency
    assert np.isfinite(some["mean"]).all(), some[~np.isfinite(some["mean"])]
    assert (stats["n"] + stats["diverged"] > 0).all()


@pytest.mark.ci
@settings(max_examples=12, **FEW)
@given(content=extreme)
def test_a_plant_of_extreme_numbers_runs_or_is_refused_in_one_sentence(content, folder):
    tables_hold_numbers(write_study(folder, content))


@pytest.mark.nightly
@settings(max_examples=1_000, **MANY)
@given(content=extreme)
def test_many_plants_of_extreme_numbers_run_or_are_refused_in_one_sentence(content, folder):
    tables_hold_numbers(write_study(folder, content))


@pytest.mark.nightly
@settings(max_examples=25, **MANY)
@given(content=mutants([study for study in OWN if "lti" in study]))
def test_studies_with_changes_run_to_the_end_or_are_refused_in_one_sentence(content, folder):
    path = write_study(folder, content)
    study = outcome(path, most=20_000)
    if study is not None and ticks_of(study) <= 20_000 and study.seeds <= 10:
        tables_hold_numbers(path)
