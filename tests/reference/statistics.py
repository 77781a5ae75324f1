"""Numbers over runs in plain loops, over whole arrays: an independent reference. No code of pcbench.

The interval of a quantile is that of Nyblom (1992): its ends are x_(r) + w (x_(r+1) - x_(r)), with w from a root-finder: the
point has to lie at or below the quantile with probability g, where the density has exponential sides that meet there.
"""

import math
from functools import cache

from scipy import optimize, special, stats

METRICS = ["mae", "rmse", "mse", "max_abs_error", "final_error", "settling_time", "recovery_time", "steady_mae",
"steady_rmse", "steady_mse",
           "steady_max_abs_error", "tracking_rmse", "steady_tracking_rmse", "lq_cost", "steady_lq_cost", "input_rms",
           "steady_input_rms"]  # fmt: skip
LEVELS = {"p05": 0.05, "p25": 0.25, "p50": 0.5, "p75": 0.75, "p95": 0.95}
NAN = float("nan")


@cache
def student(n):
    return float(stats.t.ppf(0.975, n - 1))


def mean(values):
    n = len(values)
    out = {"n": n, "mean": NAN, "se": NAN, "ci_low": NAN, "ci_high": NAN}
    if n > 0:
        out["mean"] = math.fsum(values) / n
    if n > 1:
        s2 = math.fsum((v - out["mean"]) ** 2 for v in values) / (n - 1)
        out["se"] = 0.0 if min(values) == max(values) else math.sqrt(s2 / n)
        out["ci_low"], out["ci_high"] = (out["mean"] + sign * student(n) * out["se"] for sign in (-1, 1))
    return out


def positive(values):
    """The mean of what cannot be negative: the interval of its logarithm, by the delta method."""
    out = mean(values)
    if out["n"] > 1 and out["mean"] > 0:
        part = student(out["n"]) * out["se"] / out["mean"]
        out["ci_low"], out["ci_high"] = (math.exp(math.log(out["mean"]) + sign * part) for sign in (-1, 1))
    return out


def ratio(a, b):
    """The mean of a over that of b, run by run the same noise: the logarithm's variance from the covariance matrix."""
    n, over, under = len(a), math.fsum(a) / len(a), math.fsum(b) / len(b)
    out = {"n": n, "mean": over / under, "ci_low": NAN, "ci_high": NAN}
    if n > 1:
        aa, bb, ab = (
            math.fsum((x - p) * (y - q) for x, y in zip(u, v, strict=True)) / (n - 1) / n / p / q
            for u, v, p, q in ((a, a, over, over), (b, b, under, under), (a, b, over, under))
        )
        half = student(n) * math.sqrt(max(aa + bb - 2 * ab, 0.0))
        out["ci_low"], out["ci_high"] = (math.exp(math.log(over / under) + sign * half) for sign in (-1, 1))
    return out


def pooled(squares):
    m = positive(squares)
    if m["n"] == 0:
        return m
    rms = math.sqrt(m["mean"])
    se = m["se"] / (2 * rms) if rms > 0 else m["se"]
    low, high = (math.sqrt(end) if m["n"] > 1 else NAN for end in (m["ci_low"], m["ci_high"]))
    return {"n": m["n"], "mean": rms, "se": se, "ci_low": low, "ci_high": high}


def efficiency(squares, bound):
    p = pooled(squares)
    value, high, low = (bound / p[name] if p[name] > 0 else NAN for name in ("mean", "ci_low", "ci_high"))
    return {
        "n": p["n"],
        "mean": value,
        "se": value * p["se"] / p["mean"] if value > 0 else NAN,
        "ci_low": low,
        "ci_high": high,
    }


@cache
def wilson(count, n):
    return stats.binomtest(count, n).proportion_ci(0.95, method="wilson")


def fraction(count, n):
    if n == 0:
        return {"n": 0, "mean": NAN, "se": NAN, "ci_low": NAN, "ci_high": NAN}
    ci, p = wilson(count, n), count / n
    return {"n": n, "mean": p, "se": math.sqrt(p * (1 - p) / n), "ci_low": ci.low, "ci_high": ci.high}


