"""The guide's reference pages, made from the records of the code.

python tests/support/reference_pages.py     writes them again
"""

import inspect
import re
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import NoneType
from typing import Any, Literal, get_args, get_origin

from pydantic import BaseModel
from typer.models import OptionInfo

import pcbench
from pcbench.cli import commands
from pcbench.cli.catalogue import TAKES, list_catalogue, options, plant
from pcbench.cli.lists import words
from pcbench.controllers import CONTROLLERS
from pcbench.dataset import columns
from pcbench.fields import FIELDS
from pcbench.observers import OBSERVERS
from pcbench.planning import plan
from pcbench.plants import PLANTS, output_units
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS
from pcbench.scenarios.signals import SIGNALS
from pcbench.scenarios.sources import SHAPES
from pcbench.statistics import RUN_METRICS
from pcbench.study import parse
from pcbench.study.axes import AXES, CHANNELS, COMMANDS, OUTPUTS, STATES
from pcbench.study.controller_table import Network
from pcbench.study.lti_plant import LtiTable, PlantDeviations
from pcbench.study.scenario_schema import Experiment, ScenarioTable
from pcbench.study.scenario_template import toml_value
from pcbench.study.schema import Choices, Study, Tune, TunedCell, TunedOptions
from pcbench.synthesis.certificate import NO_GAIN, is_certified

GUIDE = Path(pcbench.__file__).parent / "guide"
SOURCE = "The script `tests/support/reference_pages.py` generates this page from the code."
AXIS = [*(a for a in AXES if a not in STATES), *STATES, *COMMANDS]
ALWAYS = {"diverged": "bool in runs, int64 in stats", "seed": "int64"}
LABELS = {  # of facts whose name in `pcbench list` is too short for a page
    "c_export": "export to C",
    "covariance": "a covariance",
    "needs_sampling_signal": "needs a signal when a sample is taken",
    "exact_moments": "exact moments on linear plants",
    "tunes_by_gradient": "gradients for `pcbench tune`",
    "innovations": "innovations (`nis`)",
    "bounds": "bounds of the state (`interval_width`)",
    "knows_schedule": "no error from a true start, with a true model and no noise",
    "uses_stated_variance": "uses the variance of each measurement in a recording",
    "samples": "accepted samples",
}
EMPTY: tuple[object, ...] = (None, "", [], {})
SHARED = "Shared options"
SEVERAL = 3  # observers that have an option, from which on it is described once
Description = Mapping[str, Any]


def page(title: str, lead: str, *parts: str) -> str:
    """A page of the guide."""
    return "\n\n".join([f"# {title}", lead, *parts, SOURCE]) + "\n"


def join(lines: Iterable[str]) -> str:
    return "\n".join(lines)


def sentence(text: str) -> str:
    """A phrase of a record as a sentence; a symbol stays as it is."""
    first = text[:1] if text.split()[0] in ("e", "u") else text[:1].upper()
    return first + text[1:] + ("" if text.endswith(".") else ".")


def entry(name: str, about: str, description: Description, without: Iterable[str] = ()) -> str:
    """A heading with what a record says below it: a sentence, and a line for each fact; what is true in one line."""
    facts = {key: v for key, v in description.items() if key not in ("summary", *without) and v not in EMPTY}
    named = {key if "`" in key else LABELS.get(key, key.replace("_", " ")): v for key, v in facts.items()}
    lines = [f"- {label}: {words(v)}" for label, v in named.items() if not isinstance(v, bool)]
    has = "; ".join(label for label, v in named.items() if v is True)
    return "\n".join([f"## `{name}`\n", f"{sentence(about)}\n", *lines, *([f"- has: {has}"] if has else [])])


def option(name: str, described: Description) -> str:
    """A line of an option or a key."""
    first, *others = described["type"].split(" or ")
    kind = [" ".join(filter(None, [first, described.get("range")])), *others]
    kind = [f'"{each}"' for each in described.get("choices", kind)] if "choices" in described else kind
    default = described["default"]
    facts = ["" if kind == ["value"] else " or ".join(kind), "required" if described.get("required") else ""]
    facts += [f"default {toml_value(default)}"] if default not in EMPTY and not isinstance(default, dict) else []
    head = ", ".join(filter(None, [*facts, "can be tuned" if described["tunable"] else ""]))
    about = described["description"]
    return f"- `{name}`" + (f" ({head})" if head else "") + (f": {about}" if about else "")


