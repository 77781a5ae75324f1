"""Every study that pcbench brings along runs from a shell, in programs as a user has them, on two seeds."""

import subprocess
import sys
from itertools import pairwise

import pandas as pd
import pytest
from walked import STUDIES as SHORT
from walked import with_options

from pcbench.dataset.result import open_result
from pcbench.study import STUDIES, parse


def short(name):
    return with_options(SHORT.get(name, []), {} if STUDIES[name].evaluation == "exact" else {"--seeds": "2"})


@pytest.mark.ci
@pytest.mark.parametrize("name", STUDIES)
def test_its_short_form_has_every_scenario_and_observer(name):
    words = short(name)
    overrides = [word for flag, word in pairwise(words) if flag == "--set"]
    whole, part = (parse.study_of(name, {}, given) for given in ([], overrides))
    assert part.scenarios == whole.scenarios
    assert part.observers == whole.observers
    assert part.tunings == whole.tunings
    assert set(part.axes) == set(whole.axes)


JUDGED = {  # by metric, the column of runs that is NaN where there is nothing to judge: a known state, no sample
    **dict.fromkeys(("nis", "nis_band"), "nis"),
    **dict.fromkeys(("signal_nees", "signal_nees_band", *(f"coverage_{k}_sigma" for k in (1, 2, 3))), "signal_nees"),
}
KEY = ["scenario", "cell", "observer", "signal"]


def nothing_to_judge(stats, folder):
    """Say of every row of stats whether a run has nothing that its metric could judge."""
    if not (folder / "runs").exists():
        return pd.Series(False, stats.index)
    runs = open_result(folder).runs  # read_parquet takes the columns of the first file alone
    none = {
        c: getattr(runs[c].isna().groupby([runs[k] for k in KEY]), "all" if c == "nis" else "any")().to_dict()
        for c in {*JUDGED.values()} & {*runs}
    }
    keys = zip(*(stats[k] for k in KEY), strict=True)
    found = [none.get(JUDGED.get(m), {}).get(key, False) for m, key in zip(stats.metric, keys, strict=True)]
    return pd.Series(found, stats.index)


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_it_runs(name, tmp_path):
    words = [sys.executable, "-m", "pcbench", "run", name, *short(name), "--quiet", "--out", str(tmp_path / "out")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    stats = pd.read_parquet(tmp_path / "out" / "stats.parquet")
    assert set(stats.scenario) == set(STUDIES[name].scenarios)
    lacking = stats[stats["mean"].isna() & stats.reason.isna() & (stats.diverged == 0)]
    lacking = lacking[~nothing_to_judge(lacking, tmp_path / "out")]
    assert lacking.empty, lacking[["scenario", "observer", "signal", "metric"]].drop_duplicates()
