"""One self-contained page from a study's folder: winners, experiments, tables, figures, and how to repeat the study.

It loads no other file, and its figures are SVG in the page: it opens offline, prints, and needs no script. A script adds one
figure in which you choose what is options. A content security policy in the page forbids every request and every other script.
"""

import base64
import hashlib
import re
from html import unescape
from importlib import resources
from pathlib import Path
from typing import NamedTuple

import jinja2
import tomli_w
from markupsafe import Markup, escape

from pcbench.dataset import storage
from pcbench.dataset.columns import MEANING
from pcbench.dataset.result import Result, open_result
from pcbench.errors import printable
from pcbench.observers import acronyms
from pcbench.plots import frames, layout
from pcbench.plots.labels import inline, with_unit
from pcbench.report import captions, explorer, figures, headline, summary
from pcbench.report import experiment as of_scenario
from pcbench.report.experiment import Experiment
from pcbench.report.figures import DEFAULTS, FigureOptions
from pcbench.runtime.progress import SILENT, Progress
from pcbench.study import title_of_scenario
from pcbench.study.serialize import as_dict

SIGNIFICANT = {
    "significant": "better than every other by a paired t-test over the same runs (5 %, with Holm's correction over the "
    "study's comparisons), or the other diverges significantly more often",
}
WORDS = {
    "steady_start": "the time from which the steady_ metrics are computed, given at each experiment",
    "grid point": "one combination of the values of a study's axes",
}
# numbers of scenarios, so that a page stays small; with more, only the first
MAX_BANDS = 4  # has the size of the error over time
MAX_DETAILED = 12  # has runs over time, distributions, and operations
WIDE = 1.25  # columns of the paper; wider figures come last, as each has its own row
PER_ROW = 2  # figures of a row; if there are more and all are narrow, they are in columns, without a half-empty row
HEADLINE = "-ratios"  # end of the name of the first figure of the page, of the first scenario
POLICY = (  # figures have inline styles, and the icon is an empty picture in the page
    "default-src 'none'; style-src 'unsafe-inline'; img-src data:; script-src 'sha256-{}'; base-uri 'none'; form-action 'none'"
)
SVG, STYLE = re.compile(r"<svg.*?</svg>", re.S), re.compile(r' style="([^"]*)"')
LOOP = "square root of the mean of (set point - state)^2 from steady_start on, small where the closed loop settles"
ALWAYS = ("rmse", "steady_rmse", "rms_efficiency", summary.LOOP, "divergence_rate")


class Part(NamedTuple):
    """The part of the page about one signal of a scenario."""

    title: str
    headlines: list[headline.Headline]
    axis_values: str  # the values of the axes that a figure does not show
    pictures: list[dict[str, str]]


class Section(NamedTuple):
    """The section of the page about one scenario."""

    anchor: str
    title: str
    experiment: Experiment
    parts: list[Part]
    is_brief: bool  # it lacks figures


def write(folder: str | Path, out: str | Path, progress: Progress = SILENT, options: FigureOptions = DEFAULTS) -> int:
    """Write the page of a study's folder as one file, and return its size in bytes.

    `options` select the metric that ranks, signals, grid point and seed. Runs that are shown over time are simulated if the
    folder does not have them, and stored there. Raises UserError if the folder contains no finished study.
    """
    return write_page(page(open_result(folder), progress, options), out)


def write_page(text: str, out: str | Path) -> int:
    """Write a page as one file, and return its size in bytes."""
    content = text.encode()
    target = storage.target(str(Path(out).parent if "://" not in str(out) else str(out).rpartition("/")[0]))
    storage.create_folder(target)
    storage.write_file(target, str(out).replace("\\", "/").rpartition("/")[2], content)
    return len(content)


