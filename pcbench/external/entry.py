"""An external estimator: its estimates are made outside pcbench, one run at a time; pcbench only scores them.

This module is also the program of its process. The estimator is constructed for each run and called tick by tick with the
samples that have arrived. It has access to the exported data only.

    python -m pcbench.external.entry DIR MODULE:NAME OUT.parquet

NAME is a function or a class: `make(cell, xhat0)` returns an object whose `step(t, u, arrivals)` returns xhat at t. `cell` is
an entry of cells.json, `u` [m] the input held since the previous tick (zeros at the first), and `arrivals` the samples that
arrive at this tick, the oldest first. Its errors are reported in one sentence with exit code 2.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import jax.numpy as jnp
import numpy as np
import pandas as pd
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict

from pcbench.errors import UserError, describe_exception, short
from pcbench.observers import ObserverSpec
from pcbench.protocols import Observer
from pcbench.study.plugins import user_code
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate

ONE_AT_A_TIME = "external: one run at a time"
REFERENCE = "pcbench.external.entry:EXTERNAL"  # its reference in a study


class Options(BaseModel):
    """No options: an external estimator sets its own."""

    model_config = ConfigDict(extra="forbid")


def design(context: DesignContext, options: Options) -> Design:
    """Return empty gains: an external estimator has its own."""
    return Design((), no_certificate(ONE_AT_A_TIME))


EXTERNAL = ObserverSpec(
    observer=Observer(
        init=lambda gains, xhat0: xhat0,
        snapshot=lambda gains, memory, now: jnp.zeros(0),
        jump=lambda gains, memory, now, arrival: memory,
        flow=lambda gains, memory, now: memory,
        estimate=lambda gains, memory: memory,
    ),
    options=Options,
    design=design,
    knows_schedule=False,
    summary=ONE_AT_A_TIME,
    takes="any schedule",
    elsewhere=True,
)
Floats = NDArray[np.float64]


class ExternalEstimator(Protocol):
    """An object that estimates one run."""

    def step(self, t: float, u: Floats, arrivals: list["ChannelArrival"], /) -> ArrayLike:
        """Return xhat at t [s]."""


class ChannelArrival(NamedTuple):
    """The channels of one sampling instant that arrive now; q outputs."""

    sampled: float  # [s]
    tick: int  # sampling tick
    value: Floats  # [q] NaN where `mask` is False
    mask: NDArray[np.bool_]  # [q]


def main(folder: str, reference: str, out: str) -> None:
    """Run an external estimator on all exported runs, one after another, and write its estimates."""
    draws = Path(folder) / "draws"
    cells = json.loads((draws / "cells.json").read_text())
    tables = {
        name: pd.read_parquet(draws / f"{name}.parquet", partitioning=None) for name in ("samples", "inputs", "starts")
    }
    make = maker(reference)
    parts = [part for cell in cells for part in of_cell(make, cell, tables, reference)]
    pd.concat(parts, ignore_index=True).to_parquet(out, index=False)


def maker(reference: str) -> Callable[..., ExternalEstimator]:
    """Return the object MODULE:NAME; raise UserError if it cannot be called."""
    where = "external estimator"
    code = user_code.code_of(reference, where)
    module, name = user_code.split(reference, where)
    make = getattr(user_code.module_of(code, where, Path(module).resolve().parent if code.files else None), name, None)
    if not callable(make):
        raise UserError(
            f"{where}: got no function '{name}' in {short(module)}, expected make(cell, xhat0); write it there."
        )
    return make


def of_cell(
    make: Callable[..., ExternalEstimator], cell: dict[str, Any], tables: Mapping[str, pd.DataFrame], where: str
) -> Iterator[pd.DataFrame]:
    """Yield the estimates of each run of a grid point."""
    cell_tables = {
        name: table[(table.scenario == cell["scenario"]) & (table.cell == cell["cell"])]
        for name, table in tables.items()
    }
    inputs = cell_tables["inputs"].sort_values("tick").filter(regex=r"^u\d+$").dropna(axis=1).to_numpy(float)
    samples = dict(iter(cell_tables["samples"].dropna(subset=["arrived_tick"]).groupby("seed")))
    q = len(cell["noise_std"])
    for row in cell_tables["starts"].sort_values("seed").itertuples():
        xhat0 = np.array([getattr(row, f"x{i + 1}") for i in range(len(cell["model"]["A"]))])
        arrivals_by_tick = arrivals(samples.get(row.seed), q)
        xhat = of_run(make, cell, xhat0, inputs, arrivals_by_tick, f"{where}: seed {row.seed}")
        names = [signal["name"] for signal in cell["signals"]][: xhat.shape[1]]
        keys = {"scenario": cell["scenario"], "cell": cell["cell"], "seed": row.seed, "tick": np.arange(len(xhat))}
        yield pd.DataFrame(keys | dict(zip(names, xhat.T, strict=True)))


def arrivals(samples: pd.DataFrame | None, q: int) -> dict[int, list[ChannelArrival]]:
    """Return the arrivals by tick, the oldest sampling instant first."""
    out: dict[int, list[ChannelArrival]] = {}
    if samples is None:
        return out
    for _, rows in samples.groupby(["arrived_tick", "sampled_tick"], sort=True):
        time, tick, sampling_tick = (rows[name].iloc[0] for name in ("sampled", "arrived_tick", "sampled_tick"))
        value = np.full(q, np.nan)
        value[rows.channel.to_numpy() - 1] = rows.value.to_numpy()
        out.setdefault(int(tick), []).append(ChannelArrival(float(time), int(sampling_tick), value, ~np.isnan(value)))
    return out


def of_run(
    make: Callable[..., ExternalEstimator],
    cell: dict[str, Any],
    xhat0: Floats,
    inputs: Floats,
    arrivals_by_tick: dict[int, list[ChannelArrival]],
    where: str,
) -> Floats:
    """Return the estimates at ticks 0 .. N-1 of one run, [N, s]; raise UserError for an exception or an invalid result."""
    out, n_signals = [], len(cell["signals"])
    try:
        estimator = make(cell, xhat0.copy())
        for k in range(cell["ticks"]):
            u = inputs[k - 1] if k else np.zeros(inputs.shape[1])
            xhat = np.asarray(estimator.step(k * cell["dt"], u.copy(), arrivals_by_tick.get(k, [])), float).ravel()
            if len(xhat) not in (len(xhat0), n_signals):
                raise UserError(
                    f"{where}: step returned {len(xhat)} numbers, expected {len(xhat0)}, one for each state; return those."
                )
            out.append(xhat)
    except UserError:
        raise
    except Exception as error:
        raise UserError(
            f"{where}: got {describe_exception(error)}, expected step(t, u, arrivals) to return xhat; correct that line."
        ) from None
    return np.array(out)


if __name__ == "__main__":
    try:
        main(*sys.argv[1:])
    except UserError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
