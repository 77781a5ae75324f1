"""Errors of a replay as tables: against truth by the metrics of a study, and against the smoother that sees the whole log.

What a replay leaves in a folder: estimates tick by tick, written as they come, and what is known of each observer.
"""

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import jax
import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.dataset import storage
from pcbench.dataset.columns import SCHEMA, unit_of
from pcbench.errors import UserError
from pcbench.planning import digits
from pcbench.playback.step_block import Score
from pcbench.recordings.log import Floats, Ints
from pcbench.recordings.times import Clock
from pcbench.runtime import ending
from pcbench.simulation import metrics

Signals = tuple[tuple[str, str], ...]  # with their units
ESTIMATES = "estimates.parquet"
SUMMARY = "replay.json"


def table(ticks: Ints, estimates: dict[str, Floats], signals: Signals, clock: Clock) -> pa.Table:
    """Return some ticks of estimates [K, n] by observer as a table: t and <observer>.<signal>, with their units."""
    fields = [("t", "s", "time since the start of the log", ticks * clock.dt)]
    for observer, each in estimates.items():
        for (signal, unit), column in zip(signals, each.T, strict=False):
            fields.append((f"{observer}.{signal}", unit, "estimate, after the jump of the tick", column))
    about = {"pcbench.schema": SCHEMA, "start": repr(clock.start), "dt": repr(clock.dt)}
    schema = [pa.field(n, pa.float64(), metadata={"unit": unit, "meaning": meaning}) for n, unit, meaning, _ in fields]
    arrays = [pa.array(np.ascontiguousarray(column)) for *_, column in fields]
    return pa.Table.from_arrays(arrays, schema=pa.schema(schema, metadata=about))


class Draft:
    """A replay's files before they have their names."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.estimates = folder / f".{ESTIMATES}.part"  # can be read once it is closed
        self.summary = folder / f".{SUMMARY}.part"
        self._writer: pq.ParquetWriter | None = None
        self._files = ExitStack()

    def write(self, table: pa.Table) -> None:
        """Add some ticks."""
        if self._writer is None:
            self.estimates.unlink(missing_ok=True)  # of a process that was killed
            file = self._files.enter_context(os.fdopen(storage.create(self.estimates), "wb"))
            writer = pq.ParquetWriter(file, table.schema, compression="snappy", use_dictionary=False)
            self._writer = self._files.enter_context(writer)
        self._writer.write_table(table, row_group_size=len(table))

    def close(self) -> None:
        """End the estimates."""
        self._files.close()

    def finish(self, summary: Mapping[str, object]) -> None:
        """Write what else is known beside the estimates, NaN as null, and give both files their names."""
        storage.put_json(storage.target(self.folder), self.summary.name, plain(summary))
        storage.rename_all([(self.estimates, self.folder / ESTIMATES), (self.summary, self.folder / SUMMARY)])


@contextmanager
def draft(folder: Path) -> Iterator[Draft]:
    """Make a replay's files beside their names: `Draft.finish` gives them these, what was stopped before leaves nothing."""
    out, new = Draft(folder), not folder.exists()

    def clear() -> None:
        for each in (out.estimates, out.summary):
            with suppress(OSError):
                each.unlink(missing_ok=True)
        if new:
            with suppress(OSError):  # it holds the files that were made
                folder.rmdir()

    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with ending.clean_on_exit(clear):
                yield out
        finally:
            out.close()
    except OSError as error:
        raise UserError(f"--out {folder}: {error.strerror}, expected a folder to write to; give another.") from None
    finally:
        clear()


def parts(file: Path) -> Iterator[tuple[int, pa.Table]]:
    """Yield the estimates of a file part by part, with the tick at which each begins."""
    first = 0
    with pq.ParquetFile(file) as there:
        for i in range(there.num_row_groups):
            found = there.read_row_group(i, use_threads=False)
            yield first, found
            first += len(found)


def plain(thing: Any, nulls: bool = True) -> Any:
    """Return a summary as JSON has it, NaN as null; without `nulls` it is left out of tables."""
    if isinstance(thing, dict):
        out = {str(key): plain(each, nulls) for key, each in thing.items()}
        return {key: each for key, each in out.items() if nulls or each is not None}
    if isinstance(thing, list | tuple):
        return [plain(each, nulls) for each in thing]
    number = thing.item() if isinstance(thing, np.generic) else thing
    return None if isinstance(number, float) and not np.isfinite(number) else number


def metrics_table(scores: dict[str, Score], signals: Signals, dt: float, tail: int) -> pd.DataFrame:
    """Return the metrics of a study, one row each of observer, signal and metric, over the ticks at which truth is known."""
    rows = []
    for label, score in scores.items():
        s = jax.tree.map(np.asarray, score)
        early, known = s.counts[0][:, None], s.counts.sum(0)[:, None]
        streams = jax.tree.map(lambda *windows: np.stack(windows)[..., None], s.before, s.tail)
        watch = jax.tree.map(lambda a: a[..., None], s.watch)
        with np.errstate(invalid="ignore", divide="ignore"):  # of a tail without truth nothing is known
            values = metrics.read(streams, watch, s.final[:, None], known, early, dt)
        values["unsettled"] = np.asarray(s.watch.unsettled > tail)[:, None]
        for metric, each in values.items():
            of_run = each.ndim == 1
            every = zip(signals, each[:, None] if of_run else each, known.max(0) if of_run else known, strict=False)
            for (signal, unit), value, many in every:
                if many:
                    unit = "1" if metric in ("unsettled", "diverged") else unit_of(metric, unit)
                    rows.append((label, signal, unit, metric, float(value[0])))
    return pd.DataFrame(rows, columns=["observer", "signal", "unit", "metric", "value"])


def rounding_warnings(
    scores: dict[str, Score], largest: Floats, signals: Signals, limits: list[tuple[Floats, Floats]]
) -> list[str]:
    """Return a sentence for each observer of whose errors a float64 has no digits; `largest` [n + s] truth, by signal."""
    out = []
    for label, score in scores.items():
        mae = np.asarray(score.tail.absolute) / np.maximum(score.counts[1], 1.0)
        out += [
            f"{label}: fewer than two digits of the errors of {signals[i][0]} are left in float64, as it reaches "
            f"{digits.amount(float(largest[i]), signals[i][1])}; choose an origin near the state."
            for i in digits.unresolved_signals(largest[: len(mae)], mae, limits)[:1]
        ]
    return out


def distances(file: Path, smoothed: Floats | None, observers: list[str], signals: Signals) -> pd.DataFrame:
    """Return the rms over all ticks of each estimate less the smoothed state, by observer and signal; empty: no smoother."""
    rows = []
    if smoothed is not None:
        states = dict(zip(signals, smoothed.T, strict=False))
        sums = dict.fromkeys(((o, *signal) for o in observers for signal in states), 0.0)
        for first, table in parts(file):
            for o, signal, unit in sums:
                e = table.column(f"{o}.{signal}").to_numpy() - states[signal, unit][first : first + len(table)]
                sums[o, signal, unit] += float(e @ e)
        rows = [(*key, np.sqrt(square / len(smoothed))) for key, square in sums.items()]
    return pd.DataFrame(rows, columns=["observer", "signal", "unit", "rms"])