def page(result: Result, progress: Progress = SILENT, options: FigureOptions = DEFAULTS) -> str:
    """Return the page's HTML; arguments are those of `write`."""
    options = options._replace(metric=result.ranks(options.metric))
    rankings = summary.rankings(result, options.metric, options.signals)
    rows, tallies = summary.rows(result, rankings), summary.tally(rankings)
    names = list(dict.fromkeys([*(row.scenario for row in rows), *result.scenarios]))
    anchors = {name: f"scenario-{i}" for i, name in enumerate(names)}
    detailed = names if len(names) <= MAX_DETAILED else names[:1]
    data = figures.scenario_data(result, names, options, progress, detailed)
    progress.begin("scenarios", len(names))
    sections = list[Section]()
    for name, anchor in anchors.items():
        sections.append(_section(data[name], anchor, bands=len(anchors) <= MAX_BANDS or not sections))
        progress.step(1)
    for picture in sections[0].parts[0].pictures if len(anchors) > MAX_BANDS else ():
        if picture["name"].endswith("-bands"):
            picture["note"] += " Figures of the other scenarios: pcbench report RESULTS --figures FOLDER."
    pictures = (part.pictures for section in sections for part in section.parts)
    headline_figure = next((group.pop(0) for group in pictures if group and group[0]["name"].endswith(HEADLINE)), None)
    wide = WIDE * options.paper.width
    overview = sorted(figures.of_study(result, options), key=lambda p: p.figure.get_figwidth() > wide)
    head = [*([headline_figure] if headline_figure else []), *map(inline_picture, overview)]
    narrow = len(head) > PER_ROW and all(p.figure.get_figwidth() <= wide for p in overview)
    descriptions = MEANING | explorer.OF_STATS | {summary.LOOP: LOOP}
    meaning = {m: descriptions.get(m, "") for m in (options.metric, *ALWAYS)}
    present = {options.metric, *result.stats.metric}
    spelled_out = acronyms(map(str, result.stats.observer.unique()))
    terms = WORDS if len(tallies) == 1 or result.exact else SIGNIFICANT | WORDS
    commit, release = (result.provenance.get(key) or {} for key in ("git", "versions"))
    header = f"# made with pcbench {release.get('pcbench', '')}"
    header += f", commit {commit['commit']}" if commit.get("commit") else ""
    run = "pcbench run study.toml --out again        # study.toml is below, and in the folder"
    return render(
        "page.html",
        title=f"Study {result.study.name}",
        unbroken=_unbroken,
        description=_describe_study(result),
        metric=options.metric,
        metric_means=meaning[options.metric],
        order_note=_order_note(result),
        method=_method(result),
        head=head,
        column=max((p["width"] for p in head), key=lambda width: float(width.removesuffix("pt"))) if narrow else "",
        tally=tallies,
        one_observer=len(tallies) == 1,
        summary=rows,
        tracking=summary.LOOP if any(row.loop for row in rows) else "",
        tracking_means=LOOP,
        many_grid_points=any(t.total > len(rows) for t in tallies),
        anchors=anchors,
        sections=sections,
        options=of_scenario.rows(result),
        tuned=result.study.tuning_sentence,
        command="\n".join([header, run, "pcbench report again"]),
        study=tomli_w.dumps(as_dict(result.study)).strip(),
        provenance=_provenance(result),
        meaning=[*((m, words) for m, words in meaning.items() if m in present), *spelled_out.items(), *terms.items()],
        numbers=explorer.numbers(result, options.metric),
    )


def render(template: str, **words: object) -> str:
    """Return a template of this folder as HTML, with all `words` escaped, and with this folder's style and scripts.

    The script of the interactive figure is included if `words` contain its numbers.
    """
    files = ["page.css", "page.js", *(["explorer.js"] if "numbers" in words else [])]
    style, *scripts = ((resources.files("pcbench.report") / name).read_text("utf-8") for name in files)
    script = "".join(scripts)
    digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
    policy = Markup(POLICY.format(digest))
    loader = jinja2.PackageLoader("pcbench", "report")
    environment = jinja2.Environment(loader=loader, autoescape=True, undefined=jinja2.StrictUndefined, finalize=_escape)
    html = environment.get_template(template).render(style=Markup(style), script=Markup(script), policy=policy, **words)
    return share_styles(html)


