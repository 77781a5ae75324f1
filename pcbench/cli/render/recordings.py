"""Tables and sentences for `info`, `replay` and `export`."""

import math
from collections.abc import Hashable, Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING, Any

import pandas as pd

from pcbench import fields
from pcbench.cli.render.tables import Column, Screen, format_number
from pcbench.recordings.survey import describe_held
from pcbench.statistics import Z95
from pcbench.statistics.number_format import estimate

if TYPE_CHECKING:
    from pcbench.playback.replay import ReplayResult

MILLI = 1e3
ROUNDING = 1e-9  # smaller numbers are rounding
Row = Mapping[Hashable, Any]  # of a frame, by column
Rows = Sequence[Row]


def channels(table: pd.DataFrame, screen: Screen) -> None:
    """Print the survey of a recording."""
    rows = table.to_dict("records")
    ends = ["{} to {}".format(*(_number(row[k], MILLI) for k in ("delay_p05", "delay_p95"))) for row in rows]
    columns = [
        Column("channel", [row["channel"] for row in rows], is_text=True),
        _count("samples", rows),
        _count("lost", rows),
        Column("rate\n[1/s]", [_number(row["rate"]) for row in rows]),
        Column("delay [ms]\nmedian", [_number(row["delay_median"], MILLI) for row in rows]),
        Column("\n5 to 95 %", ends),
        Column("\nlargest", [_number(row["delay_most"], MILLI) for row in rows]),
        Column("skew\n[ppm]", [_number(row["drift_ppm"]) for row in rows], spare=1),
    ]
    screen.fit(str(table.attrs["name"]), columns)
    for row in rows:
        skew, se = row["drift_ppm"], row["drift_ppm_se"]
        if skew is not None and se is not None and abs(skew) > ROUNDING:
            interval = estimate(skew, skew - Z95 * se, skew + Z95 * se)
            explanation = "±: half a 95 % interval, for independent delays"
            screen.say(f"{row['channel']}: clock skew {interval} ppm ({explanation}).")
        screen.say(*(f"{row['channel']}: {sentence}." for sentence in describe_irregularities(row)))
    screen.say(*describe_held(table.attrs["survey"]))
    for lag in table.attrs["lags"]:
        screen.say(
            f"{lag.second} is {lag.lag:.4g} s later than {lag.first} (95 % interval {lag.low:.4g} to {lag.high:.4g} s, "
            f"correlation of their rates {lag.correlation:.2f})."
        )


def print_contents(name: str, rows: Sequence[Mapping[str, Any]], problems: Sequence[str], screen: Screen) -> None:
    """Print the contents of a file: one table per topic, one row per field."""
    for _, group in groupby(rows, key=lambda row: (row["topic"], row["frame"])):
        topic_rows = list(group)
        first = topic_rows[0]
        where = " ".join(filter(None, [name, first["topic"], first["frame"], f"({first['kind']}),"]))
        start, end = first["first"], first["last"]
        span = "" if math.isnan(start) else f", {end - start:.6g} s from {start:.10g} s"
        notes = [
            "constant" if row["constant"] else f"{row['repeats']} repeated" if row["repeats"] else ""
            for row in topic_rows
        ]
        columns = [
            Column("field", [row["field"] for row in topic_rows], is_text=True),
            Column("values", [f"{row['rows'] - row['missing']:,}" for row in topic_rows]),
            Column("rate\n[1/s]", [_number(row["rate"]) for row in topic_rows]),
            Column("least", [format_number(row["least"], ".6g") for row in topic_rows]),
            Column("most", [format_number(row["most"], ".6g") for row in topic_rows]),
            Column("note", notes, is_text=True),
        ]
        title = f"{where} {first['rows']:,} rows{span}"
        screen.fit(title, columns) if first["field"] else screen.say(f"{title}: no field of numbers")
    screen.say(*problems, f"A TOML file to start from: pcbench info {name} --toml --out start.toml")


def describe_irregularities(row: Row) -> list[str]:
    """Return sentences about gaps, order, repetitions and jumps of a channel."""

    def count(key: str, word: str) -> str:
        return f"{row[key]:,} {word}{'' if row[key] == 1 else 's'}"

    def at(key: str) -> str:
        return f"row {int(row[f'{key}_row'])}"

    out = []
    if row["gaps"]:
        longest = f"the longest {row['longest_gap']:.4g} s before {at('longest_gap')}"
        out.append(f"{count('gaps', 'gap')} of more than five intervals, {longest}")
    if row["out_of_order"]:
        first = f"the first in {at('out_of_order')}"
        out.append(f"{count('out_of_order', 'out-of-sequence sample')}, {first}")
    if row["doubled"]:
        out.append(f"{count('doubled', 'repeated timestamp')}, the first in {at('doubled')}")
    if row["jumps"]:
        largest = f"by up to {row['largest_jump']:.4g} s in {at('largest_jump')}"
        out.append(f"the delay jumps {count('jumps', 'time')}, {largest}")
    return out


