"""The numbers of the page on event-triggered measurements are those of its studies."""

import re

import pytest
from documents import PAGES, tables

import pcbench

PAGE = PAGES["network_findings.md"]
pytestmark = pytest.mark.nightly


def means(result, signal, metric):
    part = result.stats[(result.stats.signal == signal) & (result.stats.metric == metric)]
    return part.set_index(["scenario", "cell", "observer"])["mean"]


def test_thresholds_and_periods():
    result = pcbench.run("send-on-delta")
    errors, share = means(result, "level_2", "steady_rmse"), means(result, "level_1", "sent_fraction")
    nees = means(result, "level_1", "nees")
    printed = tables(PAGE, "threshold [cm]")
    for cell, (threshold, sent, kf, event, alone, square) in enumerate(printed):
        assert f"{errors['levels', cell, 'model-only']:.4f}" == alone
        assert f"{nees['levels', cell, 'kf-event']:.2f}" == square
        assert f"{errors['levels', cell, 'kf']:.4f}" == kf, threshold
        assert f"{errors['levels', cell, 'kf-event']:.4f}" == event, threshold
        assert f"{share['levels', cell, 'kf']:.3f}" == f"{float(sent):.3f}"
    regular = pcbench.run(
        "send-on-delta",
        observers=["kf"],
        overrides=["axes.send_threshold=0", "axes.sampling_period=[5,12,22,40]"],
    )
    periodic = means(regular, "level_2", "steady_rmse")
    (line,) = (row for row in tables(PAGE, "sampling period [s]") if row[0].startswith("kf"))
    assert [f"{periodic['levels', cell, 'kf']:.4f}" for cell in (1, 2, 3)] == line[1:]
    ratios = [float(row[3]) / float(value) for row, value in zip(printed[1:4], line[1:], strict=True)]
    better = [f"{100 * (1 - r):.0f}" for r in ratios]
    assert f"{better[0]} % better than periodic samples at 0.05 cm, {better[1]} % better at 0.1 cm" in PAGE
    assert f"{-int(better[2])} % worse at 0.2 cm" in PAGE


def test_protocols():
    stats = pcbench.run("ncs-reactor").stats.query("metric == 'steady_rmse'").set_index(["signal", "scenario"])
    columns = [(signal, name) for signal in ("x1", "x2") for name in ("round-robin", "try-once-discard")]
    for interval, *printed in tables(PAGE, "interval between transmissions [s]"):
        for (signal, name), text in zip(columns, printed, strict=True):
            mean, half = re.match(r"(\S+) ± (\S+)", text).groups()
            row = stats.loc[signal, f"{name}-{interval}"]
            assert f"{row['mean']:.4f}" == mean
            assert f"{(row.ci_high - row.ci_low) / 2:.4f}" == half


def test_exact_errors_of_round_robin():
    stats = pcbench.run("ncs-reactor", evaluation="exact").stats.query("metric == 'steady_pooled_rmse'")
    stats = stats.set_index(["signal", "scenario"])
    for interval, *printed in tables(PAGE, "interval [s]"):
        for signal, text in zip(("x1", "x2"), printed, strict=True):
            assert f"{stats.loc[(signal, f'round-robin-{interval}'), 'mean']:.4f}" == text