def keys(model: type[BaseModel], without: Iterable[str] = ()) -> str:
    """The keys of a table of a study file, a line each."""
    return "\n".join(option(name, each) for name, each in options(model).items() if name not in without)


def shared_options(every: Mapping[str, Description]) -> tuple[list[str], dict[str, list[str]]]:
    """The lines of options that several have, and by name those of its own, with the names of the others last."""
    lines = {name: {key: option(key, each) for key, each in o["options"].items()} for name, o in every.items()}
    many = Counter(line for mine in lines.values() for line in mine.values())
    shared = [line for line, count in many.items() if count >= SEVERAL]
    own = {name: [line for line in mine.values() if line not in shared] for name, mine in lines.items()}
    for name, mine in lines.items():
        if common := ", ".join(f"`{key}`" for key, line in mine.items() if line in shared):
            own[name].append(f"- {common}: see [{SHARED}](#{SHARED.lower().replace(' ', '-')})")
    return shared, own


def column(name: str) -> str:
    """A line of a column."""
    (field,) = columns.table({name: [None]}).schema
    about = {key.decode(): text.decode() for key, text in field.metadata.items()}
    several = name in (*CHANNELS, *STATES, *OUTPUTS, "delay_self_transition")
    kind = ALWAYS.get(name, "double or list of double" if several else str(field.type))
    unit = f", in {about['unit']}" if about.get("unit", "1") != "1" else ""
    return f"- `{name}` ({kind}{unit}): {about['meaning']}"


def orders() -> dict[str, list[str]]:
    """The columns of each table but the axes, in order."""
    runs = ["study", "scenario", "observer", "cell", "seed", "signal", "unit", "predicts_unknown_input"]
    return {
        "runs/": [*runs, *RUN_METRICS, "status", "diverged", "divergence_time"],
        "stats.parquet": columns.stats_order([]),
        "pairs.parquet": columns.pairs_order([]),
    }


def columns_page() -> str:
    known, parts = set(), []
    for title, names in orders().items():
        again = ", ".join(f"`{name}`" for name in names if name in known)
        above = f"Columns as above: {again}, and `<axes>` after `cell`." if again else "`<axes>` follow `cell`."
        parts += [f"## {title}", above, "\n".join(column(name) for name in names if name not in known)]
        known |= set(names)
    lead = f"""Look up the columns of a study's Parquet files here, with their types, units and meanings.

Each file's metadata contains the number of its schema (`pcbench.schema`, {columns.SCHEMA} in this release), and the meaning and
unit of each column. The number changes if a column is added or removed, or changes its meaning. The columns `<axes>` are those
of the last table that a scenario has, in that order. In `runs`, the names of the folders contain `scenario` and `observer`."""
    parameter = "- `plant.<parameter>` (double): the plant's parameter at this grid point, if the study varies it"
    return page("Columns of the tables", lead, *parts, "## Axes", "\n".join([*map(column, AXIS), parameter]))


def command_parts() -> Iterator[str]:
    """Every command: what it does, how it is called, an example, its arguments and options."""
    for name, (function, _) in commands.ALL.items():
        about, _, examples = (inspect.getdoc(function) or "").partition("\n\nExample")
        shown = [one for one in re.split(r";\s+|\n", re.sub(r"Example: |^s?: ", "", examples)) if one]
        arguments, lines = [], []
        for p in inspect.signature(function, eval_str=True).parameters.values():
            called, line = parameter(p)
            lines.insert(len(arguments) if called else len(lines), line)
            arguments += [called] if called else []
        yield f"## pcbench {name}"
        yield sentence(" ".join(about.split()))
        yield f"Usage: `{' '.join(['pcbench', name, *arguments, '[OPTIONS]'])}`"
        yield "Example: " + " and ".join(f"`{one}`" for one in shown)
        yield join(lines)


def parameter(p: inspect.Parameter) -> tuple[str, str]:
    """How an argument of a command is called (of an option nothing), and the line of an argument or an option."""
    kind, info = get_args(p.annotation)[:2]
    inner = next((arg for arg in get_args(kind) if arg is not NoneType), kind)
    choices = f" ({', '.join(get_args(kind))})" if get_origin(kind) is Literal else ""
    required = p.default is p.empty
    facts = ["required"] if required else [f"default {words(p.default)}"] if p.default not in (*EMPTY, False) else []
    if isinstance(info, OptionInfo):
        called = info.metavar or {int: "INTEGER", float: "NUMBER", bool: "", Path: "PATH"}.get(inner, "TEXT")
        declared = [name for name in (info.default, *(info.param_decls or ())) if str(name).startswith("-")]
        names = ", ".join(f"`{n}`" for n in sorted(declared or [f"--{p.name.replace('_', '-')}"], key=len))
        head = ", ".join([*([f"`{called}`"] if called else []), *facts])
        return "", f"- {names}{f' ({head})' if head else ''}: {info.help}{choices}"
    called, head = (info.metavar or p.name.upper()).strip("[]"), f" ({facts[0]})" if facts else ""
    return called if required else f"[{called}]", f"- `{called}`{head}: {info.help}{choices}"


