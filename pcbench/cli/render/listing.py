"""What there is, on the screen: a line each, or one thing in full."""

from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.padding import Padding
from rich.text import Text

from pcbench.cli.render.tables import titled
from pcbench.errors import printable

OWN = ("summary", "options", "table", "signals", "unknown", "parameters")  # not said in a line


def lines(title: str, rows: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    """Print named things with what is said of them in a line."""
    table = titled(title)
    table.add_column("name", no_wrap=True)
    table.add_column("what", overflow="fold")
    for name, said in rows.items():
        table.add_row(name, said["summary"])
    console.print(table)


def whole(name: str, said: Mapping[str, Any], console: Console) -> None:
    """Print all that is said of one thing."""
    console.print(Text.assemble((printable(name), "bold"), printable(f": {said['summary']}")))
    for key, value in said.items():
        if key not in OWN and value not in (None, [], {}, ""):
            console.print(f"  {key.replace('_', ' ')}: {words(value)}", highlight=False, markup=False, soft_wrap=False)
    for key in ("signals", "unknown"):
        there = said.get(key)
        for each in there if isinstance(there, list) else []:
            rest = [f"{k.replace('_', ' ')} {v:g}" for k, v in each.items() if k not in ("name", "unit")]
            text = f"  {'signal' if key == 'signals' else 'unknown'} {each['name']} [{each['unit']}]"
            console.print(text + (f": {', '.join(rest)}" if rest else ""), highlight=False, markup=False)
    for key, value in said.get("parameters", {}).items():
        console.print(f"  parameter plant.{key} = {value:g}", highlight=False, markup=False)
    if said.get("options"):
        below = said.get("table", "[options.NAME]")
        console.print(f"  options, which a study sets below {below}:", highlight=False, markup=False)
        _options(said["options"], console)


def _options(options: Mapping[str, Mapping[str, Any]], console: Console) -> None:
    """Print each option with its type, range and default, and below it what it is."""
    for name, o in options.items():
        choices = " | ".join(map(str, o.get("choices", ())))
        kind = choices or " ".join(filter(None, (o["type"], o["range"])))
        can = ", can be tuned" if o["tunable"] else ""
        console.print(
            f"  {name}: {kind}, default {words(o['default'])}{can}", style="bold", highlight=False, markup=False
        )
        console.print(Padding(o["description"], (0, 0, 0, 6)), highlight=False)


def words(value: Any) -> str:
    """Return a value as a person writes it."""
    if value is None or value == {}:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{k} {words(v)}" for k, v in value.items())
    if isinstance(value, list | tuple):
        each = [f"[{words(v)}]" if isinstance(v, list) else words(v) for v in value]
        return each[0] if len(set(each)) == 1 and len(each) > 1 and not isinstance(value[0], str) else ", ".join(each)
    return str(value)
