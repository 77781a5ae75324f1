"""The command that says what there is."""

import json
from typing import Annotated

import typer

from pcbench.cli.shared import AsJson, Set, console, require_effect, say, write


def list_(
    what: Annotated[
        str | None,
        typer.Argument(
            help="observers, scenarios, plants, controllers, studies, axes, metrics or choices [default: the first five]"
        ),
    ] = None,
    name: Annotated[
        str | None, typer.Argument(help="one of them, or MODULE:NAME of your own, in full: with options and ranges")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """List what there is, or one thing in full.

    Example: pcbench list observers pccebo
    """
    from pcbench.cli.catalogue import TITLES, WITHOUT_WORD, found
    from pcbench.cli.render import listing

    said = {kind: found(kind, name) for kind in ([what] if what is not None else WITHOUT_WORD)}
    if as_json:
        print(json.dumps(said, indent=2))
    elif what is not None and name is not None:
        listing.whole(name, said[what][name], console())
    else:
        for kind, rows in said.items():
            listing.lines(TITLES.get(kind, kind), rows, console())
        kind = what or "observers"
        console().print(
            f"One of them in full: pcbench list {kind} {next(iter(said[kind]))}", highlight=False, markup=False
        )
        if what is None:
            console().print("There are also: pcbench list axes, metrics, choices", highlight=False, markup=False)


def show(
    scenario: Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")],
    as_toml: Annotated[
        bool, typer.Option("--toml", help="print it as a study file to start from, every field with its unit")
    ] = False,
    with_costs: Annotated[
        bool,
        typer.Option(
            "--operations", help="what its observers cost: multiplications a sample and a tick, bytes of memory"
        ),
    ] = False,
    changes: Set = None,
    as_json: AsJson = False,
) -> None:
    """Say all that a scenario is, or print it as a study of your own.

    Example: pcbench show cart/white --toml > mine.toml
    """
    from pcbench.cli.catalogue import sheet
    from pcbench.cli.render import listing
    from pcbench.errors import UserError
    from pcbench.study import observers_of, parse, scenario_template
    from pcbench.study.load import raw_of

    if as_toml and as_json:
        raise UserError("show: got --toml and --json, expected one of them; leave one out.")
    if with_costs:
        require_effect(
            {"--toml": as_toml}, "with --operations", "a study file, or what its observers cost; leave one out"
        )
        _costs(scenario, changes, as_json)
        return
    study = parse.outline(scenario, changes or [])
    if parse.names_all(raw_of(scenario, changes or [], parse.FROM_HERE)):
        from pcbench.planning import all_observers  # with jax: gains are designed

        study = all_observers.outline(scenario, changes or [])
        _say_excluded(study.excluded)
    found = parse.scenario_in(study, scenario)
    if as_toml:
        mine = found._replace(observers=tuple(observers_of(study, found.name)))
        write(scenario_template.as_study(mine, study.axes, study.options))
    elif as_json:
        print(json.dumps({found.name: sheet(found, study)}, indent=2))
    else:
        listing.whole(found.name, sheet(found, study), console())
        end = f"As a study of your own, every field of it: pcbench show {scenario} --toml > mine.toml"
        if found.plant == "lti" or found.own:
            end = f"It is a study of your own: edit {scenario}, then pcbench run {scenario}"
        console().print(end, highlight=False, markup=False, soft_wrap=True)


def _say_excluded(excluded: dict[str, str] | None) -> None:
    from pcbench.planning import all_observers

    for sentence in all_observers.sentences(excluded):
        say(sentence)


def _costs(study: str, changes: list[str] | None, as_json: bool) -> None:
    """Print what the observers of a scenario or a study cost."""
    from pcbench import api

    table = api.operation_counts(study, overrides=changes)
    _say_excluded(table.attrs["excluded"])
    if as_json:
        print(table.to_json(orient="records", indent=2))
        return
    shown = table[["scenario", "cell", "observer", "sample", "tick", "memory"]]
    console().print(shown.to_string(index=False), highlight=False, markup=False)
    console().print(
        "sample, tick: multiplications of one run; memory: bytes from tick to tick.", highlight=False, markup=False
    )