@cache
def end(n, q, g):
    """r and w of the point at or below the q-quantile of n values with probability g. w NaN: there is none."""
    count = stats.binom(n, q)  # how many values are <= the quantile
    if count.sf(0) < g or count.sf(n - 1) > g:
        return 1, NAN
    r = max(r for r in range(1, n) if count.sf(r - 1) >= g)

    def missing(w):
        left, right = (1 - w) * q / r, w * (1 - q) / (n - r)
        return count.sf(r) + count.pmf(r) * left / (left + right) - g

    return r, optimize.brentq(missing, 0.0, 1.0, xtol=1e-15, rtol=1e-15)


def quantiles(values):
    x, out = sorted(values), {}
    for name, q in LEVELS.items():
        at = 1 + (len(x) - 1) * q
        r = math.floor(at)
        out[name] = x[r - 1] + (at - r) * (x[min(r, len(x) - 1)] - x[r - 1]) if x else NAN
        for side, g in ("_low", 0.975), ("_high", 0.025):
            r, w = end(len(x), q, g) if x else (1, NAN)
            out[name + side] = NAN if math.isnan(w) else x[r - 1] + w * (x[r] - x[r - 1])
    return out


def describe(results, bound):
    """The rows of one observer from whole arrays."""
    good = [j for j, bad in enumerate(results["diverged"]) if not bad]
    gone = len(results["diverged"]) - len(good)
    none = {name + side: NAN for name in LEVELS for side in ("", "_low", "_high")}
    rows = []
    for i in range(len(results["mae"])):
        mine = {m: [float(results[m][i][j]) for j in good] for m in METRICS if m in results and i < len(results[m])}
        found = [(m, (mean(v) if m == "final_error" else positive(v)) | quantiles(v)) for m, v in mine.items()]
        found += [
            ("pooled_rmse", pooled(mine["mse"]) | none),
            ("steady_pooled_rmse", pooled(mine["steady_mse"]) | none),
        ]
        found.append(("divergence_rate", fraction(gone, len(results["diverged"])) | none))
        found.append(
            ("unsettled_rate", fraction(sum(bool(results["unsettled"][i][j]) for j in good), len(good)) | none)
        )
        if bound is not None and not math.isnan(bound[i]):
            found.append(("rms_efficiency", efficiency(mine["steady_mse"], bound[i]) | none))
        rows += [{"signal": i, "metric": m, "diverged": gone} | row for m, row in found]
    return rows


def compare(a, b, bad_a, bad_b, floor):
    apart, score, decided, ties = [], 0.0, False, 0
    for x, y, lost_a, lost_b in zip(a, b, bad_a, bad_b, strict=True):
        if lost_a or lost_b:
            score += 0.5 if lost_a and lost_b else 0.0 if lost_a else 1.0
            decided = decided or lost_a != lost_b
            continue
        decided = True
        apart.append(x - y)
        tie = abs(x - y) <= 1e-7 * max(abs(x), abs(y)) + floor
        ties += tie
        score += 0.5 if tie else 1.0 if x < y else 0.0
    d = mean(apart)
    tested = d["se"] > 0 and ties < len(apart)
    p = (
        2 * float(special.stdtr(d["n"] - 1, -abs(d["mean"]) / d["se"])) if tested else NAN
    )  # as stats.t.sf, which is slow
    return {
        "n": d["n"],
        "mean_diff": d["mean"],
        "se": d["se"],
        "ci_low": d["ci_low"],
        "ci_high": d["ci_high"],
        "prob_a_better": score / len(a) if decided else NAN,
        "p_value": p,
    }


def pairs(results, signals, sizes):
    rows, labels = [], list(results)
    for k, a in enumerate(labels):
        for b in labels[k + 1 :]:
            ra, rb = results[a], results[b]
            for i in range(min(len(ra["mae"]), len(rb["mae"]))):
                for m in METRICS:
                    if m != "final_error" and m in ra and i < len(ra[m]):
                        floor = 1e-11 * sizes[i] * (sizes[i] if m in ("mse", "steady_mse") else 1.0)
                        row = compare(ra[m][i], rb[m][i], ra["diverged"], rb["diverged"], floor)
                        rows.append({"observer_a": a, "observer_b": b, "signal": signals[i], "metric": m} | row)
    return rows
