"""A study's results: its tables as pandas frames, read from where they stand."""

from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import pyarrow as pa

from pcbench.dataset import block_files, close, manifest, moments_tables, parquet_io, storage
from pcbench.dataset.timing import Cost
from pcbench.dataset.verify import FAIR
from pcbench.errors import UserError, said
from pcbench.statistics.number_format import UNPROVEN
from pcbench.study import Study, observers_of
from pcbench.synthesis.certificate import is_certified

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow.dataset as ds


def open_result(out: str | Path) -> "Result":
    """Return what a run has left in a folder or under a URI; raise UserError where there is nothing, or it is not whole."""
    target = storage.target(str(out))
    owned = manifest.opened(target)
    there = block_files.settled(block_files.present(target))
    if not close.is_closed(target, there):
        for name in close.damaged(target):
            raise UserError(
                f"{target.name}/{name}: is damaged, expected it as it was written; run the study again to have it made anew."
            )
        raise UserError(
            f"{target.name}: got a study without closing tables of its runs, expected a finished one; go on with pcbench run "
            f"{target.name}/study.toml --out {target.name}."
        )
    result = Result(owned.study, target, out, Cost())
    if (found := storage.get(target, FAIR)) is not None:
        if (table := parquet_io.whole(found)) is None:
            raise UserError(
                f"{target.name}/{FAIR}: is damaged, expected it as it was written; run the study again to have it made anew."
            )
        fair = table.to_pandas()
        result.fair = fair if "certified" in fair else fair.assign(certified=None)
    return result


