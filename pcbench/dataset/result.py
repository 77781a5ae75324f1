"""The results of a study: its tables as pandas frames, read from the dataset."""

from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import pyarrow as pa

from pcbench.dataset import block_files, close, manifest, moments_tables, parquet_io, storage
from pcbench.dataset.timing import Cost
from pcbench.dataset.verify import FAIR
from pcbench.errors import UserError, first_sentence
from pcbench.statistics.number_format import UNPROVEN
from pcbench.study import Study, observers_of
from pcbench.synthesis.certificate import is_certified

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow.dataset as ds


def open_result(out: str | Path) -> "Result":
    """Open the result of a finished study.

    Args:
        out: folder or URI, as given to `run`.

    Returns:
        The result, as `run` returned it.

    Raises:
        UserError: there is no finished study, or a file is damaged.
    """
    target = storage.target(str(out))
    claim = manifest.load_manifest(target)
    if not close.is_closed(target, block_files.drop_overlaps(block_files.present(target))):
        for name in close.damaged_files(target):
            raise _damage_error(target, name)
        raise UserError(
            f"{target.name}: got a study without closing tables of its runs, expected a finished one; continue with pcbench "
            f"run {target.name}/study.toml --out {target.name}."
        )
    result = Result(claim.study, target, out, Cost())
    if (content := storage.read_buffer(target, FAIR)) is not None:
        if (table := parquet_io.unseal_table(content)) is None:
            raise _damage_error(target, FAIR)
        fair = table.to_pandas()
        result.fair = fair if "certified" in fair else fair.assign(certified=None)
    return result


def _damage_error(target: storage.Target, name: str) -> UserError:
    return UserError(f"{target.name}/{name}: is damaged; run the study again to write a new one.")


