"""Captions of the figures, also as their text for readers who cannot see them.

For each curve: the largest value of its axis at which each observer's error is significantly below a limit. Only values of the
study are considered; `pcbench find-limit` finds values between them.
"""

from collections.abc import Iterable
from math import isfinite
from typing import cast

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pcbench.dataset.result import Result
from pcbench.plots import frames, layout, maps, one_run
from pcbench.plots.calibration_curves import Floats
from pcbench.plots.crossings import Crossing
from pcbench.plots.labels import SAME, describe_runs, quantity, times, unit_of
from pcbench.plots.paired_ratios import Ratios, verdict
from pcbench.plots.regret_matrix import Regrets
from pcbench.plots.time_series import INTERVAL, LOOPED, SIGMA, over
from pcbench.statistics import limit_verdicts
from pcbench.statistics.aggregate import Row
from pcbench.statistics.limit_verdicts import Answer, Point
from pcbench.statistics.ranking import most_often

CONVERGENCE = "Half the 95 % interval divided by the mean. Four times as many runs halve it."
COSTS = "Lower left is better. Operations are counted in the observers' functions."
INTERVALS = "Bars: 95 % intervals of the mean."
BEARING = "Above 1, model-only is better. One axis varies at a time, and the others have their first value."
CALIBRATION = (
    "Below the diagonal, or with a peak of the PIT at 1, a filter is optimistic; the band contains 95 % of the results of a "
    "true covariance."
)
NEES = "Above 1 a filter is optimistic, below 1 pessimistic. Bars: 95 % intervals of the mean."
FIRST_VALUES = "the first values of all axes"
NINETY_FIVE = 0.95
TIMES = 2.0  # the default limit divided by the least mean of the axis
WORDS = {"published": "published", "design": "designed", "tuned": "tuned"}


def number(value: float) -> str:
    """Return a number with three digits."""
    return layout.number(float(f"{value:.3g}")) if np.isfinite(value) else "-"


def ratios(table: Ratios) -> str:
    """Return the ratio of each observer to the best, with its interval and p-value."""
    texts = []
    for row in cast(list[Row], table.rows.to_dict("records")):
        ends = "" if table.exact else f" ({number(row['ci_low'])} to {number(row['ci_high'])})"
        ratio = f" {number(row['ratio'])}{ends}" if np.isfinite(row["ratio"]) and row["observer"] != table.best else ""
        texts.append(f"{row['observer']}{ratio}, {verdict(row, table)}")
    return f"Ratios to {table.best}: {'; '.join(texts)}."


def best(table: Ratios) -> str:
    """Return which observer is the best, and which are significantly worse, in a sentence with runs and method."""
    rest, runs = table.rows[table.rows.observer != table.best], int(table.rows.n.max())
    methods = ["95 % paired intervals"] * table.intervals
    methods += ["paired t-test with Holm's correction at 5 %"] if table.has_p else ["runs do not vary"]
    worse, ties = (rest.observer[which].to_list() for which in (rest.worse, ~rest.worse.astype(bool)))
    comparison = f"{_join(worse)} {'is' if len(worse) == 1 else 'are'}" if ties else "every other observer is"
    comparison = comparison if worse else "no other observer is"
    method = ", ".join([f"{runs:,} runs", *methods])
    with_less_error = rest.observer[rest.ratio < 1 / SAME].to_list()
    lead = f"{table.best} has the {'fewest diverged runs' if with_less_error else 'least error'}"
    if table.exact:
        return f"{lead}, and {comparison} worse (exact values)."
    elif runs < 2:
        return f"{lead}; one run shows no significance."
    comparison += " significantly worse"
    if ties and worse:
        comparison += f", {_join(ties)} {'is' if len(ties) == 1 else 'are'} not"
    if with_less_error:
        verb = "have" if with_less_error[1:] else "has"
        comparison += f"; {_join(with_less_error)} {verb} less error in the runs that do not diverge"
    return f"{lead}, and {comparison} ({method})."


