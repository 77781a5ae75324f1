"""One self-contained page from a replay's folder: innovation tests, likelihood, states with bands, innovations by channel.

Without a true state it shows whether an observer predicts its measurements as well as its covariance says.
"""

import re
from collections.abc import Iterator
from typing import Any, NamedTuple

from pcbench.errors import unknown
from pcbench.observers import acronyms
from pcbench.plots import replay_frames, replays
from pcbench.plots.layout import PAPER, Paper, number
from pcbench.plots.palette import styles
from pcbench.plots.replay_frames import Replay
from pcbench.report import captions
from pcbench.report import page as study_page
from pcbench.report.captions import number as short
from pcbench.report.figures import FigureOptions, Picture, put_figures

PLAIN = re.compile(r"[\w-]+")  # names that a file may have
THINNED = f"Lines and dots are the extremes of {replay_frames.BINS} equal parts of the time. Values beyond an axis are cut off."
BANDS = "Bands contain 95 % of the values if the observer's covariance is true."
MEANING = {
    "innovation": "a measurement minus its prediction, given all measurements that arrived before",
    "NIS": "normalised innovation squared, divided by its degrees of freedom: 1 is expected. Above its 95 % band the observer "
    "is optimistic, below it pessimistic",
    "ljung_box_p": "p-value of the Ljung-Box test: a small value means that successive innovations are correlated, so the "
    "model, a delay or the noise is wrong",
    "log-likelihood": "of a measured value given all that arrived before. Larger is better",
    "held out": "the last 30 % of the ticks, which tuning does not use in its first fit",
    "smoothed": "the estimate from the whole recording, with the noise of the plant file and the delays of the recording",
    "steady_start": "the time from which errors and distances are taken, after the initial transient",
}


class Table(NamedTuple):
    """A table of texts."""

    title: str
    heads: list[str]
    rows: list[list[str]]
    note: str


class Section(NamedTuple):
    """A part of the page."""

    anchor: str
    title: str
    tables: list[Table]
    pictures: list[Picture]


def page(r: Replay, signals: list[str] | None = None) -> str:
    """Return the page's HTML, with some signals (None or empty: all); raise UserError for an unknown one."""
    recording, parts = r.summary, []
    for section in sections(r, signals, PAPER):
        pictures = [study_page.inline_picture(p) for p in section.pictures]
        parts.append(section._asdict() | {"pictures": pictures})
    seconds = f"{recording['rows']:,} measurements, {short(r.end)} s in ticks of {recording['dt']:g} s"
    observers = f"{len(r.observers)} observer{'s' * (len(r.observers) > 1)}"
    return study_page.render(
        "replay.html",
        title=f"Replay of {recording['log']}",
        description=f"{observers} ({', '.join(r.observers)}) with the plant {recording['plant']}: {seconds}.",
        remarks=recording["notes"],
        sections=parts,
        colours={observer: style.colour for observer, style in styles(r.observers).items()},
        meaning=[*acronyms(r.observers).items(), *MEANING.items()],
    )


def sections(r: Replay, signals: list[str] | None, paper: Paper) -> Iterator[Section]:
    """Yield the parts of the page with their figures, drawn on `paper`; arguments are those of `page`."""
    for name in signals or ():
        if name not in r.units:
            raise unknown("--signal", "signal of the replay", name, r.units)
    if r.with_innovations:
        picture = [_likelihood(r, paper)] if r.summary["rows"] else []
        yield Section("innovations", "Innovation tests", _tests(r), picture)
    names = [name for name in r.units if not signals or name in signals]
    yield Section("states", "States", _errors(r, names), [_states(r, name, paper) for name in names])
    for i, channel in enumerate(row["channel"] for row in r.summary["outputs"]):
        stats = {o: s for o in r.with_innovations if (s := replay_frames.innovations(r, o, channel)).many}
        if stats:
            name = channel if PLAIN.fullmatch(channel) else str(i)
            yield Section(f"channel-{name}", f"Channel {channel}", [], list(_channel(r, channel, name, stats, paper)))