class Result:
    """The results of a study: the tables `stats`, `pairs` and `runs` as pandas frames, and the provenance.

    The page *Columns of the tables* lists their columns. If the study has no folder, the files are in a temporary one,
    which is removed with the result.
    """

    def __init__(
        self,
        study: Study,
        target: storage.Target,
        out: Path | str | None,
        cost: Cost,
        tempdir: TemporaryDirectory[str] | None = None,
    ):
        self.study, self.out, self.cost, self._target, self._tempdir = study, out, cost, target, tempdir
        self._opened: tuple[tuple[block_files.Block, ...], ds.Dataset] | None = None
        self.fair: pd.DataFrame | None = None  # of a study with several tunings: see `gains.gain_variants`
        self.provenance: storage.Json = close.record(target) or {}

    @cached_property
    def stats(self) -> "pd.DataFrame":
        """One row per grid point, observer, signal and metric."""
        return self._closing_table("stats.parquet")

    @cached_property
    def pairs(self) -> "pd.DataFrame":
        """One row per grid point, pair of observers, signal and metric."""
        return self._closing_table("pairs.parquet")

    @cached_property
    def runs(self) -> "pd.DataFrame":
        """One row per grid point, observer, seed and signal."""
        if not block_files.present(self._target):
            raise UserError(
                f"{self._target.name}: has no runs, its numbers are exact; run the study with evaluation = 'runs'."
            )
        rows, first = self._read(), ["study", "scenario", "observer", "cell"]
        rows = rows[first + [c for c in rows.columns if c not in first]]
        return rows.sort_values([*first, "seed"], kind="stable", ignore_index=True)

    @cached_property
    def scenarios(self) -> list[str]:
        """Names of the scenarios with results, in the order of the study."""
        return [str(name) for name in self.stats.scenario.unique()]

    @cached_property
    def moments(self) -> "pd.DataFrame":
        """Exact mean and standard deviation of the errors over time, per scenario, grid point, observer, signal and t.

        None are kept of a study of more than 1,000 grid points; `pcbench.exact_moments` computes them for one.
        """
        return self._moments(storage.file_names(self._target, moments_tables.FOLDER))

    def moments_of(self, scenario: str, cell: int) -> "pd.DataFrame":
        """Return the rows of `moments` of one grid point; none if it has no exact results."""
        name = moments_tables.moments_file(scenario, cell)
        return self._moments([name] if storage.read_buffer(self._target, name) is not None else [])

    def _moments(self, names: list[str]) -> "pd.DataFrame":
        import pandas as pd

        from pcbench.dataset.moments_frames import OVER_TIME

        frames = []
        for name in names:
            table = parquet_io.unseal_table(storage.read_buffer(self._target, name))
            if table is None:
                raise _damage_error(self._target, name)
            scenario, cell = (part.partition("=")[2] for part in name.removesuffix(".parquet").split("/")[-2:])
            frames.append(table.to_pandas().assign(scenario=scenario.replace("%2F", "/"), cell=int(cell)))
        first = ["scenario", "cell", *OVER_TIME]
        return pd.concat(frames, ignore_index=True)[first] if frames else pd.DataFrame({name: [] for name in first})

    def ranks(self, metric: str) -> str:
        """Return the metric that ranks observers: for a root mean square in exact results, its pooled form."""
        base = metric.removeprefix("steady_")
        is_root = self.exact and base in ("rmse", "tracking_rmse", "input_rms")
        return f"{metric.removesuffix(base)}pooled_{base}" if is_root else metric

    @cached_property
    def exact(self) -> bool:
        """Whether some results are exact."""
        return bool((self.stats.method == "exact").any())

    @cached_property
    def _by_signal(self) -> "list[dict[tuple[str, str], pd.DataFrame]]":
        frames = (frame.groupby(["scenario", "signal"], sort=False) for frame in (self.stats, self.pairs))
        return [{(str(key[0]), str(key[1])): part for key, part in groups} for groups in frames]

    def signals(self, scenario: str) -> list[str]:
        """Return the signals of a scenario with results, in their order."""
        return [signal for name, signal in self._by_signal[0] if name == scenario]

    def stats_of(self, scenario: str, signal: str) -> "pd.DataFrame":
        """Return the rows of `stats` of one signal."""
        return self._by_signal[0][scenario, signal]

    def pairs_of(self, scenario: str, signal: str) -> "pd.DataFrame":
        """Return the rows of `pairs` of one signal; none if there is only one observer."""
        return self._by_signal[1].get((scenario, signal), self.pairs.iloc[:0])

    def runs_of(self, scenario: str, metrics: list[str], cell: int) -> "pd.DataFrame":
        """Return some metrics of the runs of one grid point, with the columns observer, seed, signal and diverged."""
        import pyarrow.dataset as ds

        condition = (ds.field("scenario") == scenario) & (ds.field("cell") == cell)
        rows = self._read(["observer", "seed", "signal", "diverged", *metrics], condition)
        order = {name: i for i, name in enumerate(observers_of(self.study, scenario))}
        rows["rank"] = rows.observer.astype(str).map(order)
        return rows.sort_values(["rank", "seed"], kind="stable", ignore_index=True).drop(columns="rank")

    def unproven(self, scenario: str) -> str:
        """Return a sentence that names the observers of a scenario without a certificate, and why; empty if there are none."""
        reasons: dict[str, list[str]] = {}
        for observer, c in self.provenance.get("certificates", {}).get(scenario, {}).items():
            if is_certified(c) is False:
                reason = c["inequality"].removeprefix("none: ")
                reason += "" if c["margin"] is None else f" has margin {c['margin']:.3g}"
                reasons.setdefault(reason, []).append(observer)
        parts = [f"{', '.join(observers)} ({reason})" for reason, observers in reasons.items()]
        return f"{UNPROVEN} the gains of {'; '.join(parts)}." if parts else ""

    def _read(self, columns: list[str] | None = None, where: "ds.Expression | None" = None) -> "pd.DataFrame":
        """Rows of the blocks, with every page checked; raise UserError with the file's name if one is damaged.

        A column that only some observers have, such as nees, is null for the others.
        """
        target, blocks = self._target, block_files.present(self._target)
        try:
            dataset = self._open(tuple(blocks))
            return dataset.to_table(columns, filter=where).to_pandas()
        except (pa.ArrowException, OSError) as error:
            for block in blocks:
                block_files.read_block(target, block)
            raise UserError(
                f"{target.name}/runs: cannot be read ({first_sentence(error)}), expected complete blocks; see pcbench "
                f"verify {target.name}."
            ) from None

    def _open(self, blocks: "tuple[block_files.Block, ...]") -> "ds.Dataset":
        """Return these blocks as one table on disk. The last one is kept, because its files are opened to know its columns."""
        import pyarrow.dataset as ds
        import pyarrow.parquet as pq

        if self._opened is None or self._opened[0] != blocks:
            scan_options = ds.ParquetFragmentScanOptions(page_checksum_verification=True)
            parquet = ds.ParquetFileFormat(default_fragment_scan_options=scan_options)
            target = self._target
            files, base = [f"{target.root}/{block.name}" for block in blocks], f"{target.root}/runs"
            options = {"filesystem": target.fs, "format": parquet, "partitioning": "hive", "partition_base_dir": base}
            dataset = ds.dataset(files, **options)
            first_files = {(b.scenario, b.observer): file for b, file in zip(blocks, files, strict=True)}
            schemas = [pq.read_schema(file, filesystem=target.fs) for file in first_files.values()]
            if any(set(schema.names) - set(dataset.schema.names) for schema in schemas):
                dataset = ds.dataset(files, schema=pa.unify_schemas([dataset.schema, *schemas]), **options)
            self._opened = blocks, dataset
        return self._opened[1]

    def _closing_table(self, name: str) -> "pd.DataFrame":
        table = close.table(self._target, name)
        if table is None:
            raise UserError(
                f"{self._target.name}/{name}: is missing or damaged; run the study again to write it again."
            )
        return table.to_pandas()

    def __repr__(self) -> str:
        return f"<pcbench result of study '{self.study.name}': {len(self.stats)} rows of stats>"
