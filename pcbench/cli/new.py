"""The command that writes files to start from: an observer, a plant, a controller or a scenario of one's own."""

import os
from pathlib import Path
from typing import Annotated, Literal

import typer

from pcbench.cli.shared import setup
from pcbench.errors import UserError, short

Kind = Literal["observer", "plant", "controller", "scenario"]
PLACEHOLDER = "NAME"
TEMPLATES = Path(__file__).parent / "templates"
BASE = "cart/white"  # of a scenario to start from
FILES = {"observer": (".py",), "plant": (".py", ".toml"), "controller": (".py",), "scenario": (".toml",)}
NEXT = {
    "observer": ("pcbench check {name}.py:{name}", "pcbench run cart/white --observers {name}.py:{name},kf"),
    "plant": ("pcbench check {name}.py:{name}", "pcbench check {name}.toml", "pcbench run {name}.toml"),
    "controller": (
        "pcbench check {name}.py:{name} --set period=0.02",
        "pcbench run cart/white --set controller.use={name}.py:{name}",
    ),
    "scenario": ("pcbench check {name}.toml", "pcbench run {name}.toml"),
}


def new(
    kind: Annotated[Kind, typer.Argument(help="what to write")],
    name: Annotated[str, typer.Argument(help="its name, and the file's")],
) -> None:
    """Write a file that runs, commented as a lesson, to start from; for a plant also the study that runs it.

    Example: pcbench new observer nudge
    """
    name = name if kind == "scenario" else name.replace("-", "_")
    if not name.isidentifier():
        raise UserError(f"new {kind}: got '{short(name)}', expected a name of letters, digits and _; write another.")
    paths = [Path(name + suffix) for suffix in FILES[kind]]
    for path in paths:
        if os.path.exists(path):  # unlike the path's own, it answers for a name that is too long
            raise UserError(f"new {kind}: {path} is there already, expected a new file; give another name.")
    for path in paths:
        try:
            with path.open("x", encoding="utf-8") as file:
                file.write(_scenario(name) if kind == "scenario" else _lesson(kind + path.suffix, name))
        except OSError as error:
            raise UserError(f"new {kind}: {path} cannot be written ({error.strerror}); mend that.") from None
    print(f"{' and '.join(map(str, paths))} {'are' if len(paths) > 1 else 'is'} written. Next:")
    for command in NEXT[kind]:
        print("  " + command.format(name=name))


def _lesson(template: str, name: str) -> str:
    return (TEMPLATES / template).read_text(encoding="utf-8").replace(PLACEHOLDER, name)


def _scenario(name: str) -> str:
    setup()
    from pcbench.scenarios import SCENARIOS
    from pcbench.study import scenario_template

    return scenario_template.as_study(SCENARIOS[BASE]).replace('name = "my-cart-white"', f'name = "{name}"', 1)
