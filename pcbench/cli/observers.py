"""Commands that look at observers: what there is, and their gains."""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any

import typer

from pcbench.cli.shared import AsJson, Set, app, console, setup
from pcbench.errors import UserError, unknown


@app.command("list")
def list_(
    what: Annotated[str | None, typer.Argument(help="plants, observers, scenarios or studies; default all")] = None,
    as_json: AsJson = False,
) -> None:
    """List what there is.

    Example: pcbench list observers
    """
    from pcbench.catalogue import CATALOGUE

    if what is not None and what not in CATALOGUE:
        raise unknown("list", "kind of thing", what, CATALOGUE)
    chosen = {kind: CATALOGUE[kind]() for kind in ([what] if what else CATALOGUE)}
    if as_json:
        out = {
            kind: {n: dict(zip(heads[1:], cells, strict=True)) for n, cells in rows.items()}
            for kind, (heads, rows) in chosen.items()
        }
        print(json.dumps(out, indent=2))
        return
    from pcbench import show

    for kind, (heads, rows) in chosen.items():
        show.listing(kind, rows, heads, console())


@app.command()
def design(
    scenario: Annotated[str, typer.Argument(help="a scenario's name, or a TOML file")],
    observer: Annotated[str, typer.Argument(help="an observer's name")],
    method: Annotated[
        str | None, typer.Option(help="a way to find gains, e.g. h2 of pccebo [default: its own]")
    ] = None,
    sweep: Annotated[
        str | None, typer.Option(metavar="OPTION=A,B,...", help="the trade-off: what is promised for each of these")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(help="TOML file to write, which can be run; of a trade-off a Parquet file")
    ] = None,
    changes: Set = None,
    as_json: AsJson = False,
) -> None:
    """Find an observer's gains and prove them: the inequality, its margin, the solver, the decay rate promised.

    Example: pcbench design cart/gaussian pccebo --method h2 --sweep decay=0.2,0.5,1,2
    """
    setup()
    from pcbench import designing, machine, show
    from pcbench.dataset import store

    if sweep is not None:
        table = designing.trade_off(scenario, observer, *_values(sweep), method=method, overrides=changes)
        if out is not None:
            place = store.target(out.parent)
            store.make(place)
            store.put_table(place, out.name, show.arrow(table))
        if as_json:
            print(machine.as_json(table.to_dict("records")))
        else:
            show.trade_off(f"{observer} in {scenario}", table, console())
        return
    if out is not None and sweep is None:
        _may_write(out)
    with machine.float64():
        study, cell, found = designing.design(scenario, observer, method=method, overrides=changes)
        text = designing.to_toml(designing.as_study(study, cell, observer, found)) if out is not None else ""
    if out is not None:
        place = store.target(out.parent)
        store.make(place)
        store.put(place, out.name, text.encode())
    if as_json:
        print(machine.as_json({"scenario": scenario, "observer": observer} | found.certificate._asdict()))
    else:
        screen = console()
        screen.print(f"{observer} in {scenario}", style="bold", highlight=False)
        show.gains(found, screen)
        if out is not None:
            screen.print(f"It can be run: pcbench run {out}", highlight=False, markup=False)


def _may_write(out: Path) -> None:
    """Raise UserError where a file stands there that no design has written."""
    try:
        there = out.read_text(encoding="utf-8") if out.is_file() else "[resolved.certificate]"
    except (OSError, ValueError):
        there = ""
    if "[resolved.certificate]" not in there:
        raise UserError(f"--out {out}: holds something else than a design, expected a new file; give another name.")


def _values(text: str) -> tuple[str, list[Any]]:
    """Return the option and the values of OPTION=A,B,...; values are TOML, or plain words."""
    option, equals, given = text.partition("=")
    if not equals or not option.strip() or not given.strip():
        raise UserError(f"--sweep: got '{text}', expected OPTION=A,B,... such as decay=0.2,0.5,1.")
    try:
        values = tomllib.loads(f"values = [{given}]")["values"]
    except tomllib.TOMLDecodeError:
        values = [each.strip() for each in given.split(",")]
    return option.strip(), values
