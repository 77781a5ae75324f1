"""The commands of the command line, in the order of a typical workflow."""

from collections.abc import Callable
from importlib.metadata import version
from typing import Annotated

import typer

from pcbench.cli import export, lists, new, recordings, report, runs, tuning
from pcbench.cli.shared import option

ALL: dict[str, tuple[Callable[..., None], str]] = {  # by name: the function, and a line of help, 62 characters at most
    "list": (lists.list_, "List observers, scenarios, plants, studies, metrics and more"),
    "guide": (new.guide, "Print a page of the guide, or the list of its pages"),
    "show": (lists.show, "Describe a scenario, or print it as a study file"),
    "new": (new.new, "Create a template of your own code, or copy a recording"),
    "run": (runs.run, "Run a study and write its tables to a folder"),
    "report": (report.report, "Write the results as one HTML page, or as figures"),
    "tables": (report.tables, "Print tables for a paper as LaTeX, Markdown or CSV"),
    "find-limit": (runs.find_limit, "Find the largest period, delay or noise for an error limit"),
    "simulate": (runs.simulate, "Simulate one run and write it tick by tick"),
    "info": (recordings.info, "Show the rates, gaps and delays of a recording"),
    "convert": (recordings.convert, "Make a slow, delayed recording from a fast one"),
    "replay": (recordings.replay, "Run observers on a recording"),
    "status": (runs.status, "Show how many runs of a study are complete"),
    "verify": (runs.verify, "Check every file, and compute some runs again"),
    "merge": (runs.merge, "Merge several datasets of one study"),
    "compare": (runs.compare, "Compare two results of one study"),
    "design": (tuning.design, "Compute gains and their certificate"),
    "tune": (tuning.tune, "Tune gains on some seeds, and test them on others"),
    "export": (export.export, "Export an observer as C, with its gains and a test run"),
    "external prepare": (export.prepare, "Write the measurements of all runs for another program"),
    "external score": (export.score, "Add the estimates of another program to a study's tables"),
    "external run": (export.run, "Run your own Python object on the same measurements"),
    "check": (new.check, "Check your own observer, plant, controller or study"),
    "cite": (report.cite, "Print BibTeX of the sources that a study used"),
    "reproduce": (report.reproduce, "Compare published claims and numbers with pcbench's results"),
}
NAMES = {"help_option_names": ["-h", "--help"]}

app = typer.Typer(
    name="pcbench", no_args_is_help=True, pretty_exceptions_enable=False, rich_markup_mode=None, context_settings=NAMES
)


def _version(value: bool) -> None:
    if value:
        print(f"pcbench {version('pcbench')}")
        raise typer.Exit


@app.callback()
def main_callback(
    show_version: Annotated[
        bool, option("Print the version and exit", "--version", "-V", callback=_version, is_eager=True)
    ] = False,
) -> None:
    """Compare state observers for measurements that are sampled, delayed, noisy or lost, with statistical significance.

    Start with: pcbench run quick
    """


_external = typer.Typer(rich_markup_mode=None, context_settings=NAMES)
for name, (function, line) in ALL.items():
    group, _, command = name.rpartition(" ")
    (_external if group else app).command(command, short_help=line)(function)
app.add_typer(
    _external,
    name="external",
    help="Compare an observer outside pcbench on the measurements of a study: prepare them, then run it or score "
    "its estimates.",
    short_help="Compare an observer outside pcbench on the same measurements",
)
