"""Every study that pcbench brings along runs from a shell, in programs as a user has them, on two seeds."""

import subprocess
import sys
from itertools import pairwise

import pandas as pd
import pytest
from walked import STUDIES as SHORT
from walked import with_options

from pcbench.study import STUDIES, read


def short(name):
    return with_options(SHORT.get(name, []), {} if STUDIES[name].method == "exact" else {"--seeds": "2"})


@pytest.mark.parametrize("name", STUDIES)
def test_its_short_form_has_every_scenario_and_observer(name):
    words = short(name)
    overrides = [word for flag, word in pairwise(words) if flag == "--set"]
    whole, part = (read.study_of(name, {}, given) for given in ([], overrides))
    assert part.scenarios == whole.scenarios
    assert part.observers == whole.observers
    assert part.tunings == whole.tunings
    assert set(part.axes) == set(whole.axes)


@pytest.mark.nightly
@pytest.mark.parametrize("name", STUDIES)
def test_it_runs(name, tmp_path):
    words = [sys.executable, "-m", "pcbench", "run", name, *short(name), "--quiet", "--out", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    stats = pd.read_parquet(tmp_path / "out" / "stats.parquet")
    assert set(stats.scenario) == set(STUDIES[name].scenarios)
    lacking = stats[stats["mean"].isna() & stats.reason.isna() & (stats.diverged == 0)]
    assert lacking.empty, lacking[["scenario", "observer", "signal", "metric"]].drop_duplicates()