def commands_page() -> str:
    lead = """Look up a command here, with its arguments, options and an example. `pcbench COMMAND --help` prints the same.

The exit code is 0 if a command succeeds, 1 if a check fails, 2 if the input has a mistake, 130 after Ctrl-C, and 143 after
SIGTERM. `pcbench --version` prints the release."""
    return page("Commands", lead, *command_parts())


def study_keys_page() -> str:
    tables = ("axes", "options", "lti", "scenario", "tables", "controller", "tune", "tuned", "excluded")
    laws = {name: law for name, law in list_catalogue("controllers").items() if CONTROLLERS[name].check}
    shared, own = shared_options(laws)
    parts = [f"### {law}\n\n{sentence(laws[law]['summary'])}\n\n{join(lines)}" for law, lines in own.items()]
    names = ", ".join(f"`{name}`" for name in SIGNALS)
    waves = " or ".join(f'"{name}"' for name in SHAPES)
    own_keys = keys(ScenarioTable, {*Experiment.model_fields, *(f.name for f in FIELDS)})
    body = f"""Look up the keys of a study file (TOML) here, with type, range, default and meaning. Times are in seconds,
and all other numbers in SI units. You can write `-` instead of `_` in a key.

Sizes are in brackets: n states, m inputs, q outputs, r unknown inputs.

## Top level

{keys(Study, tables)}

## [axes]

One list of values per axis. See [Axes](axis_list.md).

## [observers.NAME]

One table per observer, instead of the list `observers`. NAME is the label in tables and figures. A built-in observer is
selected by NAME: `kf`, or a label that begins with `kf-`. Other keys are the observer's options:

- `use` (text): MODULE:NAME of your own observer. For a built-in observer you can leave it out

## [options.OBSERVER]

Options by observer or label, for observers from a list. See [Observers](observers.md).

## [options.scenario]

{keys(Choices)}

## [scenario] and [lti]

Both tables have the keys below. [Axes](axis_list.md) lists the axes that are keys too.

{keys(Experiment)}

`input` and `unknown_input` accept one of these:

- a name, or one name per input with commas: {names}
- a table such as `{{signal = "sine", amplitude = 2.0, frequency = 0.5}}`, or a list of these with one per input. `signal` is
  {waves}. Other keys are `offset`, `phase` [rad] and `unit`
- a list with one value per tick, or rows `[t, u1, ...]`, each held until the next
- the name of a CSV file with the columns `t,u1,...`

## [scenario]

Write `[scenarios.NAME]` for several scenarios in one file.

{own_keys}

## [lti]

The axes `sampling_period`, `delay` and `noise_std` are required.

{keys(LtiTable)}

## [lti.plant]

You can also set any of the parameters by name.

{keys(PlantDeviations)}

## [controller]

The other keys are options of the law.

{keys(Network)}"""
    rest = [f"## [tune]\n\n{keys(Tune)}", "## [tuned]\n\npcbench writes this table into the `study.toml` of a result."]
    rest += [keys(TunedOptions), f"## [[tuned.cells]]\n\n{keys(TunedCell)}"]
    return page("Keys of a study file", body, *parts, f"### {SHARED}", join(shared), *rest)


def axis_list_page() -> str:
    lead = """Look up an axis here, with its unit, its values and the tables of a study file that accept it. To vary an axis,
see [Sweep period, delay, jitter and loss](axes.md)."""
    parameter = "## `plant.PARAMETER`\n\nA parameter of the true plant. Observers keep the nominal value.\n\n"
    parameter += "\n".join(
        f"- {name}: " + ", ".join(f"`plant.{p}`" for p in plant(each)["parameters"]) for name, each in PLANTS.items()
    )
    return page("Axes", lead, *(entry(n, d["summary"], d) for n, d in list_catalogue("axes").items()), parameter)