def scenarios(table: pd.DataFrame) -> str:
    """Return the value of each scenario, of rows of `scenario_errors.rows_of`."""
    unit = unit_of(table)
    several = table.observer.nunique() > 1
    rows = cast(list[Row], table.to_dict("records"))
    names = [f"{row['scenario']}, {row['observer']}" if several else row["scenario"] for row in rows]
    values = zip(names, table["mean"], strict=True)
    return f"{'; '.join(f'{name} {_format_value(value, unit)}' for name, value in values)}."


def regrets(matrix: Regrets) -> tuple[str, str]:
    """Return two texts: the largest ratios, shares and errors of the best; and which observer has the smallest worst case."""
    largest, worst, rows = matrix.largest, matrix.worst, matrix.rows
    text = f"Largest ratios: {', '.join(f'{o} {times(v)}' for o, v in largest.items())}."
    shares = rows.groupby("observer", sort=False).diverged.max().loc[matrix.observers]
    if (shares > 0).any():
        shares_text = ", ".join(f"{o} {100 * share:.3g} %" for o, share in shares.items() if share)
        text += f" Largest shares of diverged runs: {shares_text}."
    if matrix.unit:
        errors = ", ".join(f"{s} {_format_value(v, matrix.unit)}" for s, v in matrix.least.items())
        text += f" Errors of the best: {errors}."
    first, method = matrix.observers[0], describe_runs(matrix.runs)
    if matrix.ties.any():
        test = " by the paired t-test with Holm's correction at 5 %" if matrix.runs > 1 else ""
        method += f", hatched: {matrix.tie}{test}"
    situations = f"{len(matrix.situations)} situations"
    if not np.isfinite(rows.ratio).all():
        method += "; ∞: every run diverged" if matrix.runs else "; ∞: the expected value is infinite"
    counts = matrix.counts
    less_error = rows[rows.ratio < 1 / SAME]  # than the best, which diverges less often
    if counts[first] < len(matrix.situations):
        most = f"{first} runs in most, {counts[first]}"
        note = f"No observer runs in all {situations}, so worst cases are not compared; {most} ({method})."
    elif not np.isfinite(worst[first]):
        more = "significantly more often than the best " if rows.more.any() else ""
        every = "Each observer that runs in all" if min(counts.values()) < counts[first] else "Each observer"
        note = f"{every} diverges {more}in a situation ({method})."
    elif worst[first] < SAME:
        leaders = [
            observer for observer in matrix.observers if worst[observer] < SAME and counts[observer] == counts[first]
        ]
        verb, other = ("are", "have") if leaders[1:] else ("is", "has")
        note = f"{_join(leaders)} {other} the least error, or one as good, in all {situations} ({method})."
        if len(less_error):
            note = f"{_join(leaders)} {verb} the best, or as good as the best, in all {situations} ({method})."
    else:
        bound = f"at most {times(worst[first])} that of the best in {situations}"
        note = f"{first} has the smallest worst case: its error is {bound} ({method})."
    if len(less_error):
        note += " Bold: the best, which has the fewest diverged runs. Errors are of runs that do not diverge."
    for observer, group in less_error[less_error.more].groupby("observer", sort=False):
        count = f"{len(group)} of the situations"
        note += f" {observer} has less error in {count}, but diverges significantly more often."
    return text, note


def _join(names: list[str]) -> str:
    return " and ".join(filter(None, [", ".join(names[:-1]), *names[-1:]]))


def medians(part: pd.DataFrame, unit: str) -> str:
    """Return the medians at a grid point."""
    texts = [
        f"{row['observer']} {_format_value(row['p50'], unit, _absent(row['diverged']))}"
        for row in part.to_dict("records")
    ]
    return f"Medians: {', '.join(texts)}."


