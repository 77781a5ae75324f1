"""What the figures of a replay show, as frames: a replay's folder is read in parts, and thinned to what a figure resolves.

Thinned series keep the least and the largest value of each of BINS equal parts of time, so that no outlier is lost.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.playback import innovation_tests
from pcbench.playback.replay_metrics import ESTIMATES, INNOVATIONS, SMOOTHED, SUMMARY
from pcbench.statistics import Z95

BINS = 300  # parts of time, of which the extremes are kept
PERIODS = 60  # parts of time, of which the mean log-likelihood is drawn
Floats = NDArray[np.float64]


class Replay(NamedTuple):
    """A replay's folder."""

    folder: Path
    summary: dict[str, Any]  # of replay.json
    observers: list[str]
    with_innovations: list[str]  # those with innovations
    units: dict[str, str]  # of every estimated signal, by its name
    truth: list[str]  # signals whose true values are known
    smoothed: list[str]  # signals of the smoother

    @property
    def scale(self) -> list[str]:
        """Return the observers that set the scale of a figure: those with innovations, if there are any."""
        return self.with_innovations or self.observers

    @property
    def end(self) -> float:
        """Return the time of the last tick [s]."""
        return float(self.summary["ticks"] * self.summary["dt"])


def is_replay(folder: str | Path) -> bool:
    """Return whether a folder is one that `pcbench replay` wrote."""
    return "://" not in str(folder) and (Path(folder) / SUMMARY).is_file()


def open_replay(folder: str | Path) -> Replay:
    """Return a replay's folder; raise UserError if a file of it is missing or damaged."""
    folder = Path(folder)
    try:
        summary = json.loads((folder / SUMMARY).read_text(encoding="utf-8"))
        schema = pq.read_schema(folder / ESTIMATES)
        innovation_names = pq.read_schema(folder / INNOVATIONS).names
        smoothed_signals = pq.read_schema(folder / SMOOTHED).names[1:] if (folder / SMOOTHED).exists() else []
        observers = list(summary["certificates"])
    except (OSError, ValueError, KeyError) as error:
        raise UserError(
            f"{folder}: got a replay that cannot be read ({error}), expected all files of one; write it again with "
            "pcbench replay."
        ) from None
    units = {}
    for observer in observers:
        for name in schema.names:
            if name.startswith(f"{observer}.") and not name.endswith(".sigma"):
                units[name.removeprefix(f"{observer}.")] = schema.field(name).metadata[b"unit"].decode()
    return Replay(
        folder=folder,
        summary=summary,
        observers=observers,
        with_innovations=[o for o in observers if f"{o}.innovation" in innovation_names],
        units=units,
        truth=[name for name in units if name in schema.names],
        smoothed=smoothed_signals,
    )


def parts(file: Path, columns: list[str]) -> Iterator[pd.DataFrame]:
    """Yield columns of a file, a part at a time, with the numbers of its rows as index."""
    first = 0
    with pq.ParquetFile(file) as parquet:
        for i in range(parquet.num_row_groups):
            frame = parquet.read_row_group(i, columns=columns, use_threads=False).to_pandas()
            yield frame.set_index(np.arange(first, first + len(frame)))
            first += len(frame)


def extremes(bins: Floats, values: Floats) -> NDArray[np.intp]:
    """Return the places of the least and of the largest finite value of each bin, in order, without repetitions."""
    finite = np.flatnonzero(np.isfinite(values))
    order = finite[np.lexsort((values[finite], bins[finite]))]
    edges = np.flatnonzero(np.diff(bins[order])) + 1 if len(order) else order
    ends = np.concatenate([[0], edges, edges - 1, [len(order) - 1]]).astype(int) if len(order) else order
    return np.unique(order[ends])


def states(r: Replay, observer: str, signal: str) -> pd.DataFrame:
    """Return the thinned estimate of one observer: t, estimate, sigma (NaN: it has none) and error.

    The error is the true state minus the estimate; where no true state is recorded, the smoothed state minus the estimate.
    """
    smoothed_states = _read_smoothed(r, signal)
    return _thin(r, observer, signal, lambda part: _states(r, part, observer, signal, smoothed_states))


def _thin(r: Replay, observer: str, signal: str, frame: Callable[[pd.DataFrame], pd.DataFrame]) -> pd.DataFrame:
    out = []
    for part in parts(r.folder / ESTIMATES, _columns(r, observer, signal)):
        rows = frame(part)
        bins = np.floor(rows.t.to_numpy() / r.end * BINS)
        places = [extremes(bins, rows[name].to_numpy()) for name in ("estimate", "error", "sigma")]
        out.append(rows.iloc[np.unique(np.concatenate(places))])
    return pd.concat(out, ignore_index=True)


def _columns(r: Replay, observer: str, signal: str) -> list[str]:
    names = pq.read_schema(r.folder / ESTIMATES).names
    candidates = ["t", signal, f"{observer}.{signal}", f"{observer}.{signal}.sigma"]
    return [name for name in candidates if name in names]


