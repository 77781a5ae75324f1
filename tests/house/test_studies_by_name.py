"""Every built-in study runs from a shell, on two seeds."""

import shlex
import subprocess
import sys
from itertools import pairwise

import pytest
from documents import commands
from walked import AS_USERS_HAVE_IT, shorten, with_options
from walked import STUDIES as SHORT
from whole_studies import require_whole, run_studies

from pcbench.study import STUDIES, parse

BY_A_PAGE = {
    study: page for page in AS_USERS_HAVE_IT for study in run_studies(page)
}  # in programs as a user has them too

HEAVY = {  # programs compiled in a hurry take longer here
    "camera-target": pytest.mark.slow,
    "digester": pytest.mark.slow,
    "equal-tuning-reactor": pytest.mark.nightly,
}


def short(name):
    return with_options(SHORT.get(name, []), {} if STUDIES[name].evaluation == "exact" else {"--seeds": "2"})


@pytest.mark.ci
@pytest.mark.parametrize("name", STUDIES)
def test_its_short_form_has_every_scenario_and_observer(name):
    words = short(name)
    overrides = [word for flag, word in pairwise(words) if flag == "--set"]
    grids = [parse.grid_of(name, {}, given) for given in ([], overrides)]
    whole, part = (grid.study for grid in grids)
    assert part.scenarios == whole.scenarios
    assert part.observers == whole.observers
    assert part.tunings == whole.tunings
    assert set(part.axes) == set(whole.axes)
    every, some = ({(cell.scenario.name, cell.times.random) for cell in grid.cells} for grid in grids)
    assert some == every, "schedules that all runs share, and those of each run's own"


@pytest.mark.parametrize("name", BY_A_PAGE)
def test_a_page_runs_no_less_of_a_study_than_its_short_form(name):
    overrides = [word for flag, word in pairwise(short(name)) if flag == "--set"]
    (line,) = (words for words in map(shlex.split, commands(BY_A_PAGE[name])) if words[1:3] == ["run", name])
    made = shorten(line[1:])
    assert [word for flag, word in pairwise(made) if flag == "--set"] == overrides
    assert STUDIES[name].evaluation == "exact" or int(made[made.index("--seeds") + 1]) >= 2


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=HEAVY.get(name, pytest.mark.ci)) for name in STUDIES if name not in BY_A_PAGE],
)
def test_it_runs(name, tmp_path):
    """The others run where a page of the guide does (test_guide_commands)."""
    words = [sys.executable, "-m", "pcbench", "run", name, *short(name), "--quiet", "--out", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    require_whole(name, tmp_path / "out")
