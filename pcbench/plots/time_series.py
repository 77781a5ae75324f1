"""One run in time: the plant with the estimates on it, and under it their errors with what of them is luck."""

from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.plots import frames, layout, one_run
from pcbench.plots.labels import title_of_scenario
from pcbench.plots.layout import PAPER, Key, Panel, Paper, drawn_on, sheet
from pcbench.plots.lines import keys_of, line
from pcbench.plots.palette import MEASURED, PLANT, SOFT, Style, pale
from pcbench.study import scenarios_of

ROOM = 0.35  # of the plant's range, above and below it: an estimate that goes farther leaves the picture
BANDS = 5  # observers, up to which bands are told apart
STEADY = 0.5  # of the run: how large errors are in its second half says whether they need a logarithmic axis
DEPTH = 1e-6  # of the largest error: what is smaller lies at the lower edge
RUNAWAY = 30.0  # times the plant's range: errors beyond leave the picture
NINE = 1.6448536269514722  # standard deviations on both sides of the mean, within which nine in ten lie
TRUTH = Key("plant", Style(pale(PLANT, 0.68), (), ""), width=3.2)
HELD = Key("measured, held", Style(MEASURED, (), ""), width=1.0)
TARGET = Key("target", Style(SOFT, (1.0, 1.6), ""), width=1.2)


def time(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    cell: int = 0,
    seed: int | None = None,
    paper: Paper = PAPER,
) -> Figure:
    """Return one run in time: above the plant, the estimates and what has arrived and is held; below the errors.

    `cell` is the number of the combination of axis values, `seed` the run (None: the study's first). Errors of one size stand
    as they are, with the band in which nine in ten errors of several runs lie; errors that span decades as their root mean
    square over these runs, or their size where runs are alike, on a logarithmic axis. In a closed loop each observer has a
    plant of its own, and the target is drawn. Raises UserError for a word, a cell or a seed that is none.
    """
    scenario = frames.scenario_of(result, scenario)
    signal = frames.signal_of(result, scenario, signal)
    seed = result.study.first_seed if seed is None else seed
    whole = one_run.of(result.study, scenario, result.out, cell, seed)
    if whole is None:
        raise UserError(
            f"plots.time: got no kept run of {scenario} and observers whose code is not here, expected one of the two; "
            "run the study again from its own file."
        )
    return drawn(result, whole, scenario, signal, cell, seed, paper)


def drawn(
    result: Result, whole: pd.DataFrame, scenario: str, signal: str, cell: int, seed: int, paper: Paper
) -> Figure:
    """Draw one signal of a run that is at hand, a frame of `one_run.of`."""
    part = _with_exact(whole[whole.signal == signal], result, scenario, cell)
    named = frames.rows(result, scenario, signal, "mae")
    unit = dict(signals_of(scenarios_of(result.study)[scenario]))[signal]
    known = set(part.series)
    keys = [key for key in keys_of(dict.fromkeys(named.observer)) if key.label in known]
    word = f"{signal.replace('_', ' ')} [{unit}]"
    t = layout.linear(0.0, float(part.t.max()))
    upper = Panel(t, _range(part), "", word)
    lower, log = _errors_range(part)
    title = _size(part, unit, exactly(result, scenario, cell)) if log else f"error (true less estimated) [{unit}]"
    others = [TRUTH, *([HELD] if "measured" in known else []), *([TARGET] if "target" in known else [])]
    said = [
        title_of_scenario(result, scenario),
        *(frames.said(a, v) for a, v in frames.values_at(named, cell).items()),
        f"seed {seed}",
    ]
    figure, (ax, below) = sheet(paper, ", ".join(said), [upper, Panel(t, lower, "t [s]", title)], [*keys, *others])
    with drawn_on(paper):
        _states(ax, part, keys)
        _errors(below, part, keys, log)
    return figure


def exactly(result: Result, scenario: str, cell: int) -> frozenset[str]:
    """Return the observers whose errors over time are known exactly in a cell."""
    known = result.moments_of(scenario, cell) if result.exact else pd.DataFrame()
    return frozenset() if known.empty else frozenset(known.observer)


def over(observers: frozenset[str], exact: frozenset[str]) -> str:
    """Return over what the errors of these observers are taken at a time, some of them exactly."""
    several = f"{one_run.RUNS} runs"
    return "all noise" if observers <= exact else several if not observers & exact else f"all noise, or {several}"


def _with_exact(part: pd.DataFrame, result: Result, scenario: str, cell: int) -> pd.DataFrame:
    """Return a run with the bands and sizes of its errors as they are exactly, of observers whose moments are known."""
    if not result.exact:
        return part
    known = result.moments_of(scenario, cell)
    if known.empty:
        return part
    known = known[known.signal == part.signal.iloc[0]]
    known = known[known.observer.isin(set(part.series))]
    mine = part.series.isin(set(known.observer))
    kept, there = part[~(mine & part.kind.isin(["low", "high", "rms"]))], set(part.kind)
    made = {"low": known["mean"] - NINE * known["std"], "high": known["mean"] + NINE * known["std"]}
    made["rms"] = np.hypot(known["mean"], known["std"])
    rows = [
        pd.DataFrame({"t": known.t, "series": known.observer, "kind": kind, "value": value}).assign(
            signal=part.signal.iloc[0]
        )
        for kind, value in made.items()
        if kind in there
    ]
    return pd.concat([kept, *rows], ignore_index=True)


