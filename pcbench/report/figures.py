"""The report's pictures as files for a paper: SVG and PNG of each, drawn by matplotlib."""

import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from pcbench import plots
from pcbench.dataset import store
from pcbench.dataset.result import Result
from pcbench.machine.progress import SILENT, Progress
from pcbench.plots import frames, one_run

DPI = 160
KINDS = ("svg", "png")


def write(
    result: Result,
    out: str | Path,
    progress: Progress = SILENT,
    metric: str = frames.METRIC,
    signals: list[str] | None = None,
) -> list[str]:
    """Write every figure that the result has something for, and return the names of the files, without their kind.

    Of every scenario the `signals` that it has; None: those it is known by; an empty list: all.
    """
    target, names = store.target(str(out)), []
    store.make(target)
    progress.begin("figures", None)
    for name, figure in drawn(result, metric, signals):
        for kind in KINDS:
            content = io.BytesIO()
            figure.savefig(content, format=kind, dpi=DPI, metadata={"Date": None} if kind == "svg" else None)
            store.put(target, f"{name}.{kind}", content.getvalue())
        names.append(name)
        progress.step(1)
    return names


def drawn(result: Result, metric: str, signals: list[str] | None) -> Iterator[tuple[str, Figure]]:
    """Yield a name and a figure, scenario after scenario."""
    for scenario in dict.fromkeys(result.stats.scenario):
        head = scenario.replace("/", "-")
        for signal in frames.chosen(result, scenario, signals):
            here: dict[str, Any] = {"scenario": scenario, "signal": signal, "metric": metric}
            name = f"{head}-{signal}"
            yield f"{name}-distribution", plots.distributions(result, **here)
            axes = frames.varying(frames.rows(result, scenario, signal, metric))
            for axis in axes:
                yield f"{name}-over-{axis.replace('.', '-')}", plots.curves(result, axis, **here)
            if len(axes) >= 2:
                yield f"{name}-map", plots.heatmaps(result, **here)
                yield f"{name}-winners", plots.winners(result, **here)
            if one_run.of(result.study, scenario, result.out) is not None:
                yield f"{name}-time", plots.time(result, scenario=scenario, signal=signal)
        lost = frames.rows(result, scenario, None, "divergence")
        if len(frames.varying(lost)) >= 2 and (lost["mean"] > 0).any():
            yield f"{head}-divergence", plots.divergence(result, scenario=scenario)
    if result.fair is not None:
        yield "fair", plots.fair(result)