def curve(part: pd.DataFrame, axis: str, unit: str) -> str:
    """Return the first and the last value of each observer's curve."""
    has_words = any(isinstance(v, str) or v is None or not isfinite(v) for v in part[axis])  # drawn in their order
    rows = part if has_words else part.sort_values(axis, kind="stable")
    texts = []
    for observer, group in rows.groupby("observer", sort=False):
        a, b = group.iloc[0], group.iloc[-1]
        ends = [
            f"{_format_value(row['mean'], unit, _absent(row['diverged']))} at {frames.word(axis, row[axis])}"
            for row in (a, b)
        ]
        texts.append(f"{observer}: {' to '.join(ends)}")
    return "; ".join(texts) + "."


def crossings(changes: list[Crossing]) -> str:
    """Return where the best observer changes, with 95 % intervals; empty if it does not."""
    sentences = (
        f"{c.above} is better than {c.below} above {number(c.value)} ({number(c.low)} to {number(c.high)})"
        for c in changes
    )
    return f"Dotted lines, with 95 % intervals: {'; '.join(sentences)}." if changes else ""


def ranges(part: pd.DataFrame, unit: str) -> str:
    """Return the least and the largest value of each observer's map."""
    texts = []
    for observer, group in part.groupby("observer", sort=False):
        finite = group["mean"][np.isfinite(group["mean"])]
        text = f"{number(finite.min())} to {number(finite.max())}" if len(finite) else _absent(group.diverged.sum())
        texts.append(f"{observer} {text}")
    return f"Ranges{f' [{unit}]' if unit not in ('', '1') else ''}: {', '.join(texts)}."


def winners(standings: pd.DataFrame) -> str:
    """Return how many grid points each observer wins; if none wins any, which are as good as the best."""
    counts = standings.text.value_counts()
    names, most = ([], 0) if (standings.winner != "").any() else most_often(standings.leaders)
    ties = f" No observer is significantly better than {' and '.join(names)} at {most} of them." if most else ""
    return f"Of {len(standings)} grid points: {', '.join(f'{name} {n}' for name, n in counts.items())}.{ties}"


def convergence(part: pd.DataFrame) -> str:
    """Return the width of each observer's interval over all runs."""
    last = part.groupby("observer", sort=False).last()
    texts = [f"{o} ± {number(100 * row.half)} % after {int(row.seeds):,} runs" for o, row in last.iterrows()]
    return f"{', '.join(texts)}." if texts else "No mean has an interval."


def time(run: pd.DataFrame, unit: str, figure: Figure, exact: frozenset[str] = frozenset()) -> tuple[str, str]:
    """Return the last values of one run, and how to read its `figure`; the errors of `exact` observers are exact over time."""
    # a user's own error has no truth
    kinds = ["truth", "estimate", "target"] if (run.kind == "truth").any() else ["error"]
    ends = run[run.kind.isin(kinds)].groupby("series", sort=False).value.agg(lambda values: values.iloc[-1])
    text = "At the end: " + ", ".join(f"{o} {_format_value(v, unit)}" for o, v in ends.items()) + "."
    errors, with_rms = figure.axes[-1], frozenset(run.series[run.kind == "rms"])
    log, sentences = errors.get_yscale() == "log", []
    if LOOPED in keys_of(figure):
        sentences.append(
            "Thick lines: the plant of each observer's loop, with the observer's dashes, in a paler shade."
        )
        if diverged := [str(o) for o in ends.index[ends.isna()] if not str(o).startswith(one_run.UNDER)]:
            sentences.append(f"The lines of {_join(diverged)} end where the loop diverges.")
    if any(_leaves(ax) for ax in figure.axes):
        sentences.append("Values outside the range are cut off.")
    if errors.collections:
        sentences.append(f"Bands: 90 % of the errors over {over(with_rms, exact)}.")
    if with_rms - exact and (errors.collections or log):
        sentences.append(f"The {one_run.RUNS} runs are this one and those of the next seeds.")
    if any(line.get_label() == INTERVAL for ax in figure.axes[:-1] for line in ax.get_lines()):
        sentences.append("Thin lines about an estimate: the ends of its interval.")
    if any(line.get_label() == SIGMA for line in errors.get_lines()):
        sentences.append(
            f"Thin lines: {'the' if log else 'three times the'} standard deviation that the observer assumes."
        )
    return text, " ".join(sentences)