def metrics_page() -> str:
    lead = """Look up a metric here, with its unit, its best value and the observers that have it. The error of a signal is
e = x - xhat, at the ticks 0 to N-1. To read the tables, see [Read the tables and the report](results.md)."""
    return page("Metrics", lead, *(entry(n, d["summary"], d) for n, d in list_catalogue("metrics").items()))


def certificates() -> dict[str, str]:
    """What is certified of each observer, at a grid point that it accepts."""
    places = {
        "lmi-sampled": "ncs-two-state/held",
        "high-gain": "helicopter/constant",
        "smo": "arm/sampled",
        "pio": "arm/sampled",
    }
    asked: dict[str, list[str]] = {}
    for name in OBSERVERS:
        asked.setdefault(places.get(name, "cart/gaussian"), []).append(name)
    found = {}
    with config.float64():
        for scenario, names in asked.items():
            (planned,) = plan(parse.grid_of(scenario, {"observers": names}, []).study)
            found |= planned.certificates
    names = {NO_GAIN: "not needed, because there is no gain"}
    return {
        name: names.get(c.inequality, c.inequality if is_certified(c._asdict()) else f"no, {c.inequality[6:]}")
        for name, c in found.items()
    }


def observers_page() -> str:
    every, proofs = list_catalogue("observers"), certificates()
    shared, own = shared_options(every)
    rows = ["| observer | schedules | covariance | certificate | exact | C |", "|---|---|---|---|---|---|"]
    parts = []
    for name, o in every.items():
        proof = {"no,": "no", "not": "-"}.get(proofs[name].split()[0], "yes")
        facts = [words(o["covariance"]), proof, words(o["exact_moments"]), words(o["c_export"])]
        rows.append(f"| `{name}` | {OBSERVERS[name].takes} | {' | '.join(facts)} |")
        about = f"{o['method']}. {o['update']}"
        parts.append(entry(name, about, o | {"certificate": proofs[name]}, ("method", "update", "options")))
        parts += [f"Options, in `[options.{name}]`:", join(own[name])] if own[name] else []
    lead = """Look up an observer here, with its source, its assumptions, the samples it accepts and its options. To decide
between them, see [Choose an observer](choose_an_observer.md). `pcbench replay` accepts every observer.

The table shows which observers report a covariance, have a certificate for their gains, have
exact moments on linear plants, and can be exported to C. See [Exact moments instead of Monte Carlo](exact_evaluation.md) and
[Export C code, and use external estimators](export_to_c.md). The column *schedules* names
the accepted samples:"""
    takes = [f"- *{name}*: {text}" for name, text in TAKES.items()]
    return page("Observers", lead, join(takes), join(rows), *parts, f"## {SHARED}", join(shared))


def scenarios_page() -> str:
    def named(key: str) -> str:
        return f"`{key}`" if key in ScenarioTable.model_fields else key.replace("_", " ")

    units = {f.name: f" [{f.unit}]" for f in FIELDS if f.unit not in ("", "1")}
    units |= dict.fromkeys(("tick", "duration", "steady_start"), " [s]")
    omitted = ("summary", "source", "plant", "signals", "axes", "observer_options", "headline")
    parts = []
    for name, s in list_catalogue("scenarios").items():
        signals = [f"{each['name']} [{each['unit']}]" for each in s["signals"]]
        about = {"source": s["source"], "plant": f"`{s['plant']}`, {PLANTS[s['plant']].summary}", "signals": signals}
        measured = ", ".join(dict.fromkeys(output_units(SCENARIOS[name])))
        units["noise_std"] = f" [{measured}]".replace(" [1]", "")
        rest = {named(k) + units.get(k, ""): words(v) for k, v in s.items() if k not in omitted}
        parts.append(entry(name, s["summary"], about | rest))
    lead = """Look up a built-in scenario here, with its plant, inputs, timing, noise and source. `pcbench show NAME` prints all
of it, and `pcbench show NAME --toml` prints it as a study file to start from."""
    return page("Scenarios", lead, *parts)


PAGES: dict[str, Callable[[], str]] = {
    "commands": commands_page,
    "study_keys": study_keys_page,
    "axis_list": axis_list_page,
    "metrics": metrics_page,
    "observers": observers_page,
    "scenarios": scenarios_page,
    "columns": columns_page,
}

if __name__ == "__main__":
    for topic, make in PAGES.items():
        (GUIDE / f"{topic}.md").write_text(make(), encoding="utf-8")
