"""What a person reads of recorded data: a row a channel, and what observers made of it.

What comes of compiling an exported observer, as a table.
"""

import math
from typing import Any

import pandas as pd
from rich.console import Console

from pcbench.cli.render.tables import Column, printed
from pcbench.statistics import Z95
from pcbench.statistics.number_format import estimate

MILLI = 1e3
NOTHING = 1e-9  # what is less is rounding


def channels(table: pd.DataFrame, console: Console) -> None:
    """Print what is in a log."""
    rows = table.to_dict("records")
    columns = [
        Column("channel", [row["channel"] for row in rows], left=True),
        Column("samples", [f"{row['samples']:,}" for row in rows]),
        Column("lost", [f"{row['lost']:,}" for row in rows]),
        Column("rate\n[1/s]", [_plain(row["rate"]) for row in rows]),
        Column("delay [ms]\nmedian", [_plain(row["delay_median"], MILLI) for row in rows]),
        Column("\n5 to 95 %", [_range(row) for row in rows]),
        Column("\nlargest", [_plain(row["delay_most"], MILLI) for row in rows]),
        Column("drift\n[ppm]", [_plain(row["drift_ppm"]) for row in rows], spare=1),
    ]
    printed(str(table.attrs["name"]), columns, console)
    for row in rows:
        for sentence in [*_drift(row["drift_ppm"], row["drift_ppm_se"]), *odd(row)]:
            _print(f"{row['channel']}: {sentence}.", console)


def odd(row: dict[Any, Any]) -> list[str]:
    """Return what is odd about a channel, in words."""
    out = []
    if row["gaps"]:
        length, where = row["longest_gap"], int(row["longest_gap_row"])
        out.append(
            f"{_many(row['gaps'], 'gap')} of more than five intervals, the longest {length:.4g} s before row {where}"
        )
    if row["out_of_order"]:
        stand = "stands" if row["out_of_order"] == 1 else "stand"
        where = int(row["out_of_order_row"])
        out.append(
            f"{_many(row['out_of_order'], 'sample')} {stand} behind one with a later stamp, the first in row {where}"
        )
    if row["doubled"]:
        stand = "stands" if row["doubled"] == 1 else "stand"
        out.append(f"{_many(row['doubled'], 'stamp')} {stand} there twice, the first in row {int(row['doubled_row'])}")
    if row["jumps"]:
        size, where = row["largest_jump"], int(row["largest_jump_row"])
        out.append(f"the delay jumps {_many(row['jumps'], 'time')}, by up to {size:.4g} s in row {where}")
    return out


def _drift(slope: float | None, se: float | None) -> list[str]:
    """Return how well the drift is known, where there is one."""
    if slope is None or se is None or not abs(slope) > NOTHING:
        return []
    known = estimate(slope, slope - Z95 * se, slope + Z95 * se)
    return [f"drift {known} ppm (half a 95 % interval, if delays do not depend on one another)"]


def _many(number: int, word: str) -> str:
    return f"{number:,} {word}{'' if number == 1 else 's'}"


def replayed(found: Any, folder: str, console: Console) -> None:
    """Print what is known of observers on a log."""
    if len(found.innovations):
        rows = found.innovations.to_dict("records")
        columns = [
            Column("observer", [row["observer"] for row in rows], left=True),
            Column("samples", [f"{row['samples']:,}" for row in rows]),
            *_judged(rows),
            Column("log-likelihood\nof a number", [_plain(row["log_likelihood"]) for row in rows]),
            Column("\nheld out", [_plain(row["log_likelihood_held_out"]) for row in rows]),
        ]
        printed(f"{found.summary['log']}: what arrived against what was expected of it", columns, console)
    if len(found.channels) and (found.channels.channel.nunique() > 1 or found.channels.not_judged.any()):
        rows = found.channels.to_dict("records")
        columns = [
            Column("observer", [row["observer"] for row in rows], left=True),
            Column("channel", [row["channel"] for row in rows], left=True),
            Column("samples", [f"{row['samples']:,}" for row in rows]),
            Column("not judged", [f"{row['not_judged']:,}" for row in rows]),
            *_judged(rows),
        ]
        printed("the same by channel", columns, console)
    if len(found.metrics):
        _wide(found.metrics[found.metrics.metric == "steady_rmse"], "value", "steady_rmse against truth", console)
    if len(found.distances):
        _wide(found.distances, "rms", "rms distance to the smoother that sees the whole log", console)
    off = found.summary["largest_rounding"]
    _print(
        f"{found.summary['ticks'] + 1:,} ticks of {found.summary['dt']:g} s, times rounded by up to {off:.3g} s.",
        console,
    )
    _print(f"Estimates tick by tick: {folder}/estimates.parquet", console)


def _judged(rows: list[dict[Any, Any]]) -> list[Column]:
    """Return the columns of what innovations say."""
    return [
        Column("NIS", [_plain(row["nis"]) for row in rows]),
        Column("95 % if right", [_band(row) for row in rows]),
        Column("verdict", [row["verdict"] for row in rows], left=True),
        Column("p white", [_plain(row["p_white"]) for row in rows]),
    ]


def _band(row: dict[Any, Any]) -> str:
    return f"{row['nis_low']:.3f} to {row['nis_high']:.3f}" if row["samples"] else "-"


def _wide(table: pd.DataFrame, value: str, title: str, console: Console) -> None:
    """Print a row an observer, a column a signal."""
    signals = dict(zip(table.signal, table.unit, strict=True))
    wide = table.pivot(index="observer", columns="signal", values=value)
    columns = [Column("observer", list(wide.index), left=True)]
    columns += [Column(f"{s}\n[{unit}]", [_plain(v) for v in wide[s]]) for s, unit in signals.items()]
    printed(title, columns, console)


def _range(row: dict[Any, Any]) -> str:
    return f"{_plain(row['delay_p05'], MILLI)} to {_plain(row['delay_p95'], MILLI)}"


def _plain(value: Any, scale: float = 1.0) -> str:
    if value is None or value != value:
        return "-"
    return f"{value * scale:.4g}" if abs(value) > NOTHING else "0"


def _print(text: str, console: Console) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)


def table(found: Any, double: dict[str, Any], single: dict[str, Any], of: str, console: Console) -> None:
    """Print how far C is from a simulation or the replay `of` a recording, in both precisions, and its errors."""
    about = found.about
    signals = [(name, unit) for name, unit in about.signals if name in double]
    columns = [
        Column("signal", [f"{name} [{unit}]" for name, unit in signals], left=True),
        Column("double:\nat most off", [f"{double[name].most:.2g}" for name, _ in signals]),
        Column("rms error", [f"{double[name].error:.6g}" for name, _ in signals]),
        Column("float:\nrms off", [f"{single[name].differs:.2g}" for name, _ in signals]),
        Column("at most off", [f"{single[name].most:.2g}" for name, _ in signals], spare=1),
        Column("rms error", [f"{single[name].error:.6g}" for name, _ in signals]),
    ]
    if all(math.isnan(each.error) for each in (*double.values(), *single.values())):  # of a recording without the truth
        columns = [column for column in columns if column.head != "rms error"]
    oldest = f"oldest admissible age: {about.oldest} ticks ({about.oldest * about.dt:g} s)"
    newer = f"at most {about.newer}" if about.newer else "no"
    oldest += f", if {newer} newer measurement{'s' * (about.newer > 1)} arrived before it"
    printed(f"{about.observer} of {about.scenario} in C, on {of}; {oldest}", columns, console)
