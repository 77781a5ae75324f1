"""The command that finds gains and proves them."""

from pathlib import Path
from typing import Annotated, Any

import typer

from pcbench import toml_text
from pcbench.cli.options import AsJson, Observer, Scenario, Set, out
from pcbench.cli.shared import console, setup
from pcbench.errors import UserError


def design(
    scenario: Scenario,
    observer: Observer,
    gain: Annotated[str | None, typer.Option(help="a way to find gains, e.g. h2 of pccebo [default: its own]")] = None,
    sweep: Annotated[
        str | None, typer.Option(metavar="OPTION=A,B,...", help="the trade-off: what is promised for each of these")
    ] = None,
    file: Annotated[
        str | None, out("TOML file to write, which can be run; of a trade-off a .parquet or .csv file")
    ] = None,
    changes: Set = None,
    as_json: AsJson = False,
) -> None:
    """Find an observer's gains and prove them: the inequality, its margin, the solver, the decay rate promised.

    Example: pcbench design cart/gaussian pccebo --gain h2 --sweep decay=0.2,0.5,1,2
    """
    setup()
    import pyarrow as pa

    from pcbench.cli.render import gains
    from pcbench.cli.render.tables import readable
    from pcbench.dataset import storage, write_table
    from pcbench.gains import design
    from pcbench.runtime import config
    from pcbench.synthesis.certificate import is_certified

    if sweep is not None:
        if file is not None:
            write_table.kind_of(file)
        table = design.trade_off(scenario, observer, *_values(sweep), gain=gain, overrides=changes)
        if file is not None:
            write_table.put(file, pa.Table.from_pandas(table, preserve_index=False))
        if as_json:
            print(readable(table.to_dict("records")))
        else:
            gains.trade_off(f"{observer} in {scenario}", table, console())
        return
    if file is not None:
        _may_write(Path(file))
    with config.float64():
        study, cell, found = design.design(scenario, observer, gain=gain, overrides=changes)
        text = design.to_toml(design.as_study(study, cell, observer, found)) if file is not None else ""
    if file is not None:
        target = storage.target(Path(file).parent)
        storage.make(target)
        storage.put(target, Path(file).name, text.encode())
    if as_json:
        fields = found.certificate._asdict()
        print(readable({"scenario": scenario, "observer": observer, "certified": is_certified(fields)} | fields))
    else:
        screen = console()
        screen.print(f"{observer} in {scenario}", style="bold")
        gains.gains(found, screen)
        if file is not None:
            screen.say(f"Now run it: pcbench run {file}")


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
        values = toml_text.parse(f"values = [{given}]")["values"]
    except ValueError:
        values = [each.strip() for each in given.split(",")]
    return option.strip(), values
