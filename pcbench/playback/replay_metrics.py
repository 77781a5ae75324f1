"""Tables of a replay: metrics against truth as in a study, distances to the smoother, and the files in its folder.

Estimates are written tick by tick as they are computed.
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
from pcbench.json_values import json_values
from pcbench.planning import digits
from pcbench.playback.step_block import Score
from pcbench.recordings.log import Floats, Ints
from pcbench.recordings.times import Clock
from pcbench.recordings.windows import Window
from pcbench.runtime import ending
from pcbench.simulation import metrics

Signals = tuple[tuple[str, str], ...]  # with their units
ESTIMATES = "estimates.parquet"
INNOVATIONS = "innovations.parquet"
SMOOTHED = "smoothed.parquet"
SUMMARY = "replay.json"
TABLES = (ESTIMATES, INNOVATIONS, SMOOTHED)
DELAY = "delay"
TIME = ("t", "s", "time since the start of the log")


def estimates_table(
    ticks: Ints,
    estimates: dict[str, Floats],
    sigmas: dict[str, Floats],
    truth: dict[tuple[str, str], Floats],
    delays: dict[str, Floats],
    signals: Signals,
    clock: Clock,
) -> pa.Table:
    """Return some ticks as a table.

    It has t, the true states [K] by <signal> if they are given, the estimates [K, n] by <observer>.<signal>, and the standard
    deviations of their errors [K, n] by <observer>.<signal>.sigma if the observer has them. Delays [K] that some observers
    estimate are in <observer>.delay, if no signal has that name.
    """
    fields = [(*TIME, ticks * clock.dt)]
    fields += [(signal, unit, "true state", x) for (signal, unit), x in truth.items()]
    for observer, estimate in estimates.items():
        for (signal, unit), column in zip(signals, estimate.T, strict=False):
            fields.append((f"{observer}.{signal}", unit, "estimate, after the jump of the tick", column))
        for (signal, unit), column in zip(signals, sigmas[observer].T, strict=False):
            fields.append((f"{observer}.{signal}.sigma", unit, "assumed standard deviation of its error", column))
    for observer, column in delays.items():
        if DELAY not in dict(signals):
            fields.append((f"{observer}.{DELAY}", "s", "estimated mean delay of the first channel", column))
    return _table_of(fields, clock)


def smoothed_table(smoothed_states: Floats, signals: Signals, clock: Clock) -> pa.Table:
    """Return the smoothed states [ticks, n] as a table: t and <signal>."""
    fields = [(*TIME, np.arange(len(smoothed_states)) * clock.dt)]
    fields += [
        (signal, unit, "smoothed state", x) for (signal, unit), x in zip(signals, smoothed_states.T, strict=False)
    ]
    return _table_of(fields, clock)


def innovation_table(
    window: Window, first: int, innovations: dict[str, Floats], channels: tuple[str, ...], clock: Clock
) -> pa.Table:
    """Return the measurements that arrive in a window, which begins at tick `first`, as a table, in the order of arrival.

    It has one row per measurement with its channel, times and value, and of each observer in `innovations` [K, S, 2 q] the
    innovation and its standard deviation. They are NaN if the observer does not report them.
    """
    k, slot, channel = np.nonzero(window.mask)
    fields: list[tuple[str, str, str, Any]] = [
        ("sampled", "s", "time since the start of the log", window.sampling_ticks[k, slot] * clock.dt),
        ("arrived", "s", "time since the start of the log", (first + k) * clock.dt),
        ("value", "", "measured value", window.value[k, slot, channel]),
    ]
    for observer, stats in innovations.items():
        sigma = stats[k, slot, len(channels) + channel]
        meaning = "measured value minus prediction, given all that arrived before"
        fields.append((f"{observer}.innovation", "", meaning, stats[k, slot, channel] * sigma))
        fields.append((f"{observer}.innovation.sigma", "", "assumed standard deviation of the innovation", sigma))
    names = pa.DictionaryArray.from_arrays(pa.array(channel.astype(np.int32)), pa.array(channels, pa.string()))
    return _table_of(fields, clock).add_column(0, "channel", names)


def _table_of(fields: list[tuple[str, str, str, Any]], clock: Clock) -> pa.Table:
    """Return columns (name, unit, meaning, numbers [K]) as a table that stores units and meanings."""
    metadata = {"pcbench.schema": SCHEMA, "start": repr(clock.start), "dt": repr(clock.dt)}
    schema = [pa.field(n, pa.float64(), metadata={"unit": unit, "meaning": meaning}) for n, unit, meaning, _ in fields]
    arrays = [pa.array(np.ascontiguousarray(column)) for *_, column in fields]
    return pa.Table.from_arrays(arrays, schema=pa.schema(schema, metadata=metadata))


class Draft:
    """Files of a replay under temporary names."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.estimates = self.part(ESTIMATES)  # readable once it is closed
        self.summary = self.part(SUMMARY)
        self._writers: dict[str, pq.ParquetWriter] = {}
        self._files = ExitStack()

    def part(self, name: str) -> Path:
        """Return the temporary path of a file."""
        return self.folder / f".{name}.part"

    def write(self, table: pa.Table, name: str = ESTIMATES) -> None:
        """Append rows to one of TABLES."""
        if name not in self._writers:
            self.part(name).unlink(missing_ok=True)  # from a process that was killed
            file = self._files.enter_context(os.fdopen(storage.create(self.part(name)), "wb"))
            writer = pq.ParquetWriter(file, table.schema, compression="snappy", use_dictionary=["channel"])
            self._writers[name] = self._files.enter_context(writer)
        self._writers[name].write_table(table, row_group_size=max(len(table), 1))

    def close(self) -> None:
        """Close the tables."""
        self._files.close()

    def finish(self, summary: Mapping[str, object]) -> None:
        """Write all other results next to the tables, NaN as null, and rename the files to their final names."""
        storage.write_json(storage.target(self.folder), self.summary.name, json_values(summary))
        names = [name for name in TABLES if name in self._writers]
        storage.rename_all([(self.part(name), self.folder / name) for name in (*names, SUMMARY)])
        for name in set(TABLES) - set(names):  # from an earlier replay
            (self.folder / name).unlink(missing_ok=True)