def _leaves(ax: Axes) -> bool:
    """Return whether a line of a panel leaves its range."""
    low, high = sorted(ax.get_ylim())
    values = [np.asarray(line.get_ydata(), float) for line in ax.get_lines()]
    return any(bool(((value < low) | (value > high)).any()) for value in values)


def _has_bars(figure: Figure) -> bool:
    """Return whether an interval is drawn."""
    bars = [c for ax in figure.axes for c in ax.collections if isinstance(c, LineCollection)]
    segments = [np.asarray(segment) for bar in bars for segment in bar.get_segments()]
    return any(len(segment) and np.ptp(segment[:, 1]) > 0 for segment in segments)  # one without a value is empty


def winners_note(standings: pd.DataFrame, figure: Figure, runs: int) -> str:
    """Return how to read a map of winners, from the frame of `frames.standings`; runs 0: the values are exact."""
    better = (
        "significantly better than every other (paired t-test, Holm, 5 %)" if runs > 1 else "better than every other"
    )
    sentences = [f"An observer wins a grid point if it is {better}."]
    if any("×" in text.get_text() for ax in figure.axes for text in ax.texts):
        sentences.append("The number is the error of the second divided by that of the winner.")
    if any(text.get_text().split("\n")[-1] == times(1.0 + 1e-9) for ax in figure.axes for text in ax.texts):
        sentences.append("1×: their errors differ by less than 0.05 %.")
    if ((standings.winner == "") & (standings.best != "")).any():
        sentences.append("Pale: the difference is not significant." if runs else "Pale: others are equal to the best.")
    return " ".join(sentences)


def distribution_note(part: pd.DataFrame) -> str:
    """Return how to read a distribution over runs, of rows of stats at its grid point."""
    diverged = part.observer[part.diverged > 0].to_list()
    curves_text = f"the curve{'s' * (len(diverged) > 1)} of {_join(diverged)}"
    return f"Left is better.{f' Runs that diverge are missing from {curves_text}.' if diverged else ''}"


def map_note(figure: Figure) -> str:
    """Return how to read maps of errors."""
    return "Darker is worse; all maps have the same scale." if len(figure.axes) > 1 else "Darker is worse."


def divergence_note(part: pd.DataFrame) -> str:
    """Return which observers have no map of diverged runs, from rows of divergence rates."""
    shown = maps.diverging(part)
    rest = [observer for observer in dict.fromkeys(part.observer) if observer not in shown]
    return f"No run of {_join(rest)} diverges." if rest else ""


def curves_note(figure: Figure, limit: str, part: pd.DataFrame) -> str:
    """Return how to read curves of rows of stats, after a sentence of `describe_limit`."""
    return " ".join(filter(None, [limit, _lost(part, "has no curve"), INTERVALS if _has_bars(figure) else ""]))


def costs_note(figure: Figure, counts: pd.DataFrame, part: pd.DataFrame) -> str:
    """Return how to read errors against operations, a frame of `observer_costs.frame_of`, of rows of stats."""
    absent = "An observer without samples is not shown." if (counts["sample"] == 0).any() else ""
    lost = _lost(part, "is not shown")
    return " ".join(filter(None, [COSTS, absent, lost, INTERVALS if _has_bars(figure) else ""]))


def _lost(part: pd.DataFrame, verb: str) -> str:
    """Return which observers have no mean in rows of stats because every run diverges."""
    is_lost = (part["mean"].isna() & (part.diverged > 0)).groupby(part.observer, sort=False).all()
    names = list(is_lost.index[is_lost])
    plural = {"has no curve": "have no curves", "is not shown": "are not shown"}[verb]
    return f"{_join(names)} {plural if names[1:] else verb}: every run diverges." if names else ""


def bands_note(figure: Figure) -> str:
    """Return how to read the bands of |e| over time."""
    has_sigma = "assumed std" in keys_of(figure)
    sigma_note = ", and the assumed standard deviation (dashed), which a consistent filter has at about its 68 % point"
    range_note = " Values outside the range are cut off." if any(_leaves(ax) for ax in figure.axes) else ""
    return f"Median, 50 % and 90 % of the errors of {one_run.RUNS} runs{sigma_note if has_sigma else ''}.{range_note}"


