"""The commands `list` and `show`."""

import json
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated

from pcbench.cli.options import Json, Set
from pcbench.cli.shared import argument, console, option, require_effect, say, write
from pcbench.errors import UserError, printable

if TYPE_CHECKING:
    from pcbench.cli.catalogue import Description
    from pcbench.cli.render.tables import Screen

IN_FULL = ("summary", "options", "table", "signals", "unknown", "parameters")  # keys that have their own lines
LABELS = {"knows_schedule": "perfect start"}  # printed name of a key, if it differs


def list_(
    what: Annotated[
        str | None,
        argument(
            "Kind: observers, scenarios, plants, controllers, studies, axes, metrics or choices [default: the first five]"
        ),
    ] = None,
    name: Annotated[
        str | None, argument("Name, or MODULE:NAME of your own, to show with all options and ranges [default: a list]")
    ] = None,
    as_json: Json = False,
) -> None:
    """List observers, scenarios, plants and other kinds, or show one of them with its options.

    Example: pcbench list observers pccebo
    """
    from pcbench.cli.catalogue import DEFAULT_KINDS, TITLES, list_catalogue
    from pcbench.cli.render.tables import Column

    kinds = {kind: list_catalogue(kind, name) for kind in ([what] if what is not None else DEFAULT_KINDS)}
    if as_json:
        print(json.dumps(kinds, indent=2))
        return
    screen = console()
    if what is not None and name is not None:
        print_in_full(name, kinds[what][name], screen)
        return
    for kind, members in kinds.items():
        summaries = [description["summary"] for description in members.values()]
        columns = [Column("name", list(members), is_text=True), Column("description", summaries, prose=True)]
        screen.fit(TITLES.get(kind, kind), columns)
    kind = what or "observers"
    screen.print(f"Show one of them with all details: pcbench list {kind} {next(iter(kinds[kind]))}")
    if what is None:
        screen.print("Show other lists: pcbench list axes, pcbench list metrics, pcbench list choices")


def show(
    scenario: Annotated[str, argument("Name of a scenario, or TOML file")],
    as_toml: Annotated[bool, option("Print a study file with all fields and their units", "--toml")] = False,
    with_costs: Annotated[
        bool,
        option("Show each observer's multiplications per sample and per tick, and its bytes of memory", "--operations"),
    ] = False,
    changes: Set = None,
    as_json: Json = False,
) -> None:
    """Describe a scenario, or print it as a study file to edit.

    Example: pcbench show cart/white --toml > mine.toml
    """
    from pcbench.cli import catalogue
    from pcbench.study import observers_of, parse, scenario_template
    from pcbench.study.load import raw_of

    if as_toml and as_json:
        raise UserError("show: got --toml and --json, expected one of them; leave one out.")
    if with_costs:
        require_effect({"--toml": as_toml}, "with --operations", "leave one of them out")
        _costs(scenario, changes, as_json)
        return
    study = parse.outline(scenario, changes or [])
    if parse.names_all(raw_of(scenario, changes or [], parse.FROM_HERE)):
        from pcbench.planning import all_observers  # imports jax: gains are designed

        study = all_observers.outline(scenario, changes or [])
        say(*all_observers.sentences(study.excluded))
    s = parse.scenario_in(study, scenario)
    if as_toml:
        template = s._replace(observers=tuple(observers_of(study, s.name)))
        write(scenario_template.as_study(template, study.axes, study.options))
    elif as_json:
        print(json.dumps({s.name: catalogue.scenario(s, study)}, indent=2))
    else:
        screen = console()
        print_in_full(s.name, catalogue.scenario(s, study), screen)
        end = f"Write it as a study file with all fields: pcbench show {scenario} --toml > mine.toml"
        if s.plant == "lti" or s.user_code:
            end = f"This is your own study: edit {scenario}, then pcbench run {scenario}"
        screen.say(end)


def _costs(study: str, changes: list[str] | None, as_json: bool) -> None:
    """Print the operation counts of the observers of a scenario or a study."""
    from pcbench import api
    from pcbench.cli.render.results import COSTS
    from pcbench.cli.render.tables import Column
    from pcbench.planning import all_observers

    table = api.operation_counts(study, overrides=changes)
    say(*all_observers.sentences(table.attrs["excluded"]))
    if as_json:
        print(table.to_json(orient="records", indent=2))
        return
    screen = console()
    columns = [Column(name, table[name].to_list(), is_text=True) for name in ("scenario", "observer")]
    cells = [Column("grid point", [str(v) for v in table.cell])] if table.cell.nunique() > 1 else []
    counts = [Column(name, [f"{v:,}" for v in table[name]]) for name in ("sample", "tick", "memory")]
    if "computing_time" in table:
        counts += [Column("computing time [s]", [f"{v:.3g}" for v in table.computing_time])]
        counts += [Column("one used of", [str(v) for v in table.stride])]
    screen.fit(f"operations of {study}", [*columns, *cells, *counts])
    screen.print(COSTS)


def print_in_full(name: str, description: "Description", screen: "Screen") -> None:
    """Print a description with all its keys."""
    from rich.padding import Padding
    from rich.text import Text

    screen.print(Text.assemble((printable(name), "bold"), printable(f": {description['summary']}")))
    for key, value in description.items():
        if key not in IN_FULL and value not in (None, [], {}, ""):
            screen.print(f"  {LABELS.get(key, key).replace('_', ' ')}: {words(value)}")
    for key, word in (("signals", "signal"), ("unknown", "unknown")):
        signals = description.get(key)
        for signal in signals if isinstance(signals, list) else []:
            limits = [f"{k.replace('_', ' ')} {v:g}" for k, v in signal.items() if k not in ("name", "unit")]
            text = f"  {word} {signal['name']} [{signal['unit']}]"
            screen.print(text + (f": {', '.join(limits)}" if limits else ""))
    for key, value in description.get("parameters", {}).items():
        screen.print(f"  parameter plant.{key} = {value:g}")
    options = description.get("options") or {}
    if options:
        screen.print(f"  options, set in the table {description.get('table', '[options.NAME]')} of a study:")
    for key, o in options.items():
        kind = " | ".join(map(str, o.get("choices", ()))) or " ".join(filter(None, (o["type"], o["range"])))
        tunable = ", tunable" if o["tunable"] else ""
        screen.print(f"  {key}: {kind}, default {words(o['default'])}{tunable}", style="bold")
        screen.print(Padding(o["description"], (0, 0, 0, 6)))


def words(value: object) -> str:
    """Return a value as text."""
    if value is None or value == {}:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{k} {words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        texts = [f"[{words(v)}]" if isinstance(v, list) else words(v) for v in value]
        is_repeated = len(texts) > 1 and len(set(texts)) == 1 and not isinstance(value[0], str)
        return texts[0] if is_repeated else ", ".join(texts)
    return str(value)
