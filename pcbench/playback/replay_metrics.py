"""Errors of a replay as tables: against truth by the metrics of a study, and against the smoother that sees the whole log.

What a replay leaves in a folder: estimates tick by tick, written as they come, and what is known of each observer.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from pcbench.dataset import atomic_files, storage
from pcbench.dataset.columns import SCHEMA
from pcbench.errors import UserError
from pcbench.planning import digits
from pcbench.playback.step_block import Score
from pcbench.runtime import ending
from pcbench.simulation import metrics
from pcbench.simulation.metrics import ErrorSums

if TYPE_CHECKING:
    import pandas as pd

ESTIMATES = "estimates.parquet"
SUMMARY = "replay.json"


def fields(observers: dict[str, list[tuple[str, str]]], start: float, dt: float) -> pa.Schema:
    """Return the columns of estimates: t and <observer>.<signal>, given (signal, unit) of each observer."""
    about = {"unit": "s", "meaning": "time since the start of the log"}
    out = [pa.field("t", pa.float64(), metadata=about)]
    for observer, signals in observers.items():
        for signal, unit in signals:
            said = {"unit": unit, "meaning": "estimate, after the jump of the tick"}
            out.append(pa.field(f"{observer}.{signal}", pa.float64(), metadata=said))
    return pa.schema(out, metadata={"pcbench.schema": SCHEMA, "start": repr(start), "dt": repr(dt)})


class Draft(NamedTuple):
    """A replay's files before they have their names."""

    folder: Path
    estimates: Path  # the file, which can be read once it is closed
    write: Callable[[pa.Table], None]  # some ticks more
    close: Callable[[], None]


@contextmanager
def draft(folder: Path) -> Iterator[Draft]:
    """Make a replay's files beside their names: `finish` gives them these, and what was stopped before leaves nothing."""
    writers: list[Any] = []  # of the table, and of the file under it
    part, new = folder / f".{ESTIMATES}.part", not folder.exists()

    def write(found: pa.Table) -> None:
        if not writers:
            part.unlink(missing_ok=True)  # of a process that was killed
            sink = os.fdopen(storage.create(part), "wb")
            writers.extend([pq.ParquetWriter(sink, found.schema, compression="snappy", use_dictionary=False), sink])
        writers[0].write_table(found, row_group_size=len(found))

    def close() -> None:
        while writers:
            writers.pop(0).close()

    def clear() -> None:
        for each in (part, _summary(part)):
            with suppress(OSError):
                each.unlink(missing_ok=True)
        if new:
            with suppress(OSError):  # it holds the files that were made
                folder.rmdir()

    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with ending.cleaned(clear):
                yield Draft(folder, part, write, close)
        finally:
            close()
    except OSError as error:
        raise UserError(f"--out {folder}: {error.strerror}, expected a folder to write to; give another.") from None
    finally:
        clear()


def finish(d: Draft, summary: dict[str, Any]) -> None:
    """Write what else is known beside the estimates, NaN as null, and give both files their names."""
    storage.put_json(storage.target(d.folder), _summary(d.estimates).name, plain(summary))
    atomic_files.renamed([(d.estimates, d.folder / ESTIMATES), (_summary(d.estimates), d.folder / SUMMARY)])


def _summary(part: Path) -> Path:
    return part.with_name(f".{SUMMARY}.part")


def table(schema: pa.Schema, t: np.ndarray, estimates: list[np.ndarray]) -> pa.Table:
    """Return some ticks of estimates [K, n] of each observer as a table."""
    columns = [t, *(each[:, i] for each in estimates for i in range(each.shape[1]))]
    return pa.Table.from_arrays([pa.array(np.ascontiguousarray(c)) for c in columns], schema=schema)


def parts(file: Path) -> Iterator[tuple[int, pa.Table]]:
    """Yield the estimates of a file part by part, with the tick at which each begins."""
    first = 0
    with pq.ParquetFile(file) as there:
        for i in range(there.num_row_groups):
            found = there.read_row_group(i, use_threads=False)
            yield first, found
            first += len(found)