def _tests(r: Replay) -> list[Table]:
    """Return the innovation tests of all measurements and, of several channels, of each."""
    heads = ["NIS", "95 % band", "verdict", "ljung_box_p"]

    def texts(row: dict[str, Any]) -> list[str]:
        band = f"{_text(row['nis_low'])} to {_text(row['nis_high'])}"
        return [_text(row["nis"]), band, str(row["verdict"]), _text(row["ljung_box_p"])]

    rows = [
        [
            row["observer"],
            f"{row['samples']:,}",
            *texts(row),
            *(_text(row[f"log_likelihood{end}"]) for end in ("", "_held_out")),
        ]
        for row in r.summary["innovations"]
    ]
    ends = ["log-likelihood per value", "log-likelihood, held out"]
    note = "No result shows that an estimate is right in states that are not measured."
    out = [Table("All measurements", ["observer", "measurements", *heads, *ends], rows, note)]
    if len(r.summary["outputs"]) > 1:
        rows = [
            [row["observer"], row["channel"], f"{row['samples']:,}", f"{row['skipped']:,}", *texts(row)]
            for row in r.summary["channels"]
        ]
        out.append(Table("By channel", ["observer", "channel", "measurements", "not judged", *heads], rows, ""))
    return out


def _errors(r: Replay, signals: list[str]) -> list[Table]:
    """Return the errors against the true states, and the distances to the smoother."""
    out = []
    steady_note = f"From {r.summary['steady_start']:g} s on (steady_start)."
    true = [row for row in r.summary["metrics"] if row["metric"] == "steady_rmse"]
    caution = "Compare distances only between observers with the same assumptions, such as delays and noise."
    for title, rows, key, note in (
        ("steady_rmse: rms error against the true states", true, "value", steady_note),
        ("rms distance to the smoothed states", r.summary["distances"], "rms", f"{steady_note} {caution}"),
    ):
        values = {(row["observer"], row["signal"]): row[key] for row in rows if row["signal"] in signals}
        columns = list(dict.fromkeys(signal for _, signal in values))
        if columns:
            lines = [[o, *(_text(values.get((o, signal))) for signal in columns)] for o in r.observers]
            out.append(
                Table(title, ["observer", *(f"{s.replace('_', ' ')} [{r.units[s]}]" for s in columns)], lines, note)
            )
    return out


def _text(value: float | None) -> str:
    return "-" if value is None else short(value)


def _likelihood(r: Replay, paper: Paper) -> Picture:
    rows = [f"{row['observer']} {_text(row['log_likelihood_held_out'])}" for row in r.summary["innovations"]]
    return Picture(
        name="likelihood",
        title="Log-likelihood over time",
        figure=replays.log_likelihood(r, r.with_innovations, paper),
        text=f"Mean over the held-out part: {', '.join(rows)}.",
        note=f"Means over {replay_frames.PERIODS} equal parts of the time. Larger is better; where it falls, measurements are "
        "far from their predictions.",
    )


def _states(r: Replay, signal: str, paper: Paper) -> Picture:
    reference = "true states" if signal in r.truth else "smoothed states" if signal in r.smoothed else ""
    low, high = replays.excerpt_of(r)
    text = f"{signal.replace('_', ' ')} as estimated by {', '.join(r.observers)}, over all {number(r.end)} s and from "
    text += replays.span(low, high) + (f", and its difference from the {reference}." if reference else ".")
    figure = replays.states(r, signal, paper)
    note = f"{BANDS} {THINNED}" if any("band" in key for key in captions.keys_of(figure)) else THINNED
    return Picture(f"state-{signal}", signal.replace("_", " "), figure, text, note)


def _channel(
    r: Replay, channel: str, name: str, stats: dict[str, replay_frames.Innovations], paper: Paper
) -> Iterator[Picture]:
    """Yield the figures of a channel; `name` is its name in those of files."""
    texts = [f"{o} {short(100 * s.outside)} % of {s.many:,}" for o, s in stats.items()]
    yield Picture(
        name=f"innovations-{name}",
        title="Innovations over time",
        figure=replays.innovations(r, channel, stats, paper),
        text=f"Outside the band: {', '.join(texts)}.",
        note=f"5 % are expected outside. {THINNED}",
    )
    if any(len(s.autocorrelation) for s in stats.values()):
        band = {o: replays.Z95 / s.many**0.5 for o, s in stats.items()}
        texts = [
            f"{o} {int((abs(s.autocorrelation) > band[o]).sum())} of {len(s.autocorrelation)} lags"
            for o, s in stats.items()
        ]
        yield Picture(
            name=f"autocorrelation-{name}",
            title="Autocorrelation of the innovations",
            figure=replays.autocorrelation(r, stats, paper),
            text=f"Outside the band: {', '.join(texts)}.",
            note="White innovations have 5 % of the lags outside.",
        )


def write_figures(folder: str, out: str, options: FigureOptions, formats: tuple[str, ...]) -> list[str]:
    """Write every figure of a replay's page, and return the names of the files, without their suffix."""
    r = replay_frames.open_replay(folder)
    return put_figures((p for s in sections(r, options.signals, options.paper) for p in s.pictures), out, formats)
