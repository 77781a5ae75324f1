"""The command that writes a file to start from: an observer or a scenario of one's own."""

from pathlib import Path
from typing import Annotated, Literal

import typer

from pcbench.cli.shared import setup
from pcbench.errors import UserError, short

Kind = Literal["observer", "scenario"]
PLACEHOLDER = "NAME"
TEMPLATES = Path(__file__).parent / "templates"
BASE = "cart/white"  # of a scenario to start from
NEXT = {
    "observer": ("pcbench check {file}:{name}", "pcbench run cart/white --observers {file}:{name},dkf"),
    "scenario": ("pcbench run {file}",),
}


def new(
    kind: Annotated[Kind, typer.Argument(help="what to write")],
    name: Annotated[str, typer.Argument(help="its name, and the file's")],
) -> None:
    """Write a file that runs, commented as a lesson, to start from.

    Example: pcbench new observer nudge
    """
    name = name.replace("-", "_") if kind == "observer" else name
    if not name.isidentifier():
        raise UserError(f"new {kind}: got '{short(name)}', expected a name of letters, digits and _; write another.")
    path = Path(f"{name}.py" if kind == "observer" else f"{name}.toml")
    text = _observer(name) if kind == "observer" else _scenario(name)
    try:
        with path.open("x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        raise UserError(f"new {kind}: {path} is there already, expected a new file; give another name.") from None
    except OSError as error:
        raise UserError(f"new {kind}: {path} cannot be written ({error.strerror}); mend that.") from None
    print(f"{path} is written. Next:")
    for command in NEXT[kind]:
        print("  " + command.format(file=path, name=name))


def _observer(name: str) -> str:
    return (TEMPLATES / "observer.py").read_text(encoding="utf-8").replace(PLACEHOLDER, name)


def _scenario(name: str) -> str:
    setup()
    from pcbench.scenarios import SCENARIOS
    from pcbench.study import scenario_toml

    return scenario_toml.as_study(SCENARIOS[BASE]).replace('name = "my-cart-white"', f'name = "{name}"', 1)
