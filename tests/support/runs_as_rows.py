"""Numbers over runs as rows, of whole arrays or of chunks of them: what tests compare with their references."""

import numpy as np

from pcbench import statistics
from pcbench.statistics.aggregate import columns
from pcbench.statistics.comparison import pair_stats, paired_t_test
from pcbench.statistics.confidence_intervals import moments, positive, rms_efficiency, root, wilson
from pcbench.statistics.quantile_intervals import COLUMNS, positions, ranks, values_at


def quantiles(values):
    """The quantiles over runs of values [n] with their intervals."""
    where = positions(len(values))
    return dict(
        zip(COLUMNS, values_at(where, np.sort(values)[None, ranks(where, len(values))])[0].tolist(), strict=True)
    )


def pool(squares):
    """The root of the mean of squares [n] with its uncertainty."""
    return columns(root(positive(moments(squares[None]))))[0]


def efficiency(steady_squares, bound):
    """A bound over the root of the mean of squares."""
    return columns(rms_efficiency(np.array([bound]), root(positive(moments(steady_squares[None])))))[0]


def fraction(happened):
    """The fraction of runs [n] in which something happened."""
    return columns(wilson(np.array([np.sum(happened)]), len(happened)))[0]


def compare(a, b, bad_a, bad_b, floor=0.0):
    """A metric of two observers on the same draws; bad_a and bad_b [n] diverged."""
    d, better, p = paired_t_test(pair_stats(a[None], b[None], bad_a, bad_b, np.array([floor])))
    return {"n": d.n} | dict(zip(statistics.VERDICT, (float(each[0]) for each in (*d[1:], better, p)), strict=True))


def summarise(chunks, bounds, signals, sizes):
    """Rows of stats by observer, and rows of pairs, of one cell."""
    described, met = statistics.summary(chunks, bounds, sizes)
    stats = {}
    for label, d in described.items():
        each = zip(d.names, d.n.tolist(), d.values[0].tolist(), d.exists[0], strict=True)
        stats[label] = [
            {"signal": i, "metric": metric, "n": n, "diverged": d.diverged}
            | dict(zip((*statistics.ESTIMATED, *COLUMNS), row, strict=True))
            for (metric, i), n, row, shown in each
            if shown
        ]
    pairs = [
        {"observer_a": a, "observer_b": b, "signal": signals[i], "metric": metric, "n": j.n}
        | dict(zip(statistics.VERDICT, row, strict=True))
        for (a, b), j in met.items()
        for (metric, i), row in zip(j.names, j.values[0].tolist(), strict=True)
    ]
    return stats, pairs