def share_styles(html: str) -> str:
    """Return a page in which each style of its figures is written once, as the rule of a class."""
    names: dict[str, str] = {}

    def name(style: re.Match[str]) -> str:
        return f' class="{names.setdefault(unescape(style[1]), f"s{len(names)}")}"'

    html = SVG.sub(lambda svg: STYLE.sub(name, svg[0]), html)
    rules = "".join(f".{selector}{{{style}}}" for style, selector in names.items())
    return html.replace("</style>", f"{rules}</style>", 1)


def _section(source: figures.ScenarioData, anchor: str, bands: bool) -> Section:
    """Return the section of a scenario; without `bands` it lacks the largest figures, those of the error over time."""
    result, scenario, options, parts = source.result, source.scenario, source.options, []
    for signal, pictures in figures.of_scenario(source):
        entries = [inline_picture(picture) for picture in pictures if bands or not picture.name.endswith("-bands")]
        if signal is None:
            parts += [Part("All signals", [], "", entries)] if entries else []
            continue
        tables = headline.headlines(
            result, scenario, signal, options.metric, source.cell, None if parts else source.costs
        )
        stats = frames.rows(result, scenario, signal, options.metric)
        at = captions.describe_grid_point(result, stats, source.cell)
        unit = figures.unit_of_signal(result, scenario, signal)
        parts.append(Part(with_unit(f"Error of {signal.replace('_', ' ')}", unit), tables, at, entries))
    title, experiment = title_of_scenario(result.study, scenario), of_scenario.experiment(result, scenario)
    return Section(anchor, title, experiment, parts, source.is_brief)


def inline_picture(p: figures.Picture) -> dict[str, str]:
    """Return a figure and its texts as the page's template takes them, with its natural width."""
    texts = {"name": p.name, "title": p.title, "text": p.text, "note": p.note}
    return texts | {"svg": inline(p.figure, p.name), "width": f"{72 * p.figure.get_figwidth():.0f}pt"}


def _describe_study(result: Result) -> str:
    rows = result.stats[result.stats.metric == "mae"]
    scenarios, cells = rows.scenario.nunique(), int(rows.groupby("scenario").cell.nunique().sum())
    observers, runs = list(dict.fromkeys(rows.observer)), int((rows.n + rows.diverged).max())
    grid_points = f", {cells} combinations of axis values" if cells > scenarios else ""
    seeds = f"with up to {runs:,} runs each" if runs else "exact expected values over all noise"
    where = f"{scenarios} scenario" + ("s" if scenarios > 1 else "")
    plural = "s" if len(observers) > 1 else ""
    return f"{len(observers)} observer{plural} ({', '.join(observers)}) in {where}{grid_points}, {seeds}."


def _order_note(result: Result) -> str:
    if result.exact:
        return "Numbers without an interval are exact, and so are the differences between them."
    if int((result.stats.n + result.stats.diverged).max()) < 2:
        has_several = result.stats.observer.nunique() > 1
        return f"One run each: no {'difference is significant' if has_several else 'intervals'}."
    if len(result.scenarios) < 2:
        return ""
    if summary.keeps_order(result):
        return "Scenarios are in the order of the study."
    return "Scenarios with noise come first, then those in which the best observer has the largest lead."


def _method(result: Result) -> str:
    """Return how all numbers of the page are computed: over runs, or exactly."""
    runs = "Intervals are 95 % over runs."
    runs += " All observers use the same random numbers." if result.stats.observer.nunique() > 1 else ""
    return runs if frames.count_runs(result.stats) else "The values are exact over all noise."


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
    """Return a value for the page: characters that cannot be printed are escaped; figures are escaped already."""
    return value if isinstance(value, Markup) or not isinstance(value, str) else printable(value, but="\n")


def _unbroken(cell: str) -> Markup:
    """Return a table's cell whose line breaks only before an interval, never inside one."""
    text = str(escape(printable(layout.with_powers(cell))))
    for sign in ("± ", " ..", ".. ", " %"):
        text = text.replace(sign, sign.replace(" ", "&nbsp;"))
    return Markup(text)
