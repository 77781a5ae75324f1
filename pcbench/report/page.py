"""One self-contained page from a study's folder: who wins, the experiments, tables and pictures, and how to repeat it.

Nothing is loaded from elsewhere, and the pictures are SVG in the page: it opens anywhere, prints, and needs no script.
"""

from importlib.resources import files
from pathlib import Path
from typing import NamedTuple

import jinja2
import tomli_w
from markupsafe import Markup

from pcbench.dataset import storage
from pcbench.dataset.columns import MEANING
from pcbench.dataset.result import Result, open_result
from pcbench.errors import printable
from pcbench.plots import frames
from pcbench.plots.labels import inline, title_of_scenario
from pcbench.report import captions, figures, headline, summary
from pcbench.report import experiment as of_scenario
from pcbench.report.experiment import Experiment
from pcbench.report.figures import SHOWN, FigureOptions
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study.serialize import as_dict

WORDS = {
    "significant": "better than every other by a paired test on the same draws, 5 % with Holm's correction over the study's "
    "comparisons; or the other diverges significantly more often",
    "steady_start": "the part of a run that steady_ metrics are of, from the time said at each experiment on",
    "cell": "one combination of the values of a study's axes",
}
ALWAYS = ("rmse", "steady_rmse", "rms_efficiency", "divergence_rate")


OF_STATS = {
    "pooled_rmse": "root of the expected square of e over ticks 0 .. N-1",
    "steady_pooled_rmse": "the same from the scenario's tail start on",
    "pooled_tracking_rmse": "root of the expected square of set point less state, in a closed loop",
    "steady_pooled_tracking_rmse": "the same from the tail start on",
    "rms_efficiency": "the least steady_pooled_rmse that any causal estimator can have, over the observer's: 1 is best",
    "divergence_rate": "the share of runs whose error became non-finite or left the scenario's divergence threshold; none of "
    "them is averaged",
}


class Part(NamedTuple):
    """What the page says of one signal of a scenario."""

    title: str
    headlines: list[headline.Headline]
    at: str  # the values of the axes at which pictures stand
    pictures: list[dict[str, str]]


class Section(NamedTuple):
    """What the page says of one scenario."""

    anchor: str
    title: str
    experiment: Experiment
    parts: list[Part]


def write(folder: str | Path, out: str | Path, progress: Progress = SILENT, shown: FigureOptions = SHOWN) -> int:
    """Write the page of a study's folder as one file, and return its size in bytes.

    `shown` says what is to be looked at: the metric that ranks, signals, cell and seed. Runs shown in time are simulated where
    the folder has none of these yet, and kept there. Raises UserError where the folder holds no finished study.
    """
    content = page(open_result(folder), progress, shown).encode()
    target = storage.target(str(Path(out).parent if "://" not in str(out) else str(out).rpartition("/")[0]))
    storage.make(target)
    storage.put(target, str(out).replace("\\", "/").rpartition("/")[2], content)
    return len(content)


