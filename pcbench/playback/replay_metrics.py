"""Errors of a replay as tables: against truth by the metrics of a study, and against the smoother that sees the whole log."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from pcbench.planning import digits
from pcbench.playback import output
from pcbench.playback.step_block import Score
from pcbench.simulation import metrics
from pcbench.simulation.metrics import ErrorSums

if TYPE_CHECKING:
    import pandas as pd

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
    for first, table in output.parts(file):
        for o in observers:
            for i, (signal, _) in enumerate(states):
                e = table.column(f"{o}.{signal}").to_numpy() - smoothed[first : first + len(table), i]
                sums[o, signal] += float(e @ e)
        many += len(table)
    units = dict(signals)
    rows = [{"observer": o, "signal": s, "unit": units[s], "rms": np.sqrt(v / many)} for (o, s), v in sums.items()]
    return pd.DataFrame(rows)
