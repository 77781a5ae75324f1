"""Lines: how errors are distributed over runs, how a metric moves with one axis of a study, and one run in time."""

from typing import Any

from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.plots import frames, one_run
from pcbench.plots.palette import MEASURED, PLANT, Style, styles
from pcbench.plots.sheet import dress, legend, sheet, title_of, unit_of
from pcbench.study import scenarios_of


def distributions(
    result: Result,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    cell: int = 0,
) -> Figure:
    """Return the empirical distribution of a metric over runs, a line for each observer; left is better.

    `cell` is the number of the combination of axis values. Diverged runs are left out. Raises UserError for an unknown word.
    """
    part = frames.distribution(result, scenario, signal, metric, cell)
    named = frames.rows(result, scenario, signal, metric)
    figure, ((ax,),) = sheet()
    look = styles(named.observer)
    for observer, mine in part.groupby("observer", sort=False):
        ax.step(mine.value, mine.share, where="post", label=observer, **_line(look[str(observer)]))
    if frames.wide(part.value):
        ax.set_xscale("log")
    dress(ax, title_of(metric, named.signal.iloc[0], unit_of(named)), "share of runs", named.scenario.iloc[0])
    ax.set_ylim(0, 1.02)
    legend(figure, ax)
    return figure


def curves(
    result: Result,
    axis: str | None = None,
    *,
    scenario: str | None = None,
    signal: str | None = None,
    metric: str = frames.METRIC,
    at: dict[str, Any] | None = None,
) -> Figure:
    """Return the mean of a metric over one axis of the study (None: the first that varies), with 95 % intervals.

    The other axes stand at their first value, or where `at` says. Raises UserError where no axis varies, or for a word that is
    none.
    """
    whole = frames.rows(result, scenario, signal, metric)
    axis = axis or next(iter(frames.varying(whole)), None)
    if axis is None or axis not in frames.varying(whole):
        raise UserError(
            f"curves of {whole.scenario.iloc[0]}: got axis {axis!r}, expected one that varies "
            f"({', '.join(frames.varying(whole)) or 'none does'}); give the study an axis with more than one value."
        )
    part = frames.fixed(whole, [axis], at)
    figure, ((ax,),) = sheet()
    look = styles(whole.observer)
    words = not all(isinstance(v, int | float) for v in part[axis])
    for observer, mine in part.groupby("observer", sort=False):
        style = look[str(observer)]
        x = mine[axis].astype(str) if words else mine[axis]
        ax.plot(x, mine["mean"], label=observer, marker=style.marker, markersize=4, **_line(style))
        ax.fill_between(x, mine.ci_low, mine.ci_high, color=style.colour, alpha=0.18, linewidth=0)
    if frames.wide(part["mean"]):
        ax.set_yscale("log")
    dress(ax, frames.label(axis), title_of(metric, whole.signal.iloc[0], unit_of(whole)), whole.scenario.iloc[0])
    legend(figure, ax)
    return figure


def time(result: Result, *, scenario: str | None = None, signal: str | None = None) -> Figure:
    """Return one run in time: the plant, every estimate, and what has arrived and is held.

    It is the study's first seed in the scenario's first cell. In a closed loop each observer has a plant of its own, and the
    target is drawn. Raises UserError for a word that is none.
    """
    scenario = frames.scenario_of(result, scenario)
    signal = frames.signal_of(result, scenario, signal)
    whole = one_run.of(result.study, scenario, result.out)
    if whole is None:
        raise UserError(
            f"plots.time: got no kept run of {scenario} and observers whose code is not here, expected one of the two; "
            "run the study again from its own file."
        )
    part = whole[whole.signal == signal]
    figure, ((ax,),) = sheet()
    look = styles(frames.rows(result, scenario, signal, "mae").observer)
    for (series, kind), mine in part.groupby(["series", "kind"], sort=False):
        name = str(series).removeprefix("plant under ")
        known = look.get(name, Style("#000000", (), "o"))
        if kind == "estimate":
            ax.plot(mine.t, mine.value, label=series, **_line(known))
        elif kind == "measured":
            ax.step(mine.t, mine.value, where="post", label="measured, held", color=MEASURED, linewidth=1.0, zorder=1)
        elif kind == "target":
            ax.plot(mine.t, mine.value, label="target", color="#BBBBBB", linewidth=2.5, zorder=1)
        else:
            ax.plot(
                mine.t,
                mine.value,
                label=series,
                color=PLANT if series == "plant" else known.colour,
                linewidth=4,
                alpha=0.45,
            )
    unit = dict(signals_of(scenarios_of(result.study)[scenario]))[signal]
    dress(ax, "t [s]", f"{signal.replace('_', ' ')} [{unit}]", f"{scenario}, seed {result.study.first_seed}")
    ax.set_ylim(*frames.room(part))
    legend(figure, ax)
    return figure


def _line(style: Style) -> dict[str, Any]:
    return {"color": style.colour, "linewidth": 1.4, "linestyle": (0, style.dash) if style.dash else "solid"}