def plain(thing: Any) -> Any:
    """Return a summary as JSON has it."""
    if isinstance(thing, dict):
        return {str(key): plain(each) for key, each in thing.items()}
    if isinstance(thing, list | tuple):
        return [plain(each) for each in thing]
    number = thing.item() if isinstance(thing, np.generic) else thing
    return None if isinstance(number, float) and not np.isfinite(number) else number


Signals = tuple[tuple[str, str], ...]
COLUMNS = ("observer", "signal", "unit", "metric", "value")


def metrics_table(score: Score, signals: Signals, dt: float, tail: int) -> "pd.DataFrame":
    """Return the metrics of a study, one row each of observer, signal and metric, over the ticks at which truth is known."""
    import pandas as pd

    score, rows = jax.tree.map(np.asarray, score), []
    early, late = (int(n) for n in score.counts)
    for label, (before, after) in score.streams.items():
        streams: Any = ErrorSums(*(np.stack([a, b])[..., None] for a, b in zip(before, after, strict=True)))  # type: ignore[arg-type]
        watch = jax.tree.map(lambda a: a[..., None], score.watches[label])
        with np.errstate(invalid="ignore", divide="ignore"):  # of a tail without truth nothing is known
            found = metrics.read(streams, watch, score.final[label][:, None], early + late, early, dt)
        found["unsettled"] = np.asarray(score.watches[label].unsettled > tail)[:, None]
        for metric, values in found.items():
            for (signal, unit), value in zip(signals, np.broadcast_to(values, (len(values), 1)), strict=False):
                rows.append(
                    dict(zip(COLUMNS, (label, signal, _unit(metric, unit), metric, float(value[0])), strict=True))
                )
    return pd.DataFrame(rows, columns=list(COLUMNS))


def rounding_warnings(score: Score, largest: Any, signals: Signals, limits: list[tuple[Any, Any]]) -> list[str]:
    """Return a sentence for each observer of whose errors a float64 has no digits; `largest` [n + s] truth, by signal."""
    out, late = [], max(float(score.counts[1]), 1.0)
    for label, (_, after) in score.streams.items():
        mae = np.asarray(after.absolute) / late
        out += [
            f"{label}: fewer than two digits of the errors of {signals[i][0]} are left in float64, as it reaches "
            f"{digits.amount(float(largest[i]), signals[i][1])}; choose an origin near the state."
            for i in digits.unresolved_signals(largest[: len(mae)], mae, limits)[:1]
        ]
    return out


def _unit(metric: str, unit: str) -> str:
    if metric in ("settling_time", "divergence_time"):
        return "s"
    return {"mse": f"({unit})^2", "steady_mse": f"({unit})^2", "unsettled": "1", "diverged": "1"}.get(metric, unit)


def distances(file: Path, smoothed: Any, observers: list[str], signals: Signals) -> "pd.DataFrame":
    """Return the rms over all ticks of each estimate less the smoothed state, by observer and signal; empty: no smoother."""
    import pandas as pd

    if smoothed is None:
        return pd.DataFrame(columns=["observer", "signal", "unit", "rms"])
    states = signals[: smoothed.shape[1]]
    sums, many = dict.fromkeys(((o, s) for o in observers for s, _ in states), 0.0), 0
    for first, table in parts(file):
        for o in observers:
            for i, (signal, _) in enumerate(states):
                e = table.column(f"{o}.{signal}").to_numpy() - smoothed[first : first + len(table), i]
                sums[o, signal] += float(e @ e)
        many += len(table)
    units = dict(signals)
    rows = [{"observer": o, "signal": s, "unit": units[s], "rms": np.sqrt(v / many)} for (o, s), v in sums.items()]
    return pd.DataFrame(rows)