def profiles_note(figure: Figure, matrix: Regrets) -> str:
    """Return how to read performance profiles."""
    diverging = "An observer that diverges significantly more often than the best is within no factor."
    sentences = [diverging] * bool(matrix.rows.more.any())
    if min(matrix.counts.values()) < len(matrix.situations):
        parts = "shares are of all situations, and ranks of those in which an observer runs"
        sentences.append(f"Not every observer runs in every situation: {parts}.")
    if len(figure.axes) == 1:
        return " ".join(["Higher is better.", *sentences])
    ranks_text = (
        "a long bar below is a rank that new runs would not change (paired bootstrap over runs, mean over situations)"
    )
    return " ".join([f"Higher is better above; {ranks_text}.", *sentences])


def consistency_note(run: pd.DataFrame) -> str:
    """Return how to read the NEES over time, of a frame of `one_run.frame_of`."""
    count = one_run.count_runs(run)
    mean = f", as a mean over {count} runs" if count > 1 else ""
    band = "Above the band an observer is optimistic, below it pessimistic."
    return f"NEES: the squared error divided by the observer's covariance{mean}. {band}"


def keys_of(figure: Figure) -> list[str]:
    """Return the texts of a figure's legend."""
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


def bands(part: pd.DataFrame, unit: str) -> str:
    """Return the median size of each observer's error at the end of a run."""
    ends = part[part.kind == one_run.MEDIAN].groupby("series", sort=False).value.last()
    return f"Median of |e| at the end: {', '.join(f'{o} {_format_value(v, unit)}' for o, v in ends.items())}."


def calibration(transforms: dict[str, Floats]) -> str:
    """Return the actual coverage of each filter's region of nominal coverage 95 %."""
    coverages = [f"{o} {100 * float((u <= NINETY_FIVE).mean()):.3g} %" for o, u in transforms.items()]
    return f"Actual coverage at nominal 95 %: {', '.join(coverages)} of {max(map(len, transforms.values())):,} runs."


def profiles(matrix: Regrets) -> str:
    """Return the share of situations in which each observer's error is within twice that of the best."""
    shares = {
        o: (matrix.penalised[matrix.rows.observer == o] <= TIMES).sum() / len(matrix.situations)
        for o in matrix.observers
    }
    shares_text = ", ".join(f"{o} {100 * v:.3g} %" for o, v in shares.items())
    return f"Within twice the error of the best: {shares_text} of situations."


def consistency(run: pd.DataFrame) -> str:
    """Return each observer's mean NEES over the second half of a run."""
    second_half = run[(run.kind == "nees") & (run.t >= run.t.max() / 2)]
    texts = [f"{o} {number(mean)}" for o, mean in second_half.groupby("series", sort=False).value.mean().items()]
    return f"Mean over the second half: {', '.join(texts)}."


def costs(counts: pd.DataFrame) -> str:
    """Return the operation counts of each observer."""
    text = "{observer} {sample:,} per sample, {tick:,} per tick, {memory:,} bytes"
    texts = "; ".join(text.format_map(row) for row in counts.to_dict("records"))
    return f"Multiplications of one run, and memory: {texts}."


def tolerances(table: pd.DataFrame) -> str:
    """Return the value of each axis up to which observers are better than model-only."""

    def most(value: float) -> str:
        return "never" if np.isnan(value) else "everywhere" if np.isinf(value) else f"up to {number(value)}"

    texts = []
    for axis, group in table.groupby("axis", sort=False):
        by_size = bool((group.most < 0).any()) and not (group.most > 0).any()
        sizes = group.assign(most=group.most.abs()) if by_size else group
        limits = [f"{row['observer']} {most(row['most'])}" for row in sizes.to_dict("records")]
        texts.append(f"{'size of ' if by_size else ''}{frames.label(str(axis))}: {', '.join(limits)}")
    return f"Better than model-only: {'; '.join(texts)}."