@contextmanager
def draft(folder: Path) -> Iterator[Draft]:
    """Yield a replay's files under temporary names. `Draft.finish` renames them; an interrupted replay leaves none."""
    files, is_new = Draft(folder), not folder.exists()

    def clear() -> None:
        for name in (*TABLES, SUMMARY):
            with suppress(OSError):
                files.part(name).unlink(missing_ok=True)
        if is_new:
            with suppress(OSError):  # not empty: it contains finished files
                folder.rmdir()

    try:
        folder.mkdir(parents=True, exist_ok=True)
        try:
            with ending.clean_on_exit(clear):
                yield files
        finally:
            files.close()
    except OSError as error:
        raise UserError(f"--out {folder}: {error.strerror}, expected a folder to write to; give another.") from None
    finally:
        clear()


def write_summary(folder: Path, summary: Mapping[str, object]) -> None:
    """Write the summary of a replay without estimates to a folder; raise UserError if that fails."""
    with draft(folder) as files:
        storage.write_json(storage.target(folder), files.summary.name, json_values(summary))
        storage.rename_all([(files.summary, folder / SUMMARY)])


def parts(file: Path) -> Iterator[tuple[int, pa.Table]]:
    """Yield the estimates of a file in parts, with the first tick of each."""
    first = 0
    with pq.ParquetFile(file) as parquet:
        for i in range(parquet.num_row_groups):
            table = parquet.read_row_group(i, use_threads=False)
            yield first, table
            first += len(table)


def metrics_table(scores: dict[str, Score], signals: Signals, dt: float, tail: int) -> pd.DataFrame:
    """Return the metrics of a study, one row per observer, signal and metric, over the ticks with known truth."""
    rows = []
    for label, score in scores.items():
        s = jax.tree.map(np.asarray, score)
        n_before, n_total = s.counts[0][:, None], s.counts.sum(0)[:, None]
        error_sums = jax.tree.map(lambda *windows: np.stack(windows)[..., None], s.before, s.tail)
        settling = jax.tree.map(lambda a: a[..., None], s.watch)
        with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 in a tail without truth
            values = metrics.finalize(error_sums, settling, s.final[:, None], n_total, n_before, dt)
        values["unsettled"] = np.asarray(s.watch.settling_tick > tail)[:, None]
        for metric, numbers in values.items():
            is_per_run = numbers.ndim == 1
            rows_of_numbers, counts = (numbers[:, None], n_total.max(0)) if is_per_run else (numbers, n_total)
            for (signal, unit), value, n_ticks in zip(signals, rows_of_numbers, counts, strict=False):
                if n_ticks:
                    unit = "1" if metric in ("unsettled", "diverged") else unit_of(metric, unit)
                    rows.append((label, signal, unit, metric, float(value[0])))
    return pd.DataFrame(rows, columns=["observer", "signal", "unit", "metric", "value"])


def rounding_warnings(
    scores: dict[str, Score], largest: Floats, signals: Signals, limits: list[tuple[Floats, Floats]]
) -> list[str]:
    """Return a sentence for each observer whose errors are not resolved by float64; `largest` [n + s] truth, by signal."""
    out = []
    for label, score in scores.items():
        mae = np.asarray(score.tail.absolute) / np.maximum(score.counts[1], 1.0)
        out += [
            f"{label}: fewer than two digits of the errors of {signals[i][0]} are left in float64, as it reaches "
            f"{digits.amount(float(largest[i]), signals[i][1])}; choose an origin near the state."
            for i in digits.unresolved_signals(largest[: len(mae)], mae, limits)[:1]
        ]
    return out


def distances(
    file: Path, smoothed_states: Floats | None, observers: list[str], signals: Signals, steady: int
) -> pd.DataFrame:
    """Return the rms from tick `steady` on of each estimate minus the smoothed state, by observer and signal.

    Empty: no smoother. NaN: the recording ends before that tick.
    """
    rows = []
    if smoothed_states is not None:
        states = dict(zip(signals, smoothed_states.T, strict=False))
        sums = dict.fromkeys(((o, *signal) for o in observers for signal in states), 0.0)
        for first, table in parts(file):
            for o, signal, unit in sums:
                e = table.column(f"{o}.{signal}").to_numpy() - states[signal, unit][first : first + len(table)]
                e = e[max(steady - first, 0) :]
                sums[o, signal, unit] += float(e @ e)
        n_ticks = len(smoothed_states) - steady
        rows = [(*key, np.sqrt(squares / n_ticks) if n_ticks > 0 else np.nan) for key, squares in sums.items()]
    return pd.DataFrame(rows, columns=["observer", "signal", "unit", "rms"])
