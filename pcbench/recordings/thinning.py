"""Thin a fast recording to a slow, delayed sensor: some of its measurements, delayed; the truth keeps all."""

from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
import pyarrow as pa

from pcbench.errors import UserError
from pcbench.recordings.log import Batch, Floats, Log, Table
from pcbench.recordings.tables import as_tables


def thin_tables(
    log: Log, stride: int, delays: Mapping[str, Floats] | None = None, truth: Sequence[str] | None = None, seed: int = 0
) -> dict[str, pa.Table]:
    """Return the tables of a recording with one of `every` measurements of each channel.

    Each arrives after a delay drawn from those of its channel [s], NaN: lost; without `delays`, as recorded. The truth is that
    of the recording if it has one, else all measurements, named `truth` or as their channels.
    """
    batches = list(log.measurements())
    if not batches:
        raise UserError(f"{log.name}: got no samples, expected one at least; name another topic or channel.")
    batches = [b._replace(std=b.std if len(b.std) else np.full(len(b.row), np.nan)) for b in batches]
    samples = Batch(*(np.concatenate(columns) for columns in zip(*batches, strict=True)))
    samples = samples.select(np.argsort(samples.sampled, kind="stable"))
    number = pd.Series(samples.channel).groupby(samples.channel).cumcount().to_numpy()
    selection = samples.select(number % stride == 0)
    if delays is not None:
        rng, random_delays = np.random.default_rng(seed), np.zeros(len(selection.row))
        for i, name in enumerate(log.channels):
            of_channel = selection.channel == i
            random_delays[of_channel] = rng.choice(delays[name], of_channel.sum())
        selection = selection._replace(arrived=selection.sampled + random_delays)
    names = log.channels if truth is None else tuple(truth)
    if len(names) != len(log.channels):
        raise UserError(
            f"--truth: got {len(names)} names, expected one for each of the channels {', '.join(log.channels)}; write them so."
        )
    truth_table = _read_all(log.truth) if log.truth else None
    if truth_table is None:
        values = pd.DataFrame({"c": samples.channel, "t": samples.sampled, "v": samples.value}).dropna()
        table = values.groupby(["t", "c"]).v.last().unstack("c").reindex(columns=range(len(names)))
        truth_table = names, table.index.to_numpy(), table.to_numpy()
    inputs = _read_all(log.inputs)[1:] if log.inputs else None
    return as_tables(selection, log.channels, inputs, truth_table)


def delays_of(log: Log, channels: Sequence[str]) -> dict[str, Floats]:
    """Return recorded delays [s] for some channels: of the channel with this name, or of a log's only channel; NaN: lost."""
    batches = list(log.measurements())
    out = {}
    for name in channels:
        if name not in log.channels and len(log.channels) > 1:
            raise UserError(
                f"--delay: got {log.name} with the channels {', '.join(log.channels)}, expected {name} among them; rename one."
            )
        i = log.channels.index(name) if name in log.channels else 0
        delays = [(b.arrived - b.sampled)[b.channel == i] for b in batches]
        out[name] = np.concatenate([np.zeros(0), *delays])
        if not np.isfinite(out[name]).any():
            raise UserError(
                f"--delay: got {log.name}, in which nothing of {name} arrived, expected samples that did; give another."
            )
    return out


def _read_all(table: Table) -> tuple[Sequence[str], Floats, Floats]:
    """Return a table with its names, times and values."""
    parts = list(table.read())
    return table.names, np.concatenate([p.t for p in parts]), np.concatenate([p.values for p in parts])
