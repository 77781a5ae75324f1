"""Results of the studies that pcbench brings along: is what should be there there?"""

import shlex

import pandas as pd
from documents import commands
from walked import shared_runs

from pcbench.dataset.result import open_result
from pcbench.study import STUDIES

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


def require_whole(name, folder):
    """A study of pcbench's, run: every scenario has its rows, and every number that there can be."""
    stats = pd.read_parquet(folder / "stats.parquet")
    assert set(stats.scenario) == set(STUDIES[name].scenarios)
    lacking = stats[stats["mean"].isna() & stats.reason.isna() & (stats.diverged == 0)]
    lacking = lacking[~nothing_to_judge(lacking, folder)]
    assert lacking.empty, lacking[["scenario", "observer", "signal", "metric"]].drop_duplicates()


def run_studies(page):
    """The studies of these names that a page runs as they are, and the folder of each."""
    found = {}
    for line in commands(page):
        words = shlex.split(line)
        given = dict(zip(words[3::2], words[4::2], strict=False))
        as_it_is = words[1] == "run" and words[2] in STUDIES and set(given) <= {"--seeds", "--out"}
        if as_it_is and line not in shared_runs(page):
            found.setdefault(words[2], given.get("--out", f"results/{words[2]}"))
    return found
