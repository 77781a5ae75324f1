"""Options that several commands share."""

from typing import Annotated, Literal

from pcbench.cli.shared import argument, option

RANK = "steady_rmse"  # the default metric: the error after the initial transient


Json = Annotated[bool, option("Print JSON instead of a table", "--json")]
Quiet = Annotated[bool, option("Print only the path of the result: no progress, no table", "--quiet", "-q")]
Set = Annotated[
    list[str] | None,
    option("Change of the study, such as axes.noise_std=0.1 (repeatable)", "--set", metavar="KEY=VALUE"),
]
Folder = Annotated[str, argument("Folder or URI of a result of pcbench run")]
DrawsFolder = Annotated[str, argument("Folder that pcbench external prepare has written")]
PageFolder = Annotated[str, argument("Folder or URI of a result of pcbench run, or of pcbench replay")]
Study = Annotated[str, argument("Study, scenario or TOML file")]
Scenario = Annotated[str, argument("Name of a scenario, or TOML file")]
Observer = Annotated[str, argument("Name of an observer")]
Observers = Annotated[str | None, option("Comma-separated names of observers, or all (that support the study)")]
Signals = Annotated[
    str | None,
    option("Comma-separated signals to show, or all [default: the main signals of each scenario]", "--signal"),
]
Signal = Annotated[str | None, option("Signal [default: the first of a closing table]")]
Metric = Annotated[str, option("Metric that ranks observers (see pcbench list metrics)")]
Late = Annotated[float | None, option("Delay of every measurement [s], for a recording without arrival times")]
Start = Annotated[float | None, option("Time of tick 0 in the recording [s] [default: its first time]")]
Journal = Literal["ieee", "elsevier", "elsevier-1p"]  # the keys of plots.JOURNALS
