"""Small logs: rows as a person writes them, and simulated runs."""

import numpy as np
import pandas as pd

from pcbench.dataset import single_table
from pcbench.recordings import tables
from pcbench.recordings.log import Batch, Log

MOTOR = {
    "name": "motor",
    "lti": {
        "A": [[0.0, 1.0], [-2.0, -3.0]],
        "B": [[0.0], [1.0]],
        "C": [[1.0, 0.0]],
        "states": ["angle [rad]", "rate [rad/s]"],
        "tick": 0.01,
        "sampling_period": 0.05,
        "delay": 0.1,
        "noise_std": 0.1,
        "process_std": [0.01, 0.05],
        "duration": 4.0,
        "input": "sine",
    },
}


def rows(folder, measured, inputs=None, kind="csv"):
    """Write measurements (columns by name) into a folder, and inputs where there are any."""
    folder.mkdir(exist_ok=True)
    for name, columns in (("measurements", measured), ("inputs", inputs)):
        if columns is not None:
            frame = pd.DataFrame(columns)
            path = folder / f"{name}.{kind}"
            frame.to_csv(path, index=False) if kind == "csv" else frame.to_parquet(path, index=False)
    return folder


def write_log(folder, batch, channels, inputs=None, truth=None, kind=".parquet"):
    """Put a batch of samples, with inputs and truth where there are any, into a folder as a log."""
    for name, table in tables.as_tables(batch, channels, inputs, truth).items():
        single_table.write_table(folder / f"{name}{kind}", table)


def plain(many=40, every=0.05, late=0.1):
    """Columns of a log without anything odd."""
    t = np.arange(many) * every
    return {"channel": ["y1"] * many, "sampled": t, "arrived": t + late, "value": np.sin(t)}


def log_of(samples, dt=1.0, channels=2, part=7, order=None):
    """A log of samples (channel, taken, arrives or None [ticks]) in parts; their values are their places."""
    each = samples if order is None else [samples[i] for i in order]
    value = {s: float(i) for i, s in enumerate(samples)}

    def measurements():
        for first in range(0, len(each), part):
            some = each[first : first + part]
            yield Batch(
                np.array([c for c, _, _ in some]),
                np.array([t * dt for _, t, _ in some], float),
                np.array([np.nan if a is None else a * dt for _, _, a in some], float),
                np.array([value[s] for s in some]),
                np.arange(first + 1, first + 1 + len(some)),
            )

    return Log("test", tuple(f"y{i + 1}" for i in range(channels)), measurements)
