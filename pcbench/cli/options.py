"""The options that several commands take, and what they mean."""

from typing import Annotated

from pcbench.cli.shared import argument, option

RANK = "steady_rmse"  # what ranks observers unless said otherwise: the error once a run has settled


Json = Annotated[bool, option("print JSON for a program instead of a table", "--json")]
Quiet = Annotated[bool, option("no progress, no table: only where the result is", "--quiet", "-q")]
Set = Annotated[
    list[str] | None,
    option("change the study, e.g. axes.noise_std=0.1 (repeatable)", "--set", metavar="KEY=VALUE"),
]
Folder = Annotated[str, argument("a folder or URI that pcbench run has made")]
Study = Annotated[str, argument("a study, a scenario or a TOML file")]
Scenario = Annotated[str, argument("a scenario's name, or a TOML file")]
Observer = Annotated[str, argument("an observer's name")]
Observers = Annotated[str | None, option("comma-separated names, or all that can run")]
Signals = Annotated[
    str | None,
    option("which signals to show, with commas, or all [default: those a scenario is known by]", "--signal"),
]
Signal = Annotated[str | None, option("of which signal [default: the first of a closing table]")]
Metric = Annotated[str, option("metric that ranks observers: pcbench list metrics")]
Late = Annotated[float | None, option("how late every sample is [s], where the log does not say")]
Start = Annotated[float | None, option("time of the log that is t = 0 [s] [default: its first]")]