def _states(r: Replay, part: pd.DataFrame, observer: str, signal: str, smoothed_states: Floats | None) -> pd.DataFrame:
    unknown = np.full(len(part), np.nan)
    estimate = np.asarray(part.get(f"{observer}.{signal}", unknown))
    best = unknown if smoothed_states is None else smoothed_states[part.index]
    best = part[signal].to_numpy() if signal in r.truth else best
    sigma = part.get(f"{observer}.{signal}.sigma", unknown)
    return pd.DataFrame({"t": part.t, "estimate": estimate, "sigma": sigma, "error": best - estimate})


def _read_smoothed(r: Replay, signal: str) -> Floats | None:
    if signal not in r.smoothed:
        return None
    return pq.read_table(r.folder / SMOOTHED, columns=[signal])[signal].to_numpy()


def excerpt(r: Replay, observer: str, signal: str, low: float, high: float) -> pd.DataFrame:
    """Return every tick of a short time [s]: t, estimate and sigma of one observer, truth and smoothed (NaN: unknown)."""
    smoothed_states, out = _read_smoothed(r, signal), []
    for part in parts(r.folder / ESTIMATES, _columns(r, observer, signal)):
        part = part[part.t.between(low, high)]
        frame = _states(r, part, observer, signal, smoothed_states)
        unknown = np.full(len(part), np.nan)
        frame["truth"] = part[signal] if signal in r.truth else unknown
        frame["smoothed"] = unknown if smoothed_states is None else smoothed_states[part.index]
        out.append(frame)
    return pd.concat(out, ignore_index=True)


def reference(r: Replay, signal: str, kind: str) -> pd.DataFrame:
    """Return the thinned true (kind "truth") or smoothed ("smoothed") states: t, value."""
    smoothed_states, out = _read_smoothed(r, signal), []
    for part in parts(r.folder / ESTIMATES, ["t", *([signal] if kind == "truth" else [])]):
        value = part[signal].to_numpy() if kind == "truth" else np.asarray(smoothed_states)[part.index]
        places = extremes(np.floor(part.t.to_numpy() / r.end * BINS), value)
        out.append(pd.DataFrame({"t": part.t.to_numpy()[places], "value": value[places]}))
    return pd.concat(out, ignore_index=True)


def measured(r: Replay, channel: str, low: float = -np.inf, high: float = np.inf) -> pd.DataFrame:
    """Return the thinned measurements of a channel that were taken in a time [s]: sampled, value."""
    out = []
    for part in parts(r.folder / INNOVATIONS, ["channel", "sampled", "value"]):
        part = part[(part.channel == channel) & part.sampled.between(low, high)]
        span = min(high, r.end) - max(low, 0.0)
        out.append(part.iloc[extremes(np.floor(part.sampled.to_numpy() / span * BINS), part.value.to_numpy())])
    return pd.concat(out, ignore_index=True)


class Innovations(NamedTuple):
    """What the innovations of an observer in one channel show."""

    samples: pd.DataFrame  # arrived, innovation, sigma
    many: int
    outside: float  # share beyond two standard deviations
    autocorrelation: Floats  # at lags 1, 2, ...


def innovations(r: Replay, observer: str, channel: str) -> Innovations:
    """Return the innovations of an observer in one channel."""
    nu, sigma = f"{observer}.innovation", f"{observer}.innovation.sigma"
    sums, out, outside = innovation_tests.Sums(), [], 0
    for part in parts(r.folder / INNOVATIONS, ["channel", "arrived", nu, sigma]):
        part = part[(part.channel == channel) & np.isfinite(part[sigma])]
        z = (part[nu] / part[sigma]).to_numpy()
        sums = innovation_tests.add(sums, np.stack([z**2, np.ones_like(z), 0 * z, z], 1), np.zeros(len(z), bool))
        outside += int((np.abs(z) > Z95).sum())
        bins = np.floor(part.arrived.to_numpy() / r.end * BINS)
        places = np.unique(np.concatenate([extremes(bins, part[name].to_numpy()) for name in (nu, sigma)]))
        out.append(part.iloc[places].rename(columns={nu: "innovation", sigma: "sigma"}).drop(columns="channel"))
    lags, many = min(innovation_tests.LAGS, sums.samples // 5), sums.samples
    r_h = sums.products[1 : lags + 1] / sums.products[0] if lags and sums.products[0] > 0 else np.zeros(0)
    return Innovations(pd.concat(out, ignore_index=True), many, outside / many if many else np.nan, r_h)


def log_likelihood(r: Replay, observer: str) -> pd.DataFrame:
    """Return the mean log-likelihood of a measured value in each of PERIODS parts of time: t (its middle), value."""
    nu, sigma = f"{observer}.innovation", f"{observer}.innovation.sigma"
    sums = np.zeros((2, PERIODS))
    for part in parts(r.folder / INNOVATIONS, ["arrived", nu, sigma]):
        part = part[np.isfinite(part[sigma])]
        log_density = -0.5 * (np.log(2 * np.pi * part[sigma] ** 2) + (part[nu] / part[sigma]) ** 2)
        place = np.minimum((part.arrived.to_numpy() / r.end * PERIODS).astype(int), PERIODS - 1)
        sums += [np.bincount(place, weights, PERIODS) for weights in (log_density, np.ones(len(place)))]
    with np.errstate(invalid="ignore"):
        value = sums[0] / sums[1]
    return pd.DataFrame({"t": (np.arange(PERIODS) + 0.5) * r.end / PERIODS, "value": value})