def _states(ax: Any, part: pd.DataFrame, keys: list[Key]) -> None:
    look, (low, high) = {key.label: key for key in keys}, ax.get_ylim()
    for (series, kind), mine in part.groupby(["series", "kind"], sort=False):
        if kind == "truth":
            own = look.get(str(series).removeprefix("plant under "))
            colour = pale(own.style.colour, 0.68) if own else TRUTH.style.colour
            ax.plot(mine.t, mine.value, color=colour, linewidth=TRUTH.width, label=series, zorder=1.6)
        elif kind == "measured":
            ax.step(mine.t, mine.value, where="post", color=MEASURED, linewidth=1.0, zorder=1.5, label=HELD.label)
        elif kind == "target":
            ax.plot(mine.t, mine.value, zorder=1.5, label="target", **line(TARGET))
        elif kind == "estimate":
            near = mine.value.where(mine.value.between(low - (high - low), high + (high - low)))
            ax.plot(mine.t, near, label=series, **line(look[str(series)]))


def _errors(ax: Any, part: pd.DataFrame, keys: list[Key], log: bool) -> None:
    """Errors of every observer: with their band, or on a logarithmic axis as their size."""
    floor = ax.get_ylim()[0]
    for key in keys:
        mine = dict(iter(part[part.series == key.label].groupby("kind")))
        if log:
            rows = mine.get("rms", mine["error"])
            ax.plot(rows.t, np.maximum(np.abs(rows.value), floor), label=key.label, **line(key))
            _envelope(ax, mine, key, (1,), floor)
            continue
        _envelope(ax, mine, key, (-3, 3))
        if "low" in mine and len(keys) <= BANDS:
            ax.fill_between(mine["low"].t, mine["low"].value, mine["high"].value, color=key.style.colour, alpha=0.14,
                            linewidth=0)  # fmt: skip
        ax.plot(mine["error"].t, mine["error"].value, label=key.label, **line(key))
    if not log:
        ax.axhline(0, color=SOFT, linewidth=0.6, zorder=1)


def _envelope(
    ax: Any, mine: dict[Any, pd.DataFrame], key: Key, sigmas: tuple[int, ...], floor: float = -np.inf
) -> None:
    """Draw so many of the standard deviations that an observer believes, as thin lines."""
    for k in sigmas if "sigma" in mine else ():
        rows = mine["sigma"]
        ax.plot(rows.t, np.maximum(k * rows.value, floor), color=key.style.colour, linewidth=0.6, alpha=0.8, zorder=1.4)


def _size(part: pd.DataFrame, unit: str, exact: frozenset[str]) -> str:
    """What a logarithmic axis of errors shows."""
    of = frozenset(part.series[part.kind == "rms"])
    return (f"rms error over {over(of, exact)}" if of else "|error|") + f" [{unit}]"


def _range(part: pd.DataFrame) -> layout.Scale:
    """The axis of the plant and its target, with room; what runs away leaves the picture."""
    mine = part.value[part.kind.isin(["truth", "target"]) & np.isfinite(part.value)]
    low, high = float(mine.min()), float(mine.max())
    near = part.value[(part.kind == "estimate") & np.isfinite(part.value)]
    room = ROOM * (high - low) if high > low else 0.5 * abs(high) or 1.0
    low, high = (
        (max(low - room, min(low, near.min())), min(high + room, max(high, near.max()))) if len(near) else (low, high)
    )
    room = 0.05 * (high - low) or room
    return layout.linear(low - room, high + room)


def _errors_range(part: pd.DataFrame) -> tuple[layout.Scale, bool]:
    """The axis of errors, and whether it is logarithmic: where their sizes span decades."""
    errors = part[part.kind == "error"]
    size = part[part.kind == "rms"] if (part.kind == "rms").any() else errors
    true = part.value[part.kind.isin(["truth", "target"]) & np.isfinite(part.value)]
    start = errors[errors.t == 0].value.abs().max()
    most = RUNAWAY * max(true.max() - true.min(), start if np.isfinite(start) else 0.0)
    value = size.value.abs()
    value = value[np.isfinite(value) & ((value <= most) | (most == 0))]
    if not len(value) or not value.max():
        return layout.linear(-1.0, 1.0), False
    later = size[size.t >= STEADY * size.t.max()].groupby("series").value
    steady = later.apply(
        lambda v: float(np.sqrt(np.nanmean(np.square(v[np.isfinite(v)]))) if np.isfinite(v).any() else np.nan)
    )
    if value.max() > layout.WIDE * np.nanmin(steady):
        inside = value[value > 0]
        return layout.of(inside.clip(lower=DEPTH * inside.max()), log=True), True
    shown = part[part.kind.isin(["error", "low", "high"])].value
    believed = 3 * part.value[(part.kind == "sigma") & (part.t >= STEADY * part.t.max())]
    shown = pd.concat([shown, believed, -believed])
    shown = shown[np.isfinite(shown) & ((shown.abs() <= most) | (most == 0))]
    return layout.of([*shown, 0.0]), False
