"""Performance profiles over situations, and how stable the ranks of observers are over runs.

The profile of an observer is the share of situations (scenarios at grid points) in which its error is at most a factor times
that of the best. If it diverges significantly more often than the best, it is within no factor. Source: Dolan, More, Math.
Program. 91 (2002), 201-213. The probability of a rank comes from a paired bootstrap: runs are drawn with replacement, the same
for all observers, and observers are ranked again by fewest diverged runs, then by the mean. Equal observers share the better
rank.
"""

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from pcbench.dataset.result import Result
from pcbench.errors import UserError
from pcbench.plots import frames
from pcbench.plots.labels import describe_metric, describe_runs
from pcbench.plots.layout import PAPER, Paper, set_limits, set_range, sheet
from pcbench.plots.lines import lines
from pcbench.plots.palette import ink_on, pale, styles
from pcbench.plots.regret_matrix import MOST, Regrets, regrets_of
from pcbench.statistics import COMPARED, POOLED

REPEATS = 1000
EQUAL = 1e-9  # means that differ by a smaller part are equal
LEAST = 0.08  # a probability below it is not written
ROW = 0.21  # inches

Floats = NDArray[np.float64]


def rank_probabilities(
    result: Result, matrix: Regrets, metric: str = frames.METRIC, repeats: int = REPEATS, seed: int = 0
) -> pd.DataFrame:
    """Return the probability of each rank (columns, from 1) of each observer (rows), as a mean over situations.

    Empty if a result is exact, or if the metric does not rank observers.
    """
    metric = result.ranks(metric)
    column = POOLED.get(metric, metric)
    if result.exact or column not in COMPARED:
        return pd.DataFrame()
    rng, tables = np.random.default_rng(seed), []
    places = matrix.rows[["scenario", "signal", "cell"]].drop_duplicates()
    for scenario, signal, cell in places.itertuples(index=False, name=None):
        runs = result.runs_of(scenario, [column], int(cell))
        runs = runs[runs.signal == signal]
        values = runs.assign(value=runs[column].where(~runs.diverged))
        wide = values.pivot(index="seed", columns="observer", values="value")
        counts = rng.multinomial(len(wide), np.full(len(wide), 1 / len(wide)), repeats)
        share = rank_shares(wide.to_numpy(float), counts.astype(float))
        tables.append(pd.DataFrame(share, index=wide.columns.astype(str), columns=range(1, len(wide.columns) + 1)))
    return pd.concat(tables).fillna(0.0).groupby(level=0, sort=False).mean()


def rank_shares(values: Floats, counts: Floats) -> Floats:
    """Return the share of draws [B] in which observer i of m has rank r, [m, m]; values [n, m], NaN diverged; counts [B, n]."""
    missing = np.isnan(values)
    diverged = counts @ missing
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = counts @ np.where(missing, 0.0, values) / (counts @ ~missing)
    mean = np.where(np.isnan(mean), np.inf, mean)
    fewer, as_many = diverged[:, :, None] > diverged[:, None, :], diverged[:, :, None] == diverged[:, None, :]
    with np.errstate(invalid="ignore"):
        smaller = mean[:, None, :] < mean[:, :, None] * (1 - EQUAL)
    rank = (fewer | (as_many & smaller)).sum(-1)  # how many are better than i
    return np.stack([(rank == r).mean(0) for r in range(values.shape[1])], 1)


def shares_within(matrix: Regrets, observer: str) -> tuple[Floats, Floats]:
    """Return ascending factors, and the share of situations in which an observer's error is within them."""
    ratios = matrix.penalised[matrix.rows.observer == observer].to_numpy(float)
    factors = np.sort(ratios[np.isfinite(ratios)])
    return factors, np.arange(1, len(factors) + 1) / len(matrix.situations)


def profiles(
    result: Result, *, metric: str = frames.METRIC, signals: list[str] | None = None, paper: Paper = PAPER
) -> Figure:
    """Return the performance profile of each observer, and the probability of each of its ranks.

    Above: the share of situations (scenarios at grid points) in which the error is within a factor of that of the best; higher
    is better. Below, unless the result is exact: the probability of each rank, by a paired bootstrap over runs, as a mean over
    situations. `signals` selects the signals (None: the first main signal of each scenario). Raises UserError for an unknown
    name, and if the study has fewer than two situations or observers, or more than 48 situations.
    """
    matrix = regrets_of(result, metric, signals)
    if matrix is None:
        raise UserError(
            f"plots.profiles: got {result.study.name}, expected two observers or more and 2 to {MOST} situations with an error "
            "above 0; choose fewer values of the axes, or several."
        )
    probabilities = rank_probabilities(result, matrix, metric)
    has_ranks = not probabilities.empty
    subject = describe_metric(result.ranks(metric), " or ".join(matrix.signals))
    title = f"{subject} [-]: {result.study.name}, {len(matrix.situations)} situations, {describe_runs(matrix.runs)}"
    title += f", ranks by a paired bootstrap ({REPEATS:,} draws)" if has_ranks else ""
    ranks = len(probabilities.columns)
    largest = matrix.penalised[np.isfinite(matrix.penalised)].max()
    height = max(1.3, ROW * len(probabilities)) if has_ranks else 1.5
    with sheet(paper, title, 1 + has_ranks, height=height) as (figure, axes):
        ax = axes[0]
        set_range(ax, "x", [1.0, max(float(largest), 1.05)], log=True)
        ax.set_xlim(left=1.0)
        set_limits(ax, "y", 0.0, 1.02)
        ax.set_yticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
        ax.set(title="share of situations within the factor", xlabel="factor of the error of the best")
        for observer, line in lines(matrix.observers).items():
            factors, shares = shares_within(matrix, observer)
            ax.step(
                [1.0, *factors, ax.get_xlim()[1]],
                [0.0, *shares, *(shares[-1:] if len(shares) else [0.0])],
                where="post",
                **line,
            )
        if has_ranks:
            names = [o for o in matrix.observers if o in probabilities.index]
            _draw_ranks(axes[1], probabilities.loc[names], ranks, paper)
    return figure


def _draw_ranks(ax: Axes, probabilities: pd.DataFrame, ranks: int, paper: Paper) -> None:
    """Draw a bar of probabilities for each observer, the first rank darkest."""
    look = styles(probabilities.index)
    ax.set(title="probability of each rank", xlim=(0.0, 1.0), ylim=(len(probabilities) - 0.5, -0.5))
    ax.set_yticks(range(len(probabilities)), list(probabilities.index))
    ax.set_xticks([0.0, 0.25, 0.5, 0.75, 1.0], ["0", "25 %", "50 %", "75 %", "100 %"])
    ax.grid(False)
    ax.tick_params(axis="y", length=0)
    for y, (observer, row) in enumerate(probabilities.iterrows()):
        offset = 0.0
        for rank, share in row.items():
            colour = pale(look[str(observer)].colour, 0.85 * (int(str(rank)) - 1) / max(ranks - 1, 1))
            ax.barh(y, share, left=offset, height=0.8, color=colour, edgecolor="white", linewidth=0.5)
            if share > LEAST:
                ax.text(offset + share / 2, y, str(rank), ha="center", va="center_baseline", fontsize=paper.size - 2,
                        color=ink_on(colour), in_layout=False)  # fmt: skip
            offset += float(share)
