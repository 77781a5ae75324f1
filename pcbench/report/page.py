"""One self-contained page from a study's folder: tables, charts, and how to repeat it. Nothing is loaded from elsewhere."""

import json
from collections.abc import Iterator
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from typing import Any, NamedTuple

import altair as alt
import jinja2
import vl_convert

from pcbench.dataset import store
from pcbench.dataset.columns import MEANING
from pcbench.dataset.result import Result, opened
from pcbench.machine import cache
from pcbench.machine.progress import SILENT, Progress
from pcbench.plants import signals_of
from pcbench.plots import frames, one_run
from pcbench.report import chart, headline, lines, maps
from pcbench.report.chart import Chart
from pcbench.study import scenarios_of

EXPLAINED = ("mae", "rmse", "tail_rmse", "peak", "settling_time", "efficiency", "divergence", "mean_diff", "p_holm")


class Section(NamedTuple):
    """What the page says of one scenario."""

    anchor: str
    title: str
    summary: str
    source: str
    headlines: list[headline.Headline]
    charts: list[dict[str, Any]]


def write(
    folder: str | Path,
    out: str | Path,
    progress: Progress = SILENT,
    metric: str = frames.METRIC,
    signals: list[str] | None = None,
) -> int:
    """Write the page of a study's folder as one file, and return its size in bytes.

    Observers are ranked by `metric`; `signals` are those shown, of every scenario that has them: None, those it is known by; an
    empty list, all.
    Runs shown in time are simulated where the folder has none yet, and kept there. Raises UserError where the folder holds no
    finished study.
    """
    content = page(opened(folder), progress, metric, signals).encode()
    target = store.target(str(Path(out).parent if "://" not in str(out) else str(out).rpartition("/")[0]))
    store.make(target)
    store.put(target, str(out).replace("\\", "/").rpartition("/")[2], content)
    return len(content)


def page(
    result: Result,
    progress: Progress = SILENT,
    metric: str = frames.METRIC,
    signals: list[str] | None = None,
) -> str:
    """Return the page's HTML; arguments are those of `write`."""
    names = list(dict.fromkeys(result.stats.scenario))
    progress.begin("scenarios", len(names))
    sections, specs = [], {}
    for number, name in enumerate(names):
        made = []
        for i, drawn in enumerate(_charts(result, name, metric, signals)):
            key = f"chart-{number}-{i}"
            specs[key] = drawn.spec
            made.append({"id": key, "title": drawn.title, "text": drawn.text, "note": drawn.note})
        s = scenarios_of(result.study)[name]
        tables = [
            h
            for signal in frames.chosen(result, name, signals)
            for h in headline.headlines(result, name, signal, metric)
        ]
        sections.append(
            Section(f"scenario-{number}", name, f"{s.summary[0].upper()}{s.summary[1:]}.", s.source, tables, made)
        )
        progress.step(1)
    return str(
        _template().render(
            title=f"Study {result.study.name}",
            what=_what(result),
            sections=sections,
            command=_command(result),
            study=_said(result),
            provenance=_provenance(result),
            meaning=[(name.replace("_", " "), MEANING[name]) for name in EXPLAINED if name in MEANING],
            bundle=_bundle(),
            specs=json.dumps(specs, separators=(",", ":"), allow_nan=False).replace("<", "\\u003c"),
        )
    )


def _charts(result: Result, scenario: str, metric: str, signals: list[str] | None) -> Iterator[Chart]:
    """Every chart that a scenario's results have something for."""
    for signal in frames.chosen(result, scenario, signals):
        whole = frames.rows(result, scenario, signal, metric)
        yield lines.distribution(whole, frames.distribution(result, scenario, signal, metric), metric)
        axes = frames.varying(whole)
        if len(axes) >= 2:
            yield maps.winners(whole, frames.winners(result, scenario, signal, metric), axes[0], axes[1], metric)
            yield maps.heatmap(whole, axes[0], axes[1], metric)
        for axis in axes:
            yield lines.curve(whole, axis, metric)
    lost = frames.rows(result, scenario, None, "divergence")
    axes = frames.varying(lost)
    if len(axes) >= 2 and (lost["mean"] > 0).any():
        yield maps.heatmap(lost, axes[0], axes[1], "divergence")
    if result.fair is not None:
        yield maps.fair(result.fair[result.fair.cell == result.fair.cell.iloc[0]])
    signal = (frames.chosen(result, scenario, signals) or frames.chosen(result, scenario, None))[0]
    units = dict(signals_of(scenarios_of(result.study)[scenario]))
    run = one_run.of(result.study, scenario, result.out)
    shown = dict.fromkeys(lost.observer)
    at = chart.where(lost, [], "Shown at")
    if run is not None:
        yield lines.time(run[run.signal == signal], list(shown), signal, units[signal], result.study.first_seed, at)


def _what(result: Result) -> str:
    mine = result.stats[result.stats.metric == "mae"]
    scenarios, cells = mine.scenario.nunique(), int(mine.groupby("scenario").cell.nunique().sum())
    observers, runs = ", ".join(dict.fromkeys(mine.observer)), int((mine.n + mine.diverged).max())
    many = f"{cells} combinations of axis values" if cells > scenarios else "one combination of axis values each"
    where = f"{scenarios} scenario" + ("s" if scenarios > 1 else "")
    return f"Compared: {observers}; in {where}, {many}, with up to {runs:,} noise seeds each."


def _command(result: Result) -> str:
    commit = (result.provenance.get("git") or {}).get("commit")
    made = f"# made with pcbench {result.provenance.get('versions', {}).get('pcbench', '')}" + (
        f", commit {commit}" if commit else ""
    )
    run = "pcbench run study.toml --out again        # study.toml is below, and in the folder"
    return "\n".join([made, run, "pcbench report again"])


def _said(result: Result) -> str:
    import tomli_w

    from pcbench.study.as_toml import as_dict

    return tomli_w.dumps(as_dict(result.study)).strip()


def _provenance(result: Result) -> list[tuple[str, str]]:
    p = result.provenance
    flat = {"versions": ", ".join(f"{k} {v}" for k, v in p.get("versions", {}).items())}
    flat |= {"device": ", ".join(str(v) for v in p.get("device", {}).values()), "system": p.get("system", "")}
    flat |= {
        k: str(p[k])
        for k in ("precision", "root_seed", "study_sha256", "started", "wall_seconds", "compile_seconds")
        if k in p
    }
    git = p.get("git") or {}
    flat |= {"commit": f"{git['commit']}{' (changed)' if git.get('changed') else ''}"} if git.get("commit") else {}
    return [(k.replace("_", " "), v) for k, v in flat.items() if v]


def _bundle() -> str:
    """Vega-Lite and what it needs, as one script."""
    release = alt.SCHEMA_VERSION.lstrip("v").rpartition(".")[0]
    kept = cache.folder() / f"vega-lite-{release}-{version('vl-convert-python')}.js"
    try:
        return kept.read_text(encoding="utf-8")
    except OSError:
        found = str(vl_convert.javascript_bundle(vl_version=release))  # type: ignore[call-arg]
    text = found.replace("</script", "<\\/script")
    cache.keep(kept, text)
    return text


def _template() -> jinja2.Template:
    text = files("pcbench.report").joinpath("page.html").read_text(encoding="utf-8")
    return jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined).from_string(text)