class Result:
    """A study's results: three tables as pandas frames (see `columns.MEANING`), and its provenance.

    Without a folder of its own it keeps a temporary one, which is removed with it.
    """

    def __init__(
        self,
        study: Study,
        target: storage.Target,
        out: Path | str | None,
        cost: Cost,
        keep: TemporaryDirectory[str] | None = None,
    ):
        self.study, self.out, self.cost, self._target, self._keep = study, out, cost, target, keep
        self.fair: pd.DataFrame | None = None  # of a study with several tunings: see `gains.gain_variants`
        self.provenance: dict[str, Any] = close.record(target) or {}

    @cached_property
    def stats(self) -> "pd.DataFrame":
        """One row per cell, observer, signal and metric."""
        return self._closing("stats.parquet")

    @cached_property
    def pairs(self) -> "pd.DataFrame":
        """One row per cell, pair of observers, signal and metric."""
        return self._closing("pairs.parquet")

    @cached_property
    def runs(self) -> "pd.DataFrame":
        """One row per cell, observer, seed and signal."""
        if not block_files.present(self._target):
            raise UserError(
                f"{self._target.name}: has no runs, its numbers are exact; run the study with evaluation = 'runs'."
            )
        whole = self._read()
        first = ["study", "scenario", "observer", "cell"]
        ordered = whole[first + [c for c in whole.columns if c not in first]]
        return ordered.sort_values([*first, "seed"], kind="stable", ignore_index=True)

    @cached_property
    def scenarios(self) -> list[str]:
        """The scenarios that there are numbers of, in the study's order."""
        return [str(name) for name in self.stats.scenario.unique()]

    @cached_property
    def moments(self) -> "pd.DataFrame":
        """Mean and standard deviation of the errors over time, where they are exact: scenario, cell, observer, signal, t."""
        return self._moments(storage.names(self._target, moments_tables.FOLDER))

    def moments_of(self, scenario: str, cell: int) -> "pd.DataFrame":
        """Return the same of one cell, of whose file alone it is read; none where nothing is exact there."""
        name = moments_tables.place(scenario, cell)
        return self._moments([name] if storage.get(self._target, name) is not None else [])

    def _moments(self, names: list[str]) -> "pd.DataFrame":
        import pandas as pd

        from pcbench.dataset.moments_frames import OVER_TIME

        found = []
        for name in names:
            content = storage.get(self._target, name)
            table = None if content is None else parquet_io.whole(content)
            if table is None:
                raise UserError(f"{self._target.name}/{name}: is damaged; run the study again to have it made anew.")
            scenario, cell = (part.partition("=")[2] for part in name.removesuffix(".parquet").split("/")[-2:])
            found.append(table.to_pandas().assign(scenario=scenario.replace("%2F", "/"), cell=int(cell)))
        first = ["scenario", "cell", *OVER_TIME]
        return pd.concat(found, ignore_index=True)[first] if found else pd.DataFrame({name: [] for name in first})

    def ranks(self, metric: str) -> str:
        """Return the metric that ranks observers where that is asked for: in exact results, of a root its pooled form."""
        late, plain = ("steady_", metric.removeprefix("steady_")) if metric.startswith("steady_") else ("", metric)
        pooled = f"{late}pooled_{plain}"
        return pooled if self.exact and plain in ("rmse", "tracking_rmse", "input_rms") else metric

    @cached_property
    def exact(self) -> bool:
        """Whether some numbers are exact."""
        return bool((self.stats.method == "exact").any())

    @cached_property
    def _parts(self) -> "tuple[dict[Any, pd.DataFrame], dict[Any, pd.DataFrame]]":
        key = ["scenario", "signal"]
        stats, pairs = self.stats.groupby(key, sort=False), self.pairs.groupby(key, sort=False)
        return dict(iter(stats)), dict(iter(pairs))

    def signals(self, scenario: str) -> list[str]:
        """Return the signals of a scenario that there are numbers of, in their order."""
        return [signal for name, signal in self._parts[0] if name == scenario]

    def stats_of(self, scenario: str, signal: str) -> "pd.DataFrame":
        """Return the rows of `stats` of one signal."""
        return self._parts[0][scenario, signal]

    def pairs_of(self, scenario: str, signal: str) -> "pd.DataFrame":
        """Return the rows of `pairs` of one signal; none of one observer alone."""
        return self._parts[1].get((scenario, signal), self.pairs.iloc[:0])

    def runs_of(self, scenario: str, metrics: list[str], cell: int) -> "pd.DataFrame":
        """Return some metrics of the runs of one cell: observer (in the study's order), seed, signal, diverged, metrics."""
        import pyarrow.dataset as ds

        here = (ds.field("scenario") == scenario) & (ds.field("cell") == cell)
        found = self._read(["observer", "seed", "signal", "diverged", *metrics], filter=here)
        order = {name: i for i, name in enumerate(observers_of(self.study, scenario))}
        found["rank"] = found.observer.astype(str).map(order)
        return found.sort_values(["rank", "seed"], kind="stable", ignore_index=True).drop(columns="rank")

    def unproven(self, scenario: str) -> str:
        """Return a sentence that names the observers of a scenario whose gains nothing proves, and why; empty: none is."""
        certificates = self.provenance.get("certificates", {}).get(scenario, {})
        reasons: dict[str, list[str]] = {}
        for observer, c in certificates.items():
            if is_certified(c) is False:
                reasons.setdefault(_why(c), []).append(observer)
        said = [f"{', '.join(observers)} ({why})" for why, observers in reasons.items()]
        return f"{UNPROVEN} the gains of {'; '.join(said)}." if said else ""

    def _read(self, columns: list[str] | None = None, filter: "ds.Expression | None" = None) -> "pd.DataFrame":
        """Rows of the blocks, every page checked; raise UserError, naming the file, where one is damaged."""
        try:
            return self._dataset().to_table(columns, filter=filter).to_pandas()
        except (pa.ArrowException, OSError) as error:
            for block in block_files.present(self._target):
                block_files.read(self._target, block)
            raise UserError(
                f"{self._target.name}/runs: cannot be read ({said(error)}), expected whole blocks; see pcbench verify "
                f"{self._target.name}."
            ) from None

    def _dataset(self) -> "ds.Dataset":
        import pyarrow.dataset as ds

        checked = ds.ParquetFragmentScanOptions(page_checksum_verification=True)
        kind = ds.ParquetFileFormat(default_fragment_scan_options=checked)
        files = [f"{self._target.root}/{block.name}" for block in block_files.present(self._target)]
        base = f"{self._target.root}/runs"
        return ds.dataset(files, filesystem=self._target.fs, format=kind, partitioning="hive", partition_base_dir=base)

    def _closing(self, name: str) -> "pd.DataFrame":
        found = close.table(self._target, name)
        if found is None:
            raise UserError(
                f"{self._target.name}/{name}: is gone or damaged; run the study again to have it made anew."
            )
        return found.to_pandas()

    def __repr__(self) -> str:
        return f"<pcbench result of study '{self.study.name}': {len(self.stats)} rows of stats>"


def _why(certificate: dict[str, Any]) -> str:
    """Why a certificate proves nothing."""
    said: str = certificate["inequality"].removeprefix("none: ")
    return said if certificate["margin"] is None else f"{said} has margin {certificate['margin']:.3g}"
