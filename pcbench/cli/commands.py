"""The commands, in the order of work, and what all of them have."""

from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated

import typer

from pcbench.cli import export, lists, new, recordings, report, runs, tuning
from pcbench.cli.shared import option

ALL: dict[str, tuple[Callable[..., None], str]] = {  # by name: the function, and a line that fits beside the name
    "list": (lists.list_, "what there is: observers, scenarios, options, metrics"),
    "guide": (new.guide, "a page of the guide, or which there are"),
    "show": (lists.show, "a scenario in full, or as a study file to start from"),
    "new": (new.new, "a file to start from: an observer, plant, controller, scenario"),
    "run": (runs.run, "run a study, and leave its tables in a folder"),
    "report": (report.report, "one HTML page of the results, or figures"),
    "tables": (report.tables, "tables for a paper, as LaTeX, Markdown or CSV"),
    "find-limit": (runs.find_limit, "the largest period, delay, noise that keeps an error small"),
    "simulate": (runs.simulate, "one run tick by tick, as a file"),
    "info": (recordings.info, "what is in a recorded log: rates, gaps, delays"),
    "convert": (recordings.convert, "a fast log as a slow, delayed sensor would have brought it"),
    "replay": (recordings.replay, "observers on recorded data, as it arrived"),
    "status": (runs.status, "how far a study is, and whether it is whole"),
    "verify": (runs.verify, "check every file, compute some runs again"),
    "merge": (runs.merge, "one dataset of several"),
    "compare": (runs.compare, "what changed between two results of a study"),
    "design": (tuning.design, "find gains and prove them"),
    "tune": (tuning.tune, "tune gains on some seeds, judge on others"),
    "export": (export.export, "an observer as C, its gains as JSON and MAT, a run to test it by"),
    "external prepare": (export.prepare, "what every run measures and when, for a program in any language"),
    "external score": (export.score, "estimates made elsewhere, as one more observer"),
    "external run": (export.run, "an observer in Python, one run at a time, on the same draws"),
    "check": (new.check, "check what is your own: observer, plant, controller, study"),
    "cite": (report.cite, "BibTeX of what a study used"),
    "reproduce": (report.reproduce, "what five papers print, against what comes out"),
}
NAMES = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="pcbench",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings=NAMES,
)


def _version(asked: bool) -> None:
    if asked:
        print(f"pcbench {version('pcbench')}")
        raise typer.Exit


@app.callback()
def main_callback(
    asked: Annotated[
        bool, option("say which release this is", "--version", "-V", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Which observer should I use when my measurements are sampled, late, noisy or lost, and how sure am I?

    Begin with: pcbench run quick
    """


_external = typer.Typer(rich_markup_mode=None, context_settings=NAMES)
for name, (function, line) in ALL.items():
    group, _, command = name.rpartition(" ")
    (_external if group else app).command(command, short_help=line)(function)
app.add_typer(
    _external,
    name="external",
    help="Score an observer that lives elsewhere on a study's draws: prepare them, then run it or score its estimates.",
    short_help="observers that live elsewhere, on the same draws",
)
