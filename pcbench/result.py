"""What a study gave: its tables as pandas frames, read from where they stand."""

import json
from functools import cached_property
from pathlib import Path
from typing import Any

import pandas as pd
import pyarrow.dataset as ds

from pcbench import tables
from pcbench.dataset import campaign, closing, store
from pcbench.errors import UserError
from pcbench.study import Study


class Result:
    """What a study gave: three tables as pandas frames (see `tables.MEANING`), and its provenance.

    Without a folder of its own it stands in a temporary one, which goes when the result does.
    """

    def __init__(
        self, study: Study, place: store.Target, out: Path | str | None, effort: campaign.Effort, keep: Any = None
    ):
        self.study, self.out, self.effort, self._place, self._keep = study, out, effort, place, keep
        self.fair: pd.DataFrame | None = None  # of a study with several tunings: see `tuning.fairness`
        self.provenance: dict[str, Any] = json.loads(store.text(place, "provenance.json") or b"{}")

    @cached_property
    def stats(self) -> pd.DataFrame:
        """One row per cell, observer, signal and metric."""
        return self._closing("stats.parquet")

    @cached_property
    def pairs(self) -> pd.DataFrame:
        """One row per cell, pair of observers, signal and metric."""
        return self._closing("pairs.parquet")

    @cached_property
    def runs(self) -> pd.DataFrame:
        """One row per cell, observer, seed and signal."""
        files = [f"{self._place.root}/{name}" for name in store.names(self._place, "runs")]
        base = f"{self._place.root}/runs"
        found = ds.dataset(
            files, filesystem=self._place.fs, format="parquet", partitioning="hive", partition_base_dir=base
        )
        whole = found.to_table().to_pandas()
        first = ["study", "scenario", "observer", "cell"]
        ordered = whole[first + [c for c in whole.columns if c not in first]]
        return ordered.sort_values([*first, "seed"], kind="stable", ignore_index=True)

    def _closing(self, name: str) -> pd.DataFrame:
        found = closing.table(self._place, name)
        if found is None:
            raise UserError(f"{self._place.name}/{name}: is gone or damaged; run the study again to have it made anew.")
        return tables.frame(found)

    def __repr__(self) -> str:
        return f"<pcbench result of study '{self.study.name}': {len(self.stats)} rows of stats>"