def fair(table: pd.DataFrame) -> str:
    """Return how far apart the observers are by kind of gains, and each observer's metric on held-out runs."""
    first = table[table.cell == table.cell.iloc[0]]
    unit = first.unit.iloc[0]
    values = [
        f"{r['observer']} {WORDS[r['tuning']]} {quantity(number(r['held_out']), unit)}"
        for r in first.to_dict("records")
    ]
    several = first[first.groupby("observer").tuning.transform("size") > 1]  # without model-only, which has no gains
    groups = several.groupby("tuning", sort=False).held_out
    n_observers = several.observer.nunique()
    ratios = [
        f"{times(group.max() / group.min())} with {WORDS[str(kind)]}"
        for kind, group in groups
        if len(group) == n_observers > 1
    ]
    if not ratios:
        return f"{', '.join(values)}."
    return f"The values of {n_observers} observers differ by up to {_join(ratios)} gains: {', '.join(values)}."


def describe_grid_point(result: Result, part: pd.DataFrame, cell: int) -> str:
    """Return the values of the axes at a grid point; empty if none varies."""
    return ", ".join(frames.describe_values(result, part, cell)) or (FIRST_VALUES if frames.varying_axes(part) else "")


def _format_value(value: float, unit: str, otherwise: str = "diverged") -> str:
    """Return a value with its unit; NaN: `otherwise` in brackets."""
    return "infinite" if np.isinf(value) else f"({otherwise})" if np.isnan(value) else quantity(number(value), unit)


def _absent(diverged: float) -> str:
    """Return why rows have no mean: runs `diverged`, or none did, as where exact moments have no answer."""
    return "diverged in every run" if diverged else "no value"


def describe_limit(part: pd.DataFrame, axis: str, unit: str, threshold: float | None) -> str:
    """Return the values that suffice, from the rows of stats along an axis; empty if it has no numbers or no error is finite.

    `threshold` is the limit, in the unit of the rows; None: TIMES their least mean. Of an axis of negative values, such as an
    offset, the size counts.
    """
    if not all(isinstance(v, int | float) and isfinite(v) for v in part[axis]):
        return ""
    least_mean = part["mean"].min()
    limit = TIMES * least_mean if threshold is None else threshold
    if not limit > 0:
        return ""
    by_size = bool((part[axis] < 0).any() and (part[axis] <= 0).all())
    verdicts = limit_verdicts.points(part.assign(**{axis: part[axis].abs()}) if by_size else part, axis, limit)
    answers = "; ".join(f"{observer} {_words(limit_verdicts.answer(points))}" for observer, points in verdicts.items())
    limit_text = quantity(number(limit), unit) + (" (twice the least mean)" if threshold is None else "")
    comparison = "Significantly below" if frames.count_runs(part) else "Below"
    return f"{comparison} {limit_text}{f', by the size of {frames.label(axis)}' if by_size else ''}: {answers}."


def _words(a: Answer) -> str:
    """Return an answer in a few words."""
    fails = f"not at {layout.word(a.exceeds.value)}{_reason([a.exceeds])}" if a.exceeds else ""
    if a.largest is None or a.kind != "up to":
        undecided = f"undecided, {fails}" if fails else "undecided everywhere"
        words = {"every value": "everywhere", "no value": f"nowhere{_reason(a.points)}", "undecided": undecided}
        return words.get(a.kind, "without a number")
    exception = ""
    if a.fails_below:
        exception = f" (but not at {layout.word(a.fails_below.value)}{_reason([a.fails_below])})"
    beyond = fails or ("" if a.largest == a.points[-1] else "undecided beyond")
    return ", ".join(filter(None, [f"up to {layout.word(a.largest.value)}{exception}", beyond]))


def _reason(points: Iterable[Point]) -> str:
    """Return why an error does not suffice at points, if its mean does not show it."""
    return " (runs diverge)" if all(p.verdict == limit_verdicts.DIVERGES for p in points) else ""