def print_replay(result: "ReplayResult", folder: str, screen: Screen) -> None:
    """Print the innovation tests and errors of observers on a recording."""
    summary = result.summary
    if len(result.innovations):
        rows = result.innovations.to_dict("records")
        axes = [Column(_with_unit(name), [f"{row[name]}" for row in rows]) for name in summary.get("axes", [])]
        tests = _innovation_columns(rows)
        columns = [
            *axes,
            Column("observer", [row["observer"] for row in rows], is_text=True),
            _count("samples", rows),
            *(tests[:1] if axes else tests),
            Column("log-likelihood\nper value", [_number(row["log_likelihood"]) for row in rows]),
            Column("\nheld out", [_number(row["log_likelihood_held_out"]) for row in rows]),
        ]
        screen.fit(f"{summary['log']}: measurements compared with their predictions", columns)
        if axes:
            screen.say(f"Also per channel: {folder}/replay.json")
            return
    if len(result.channels) and (result.channels.channel.nunique() > 1 or result.channels.skipped.any()):
        rows = result.channels.to_dict("records")
        columns = [Column(name, [row[name] for row in rows], is_text=True) for name in ("observer", "channel")]
        screen.fit(
            "the same per channel",
            [*columns, _count("samples", rows), _count("skipped", rows), *_innovation_columns(rows)],
        )
    if len(result.metrics):
        _by_signal(
            result.metrics[result.metrics.metric == "steady_rmse"],
            "value",
            "steady_rmse against the true states",
            screen,
        )
    if len(result.distances):
        title = f"rms distance to the smoother from {summary['steady_start']:g} s on (steady_start)"
        _by_signal(result.distances, "rms", title, screen)
        screen.say("Compare distances only between observers with the same assumptions, such as delays and noise.")
    tables = (result.innovations, result.metrics, result.distances)
    screen.explain_acronyms(str(name) for table in tables if len(table) for name in table.observer)
    rounding, ticks = summary["largest_rounding"], summary["ticks"] + 1
    screen.say(
        f"{ticks:,} ticks of {summary['dt']:g} s; times are rounded by up to {rounding:.3g} s.",
        f"Estimates tick by tick: {folder}/estimates.parquet. Draw them: pcbench report {folder}",
    )


def _with_unit(axis: str) -> str:
    """Return the name of an axis with its unit, in two lines."""
    unit = next((field.unit for field in fields.FIELDS if field.name == axis), "")
    return f"{axis}\n[{unit}]" if unit not in ("", "1") else axis


def _innovation_columns(rows: Rows) -> list[Column]:
    """Return the columns of the innovation tests."""
    bands = [f"{row['nis_low']:.3f} to {row['nis_high']:.3f}" if row["samples"] else "-" for row in rows]
    return [
        Column("NIS", [_number(row["nis"]) for row in rows]),
        Column("95 % band", bands),
        Column("verdict", [row["verdict"] for row in rows], is_text=True),
        Column("ljung_box_p", [_number(row["ljung_box_p"]) for row in rows]),
    ]


def _by_signal(table: pd.DataFrame, value: str, title: str, screen: Screen) -> None:
    """Print one row per observer and one column per signal."""
    pivot = table.pivot(index="observer", columns="signal", values=value)
    columns = [Column("observer", list(pivot.index), is_text=True)]
    for signal, unit in dict(zip(table.signal, table.unit, strict=True)).items():
        columns.append(Column(f"{signal}\n[{unit}]", [_number(float(v)) for v in pivot[signal].to_numpy(float)]))
    screen.fit(title, columns)


def _count(name: str, rows: Rows) -> Column:
    return Column(name.replace("_", " "), [f"{row[name]:,}" for row in rows])


def _number(value: float | None, scale: float = 1.0) -> str:
    if value is not None and abs(value) <= ROUNDING:
        return "0"
    return format_number(None if value is None else value * scale)


def export_table(result: Any, double: dict[str, Any], single: dict[str, Any], source: str, screen: Screen) -> None:
    """Print the differences between C and a simulation, or the replay of a recording (`source`), in both precisions."""
    facts = result.about
    names = [name for name, _ in facts.signals if name in double]
    columns = [
        Column("signal", [f"{name} [{unit}]" for name, unit in facts.signals if name in double], is_text=True),
        Column("double:\nlargest diff.", [f"{double[name].most:.2g}" for name in names]),
        Column("rms error", [f"{double[name].error:.6g}" for name in names]),
        Column("float:\nrms diff.", [f"{single[name].differs:.2g}" for name in names]),
        Column("largest diff.", [f"{single[name].most:.2g}" for name in names], spare=1),
        Column("rms error", [f"{single[name].error:.6g}" for name in names]),
    ]
    if all(math.isnan(e.error) for e in (*double.values(), *single.values())):  # a recording without truth
        columns = [column for column in columns if column.head != "rms error"]
    newer = f"at most {facts.newer}" if facts.newer else "no"
    oldest = (
        f"oldest admissible age: {facts.oldest} ticks ({facts.oldest * facts.dt:g} s), if {newer} newer measurement"
    )
    oldest += f"{'s' * (facts.newer > 1)} arrived before it"
    screen.fit(f"{facts.observer} of {facts.scenario} in C, on {source}; {oldest}", columns)
