"""Comparison of gains of several origins: on the training runs, on other runs, and with the bound."""

from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from pcbench.dataset import parquet_io, run_study, storage
from pcbench.dataset.result import Result
from pcbench.dataset.run_study import RunOptions
from pcbench.dataset.verify import FAIR
from pcbench.gains.gain_variants import ExplicitStudy, Version, training_study
from pcbench.gains.objective import Objective
from pcbench.study import parse
from pcbench.toml_text import TomlTable


def report(explicit_study: ExplicitStudy, result: Result, out: str | Path | None, options: RunOptions) -> Result:
    """Return the result with its table `fair`, which compares versions on training seeds, on other seeds and with the bound.

    It has one row per cell and version. `training` and `held_out` are means of the objective with their standard errors; for
    a pooled objective they are roots of mean squares, and `training` of an exact tuning is the expected value. `gap` is
    held_out minus training. `rms_efficiency` is the bound divided by steady_pooled_rmse on the study's seeds, with its
    interval, or NaN without a bound. `certified` is that of stats. `note` is the reason if a start was kept. With `out`, the
    table is written as fair.parquet, and the training runs in out/training. `options` are those of the study's own runs.
    """
    if explicit_study.aim is None:
        return result
    folder = None if out is None else f"{out}/training"
    training = run_study.execute(
        parse.grid_of(training_study(explicit_study.study), {}, []),
        folder,
        options._replace(until_se=None, max_seeds=None),
    )
    result.fair = table(explicit_study.versions, explicit_study.aim, training.stats, result.stats)
    if out is not None:
        content = pa.Table.from_pandas(result.fair, preserve_index=False)
        storage.write_table(storage.target(str(out)), FAIR, parquet_io.seal_table(content))
    return result


def table(versions: list[Version], aim: Objective, training: pd.DataFrame, held_out: pd.DataFrame) -> pd.DataFrame:
    """Return the table from the stats of the training runs and of the study's own runs."""
    rows: list[TomlTable] = []
    for cell in held_out.cell.unique():
        for v in versions:
            a, b = (_row(stats, cell, v.label, aim, aim.metric) for stats in (training, held_out))
            efficiency = _row(held_out, cell, v.label, aim, "rms_efficiency")
            rows.append(
                {"scenario": b["scenario"], "cell": cell, "observer": v.observer, "tuning": v.tuning, "label": v.label}
                | {"signal": aim.name, "metric": aim.metric, "unit": b["unit"]}
                | {"training": a["mean"], "training_se": a["se"], "held_out": b["mean"], "held_out_se": b["se"]}
                | {"gap": b["mean"] - a["mean"], "gap_se": float(np.hypot(a["se"], b["se"])), "diverged": b["diverged"]}
                | {"rms_efficiency": efficiency["mean"]}
                | {"efficiency_low": efficiency["ci_low"], "efficiency_high": efficiency["ci_high"]}
                | {"certified": b["certified"], "note": v.note}
            )
    return pd.DataFrame(rows)


def _row(stats: pd.DataFrame, cell: int, label: str, aim: Objective, metric: str) -> TomlTable:
    mask = (stats.cell == cell) & (stats.observer == label) & (stats.signal == aim.name) & (stats.metric == metric)
    rows: list[TomlTable] = stats[mask].to_dict("records")  # type: ignore[assignment]
    return rows[0] if rows else dict.fromkeys(("mean", "se", "ci_low", "ci_high"), np.nan)