def page(result: Result, progress: Progress = SILENT, shown: FigureOptions = SHOWN) -> str:
    """Return the page's HTML; arguments are those of `write`."""
    shown = shown._replace(metric=result.ranks(shown.metric))
    stood = summary.stood(result, shown.metric, shown.signals)
    rows, won = summary.rows(result, stood), summary.tally(stood)
    names = list(dict.fromkeys([*(row.scenario for row in rows), *result.scenarios]))
    anchors = {name: f"scenario-{i}" for i, name in enumerate(names)}
    places = figures.places(result, names, shown, progress)
    progress.begin("scenarios", len(names))
    sections = []
    for name, anchor in anchors.items():
        sections.append(_section(places[name], anchor))
        progress.step(1)
    meaning = {m: MEANING.get(m, OF_STATS.get(m, "")) for m in (shown.metric, *ALWAYS)}
    present = {shown.metric, *result.stats.metric}
    commit, release = (result.provenance.get(key) or {} for key in ("git", "versions"))
    made = f"# made with pcbench {release.get('pcbench', '')}"
    made += f", commit {commit['commit']}" if commit.get("commit") else ""
    run = "pcbench run study.toml --out again        # study.toml is below, and in the folder"
    text = files("pcbench.report").joinpath("page.html").read_text(encoding="utf-8")
    template = jinja2.Environment(autoescape=True, undefined=jinja2.StrictUndefined, finalize=_escape).from_string(text)
    return str(
        template.render(
            title=f"Study {result.study.name}",
            what=_what(result),
            metric=shown.metric,
            metric_means=meaning[shown.metric],
            sure=_how_sure(result),
            tally=won,
            summary=rows,
            several=any(t.of > len(rows) for t in won),
            anchors=anchors,
            sections=sections,
            options=of_scenario.rows(result),
            tuned=result.study.tuning_sentence,
            command="\n".join([made, run, "pcbench report again"]),
            study=tomli_w.dumps(as_dict(result.study)).strip(),
            provenance=_provenance(result),
            meaning=[*((m, words) for m, words in meaning.items() if m in present), *WORDS.items()],
        )
    )


def _section(place: figures.Place, anchor: str) -> Section:
    result, scenario, shown, parts = place.result, place.scenario, place.shown, []
    for signal, pictures in figures.of_scenario(place):
        drawn = [
            {"name": p.name, "title": p.title, "text": p.text, "note": p.note, "svg": inline(p.figure, p.name)}
            for p in pictures
        ]
        if signal is None:
            parts += [Part("All signals", [], "", drawn)] if drawn else []
            continue
        tables = headline.headlines(result, scenario, signal, shown.metric, place.cell, place.costs)
        at = captions.where(frames.rows(result, scenario, signal, shown.metric), place.cell)
        unit = figures.unit_of_signal(result, scenario, signal)
        parts.append(Part(f"Error of {signal.replace('_', ' ')} [{unit}]", tables, at, drawn))
    return Section(anchor, title_of_scenario(result, scenario), of_scenario.experiment(result, scenario), parts)


def _what(result: Result) -> str:
    mine = result.stats[result.stats.metric == "mae"]
    scenarios, cells = mine.scenario.nunique(), int(mine.groupby("scenario").cell.nunique().sum())
    observers, runs = list(dict.fromkeys(mine.observer)), int((mine.n + mine.diverged).max())
    many = f", {cells} combinations of axis values" if cells > scenarios else ""
    seeds = f"with up to {runs:,} noise seeds each" if runs else "exact: the expected values over all noise"
    where = f"{scenarios} scenario" + ("s" if scenarios > 1 else "")
    return f"{len(observers)} observers ({', '.join(observers)}) in {where}{many}, {seeds}."


def _how_sure(result: Result) -> str:
    if result.exact:
        return "What has no interval is exact, and a difference between two such numbers is sure."
    if int((result.stats.n + result.stats.diverged).max()) < 2:
        return "One run each: nothing is significant."
    return "Scenarios with noise stand first, then those in which the best is farthest ahead."


def _provenance(result: Result) -> list[tuple[str, str]]:
    p = result.provenance
    rows = {key: ", ".join(f"{k} {v}" for k, v in p.get(key, {}).items()) for key in ("versions", "device")}
    rows["system"] = p.get("system", "")
    keys = ("precision", "root_seed", "study_sha256", "started", "wall_seconds", "compile_seconds")
    rows |= {key: str(p[key]) for key in keys if key in p}
    git = p.get("git") or {}
    rows["commit"] = f"{git.get('commit') or ''}{' (changed)' if git.get('changed') and git.get('commit') else ''}"
    excluded = [(f"left out: {label}", reason) for label, reason in (result.study.excluded or {}).items()]
    return [*((k.replace("_", " "), v) for k, v in rows.items() if v), *excluded]


def _escape(value: object) -> object:
    """What the page shows: a text that cannot be printed has escapes; pictures are made of such text already."""
    return value if isinstance(value, Markup) or not isinstance(value, str) else printable(value, but="\n")
