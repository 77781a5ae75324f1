"""Commands for your own code (`new`, `check`) and for the guide (`guide`)."""

import contextlib
import json
import os
import shutil
import sys
from pathlib import Path
from typing import Annotated, Literal

import typer

from pcbench import toml_text
from pcbench.cli.options import Json
from pcbench.cli.shared import argument, console, option, setup, write_new
from pcbench.errors import UserError, short, unknown

Kind = Literal["observer", "plant", "controller", "scenario", "recording"]
Example = Literal["car", "leg"]
PLACEHOLDER = "NAME"
TEMPLATES = Path(__file__).parent / "templates"
BASE = "cart/white"  # of a scenario to start from
FILES = {
    "observer": (".py",),
    "plant": (".py", ".toml"),
    "controller": (".py",),
    "scenario": (".toml",),
    "recording": ("",),
}
NEXT = {
    "observer": ("pcbench check {name}.py:{name}", "pcbench run cart/white --observers {name}.py:{name},kf"),
    "plant": ("pcbench check {name}.py:{name}", "pcbench check {name}.toml", "pcbench run {name}.toml"),
    "controller": (
        "pcbench check {name}.py:{name} --set period=0.02",
        "pcbench run cart/white --set controller.use={name}.py:{name}",
    ),
    "scenario": ("pcbench check {name}.toml", "pcbench run {name}.toml"),
}
EXAMPLES = {  # of recordings
    "car": ("pcbench info {name}", "pcbench guide a-real-recording"),
    "leg": ("pcbench info {name}/recording.toml", "pcbench guide synchronous-sensors"),
}


def new(
    kind: Annotated[Kind, argument("Kind of template")],
    name: Annotated[str, argument("Name of the object and of its file")],
    example: Annotated[
        Example | None, option("Recording to copy: a car, or the leg of a walking person [default: car]")
    ] = None,
) -> None:
    """Create a commented template that runs, for a plant with a study; or copy a real recording into a folder.

    Examples: pcbench new observer nudge;  pcbench new recording walk --example leg
    """
    if example and kind != "recording":
        raise UserError(f"new {kind}: got --example {example}, which is an option of recordings; leave it out.")
    name = name if kind in ("scenario", "recording") else name.replace("-", "_")
    if not name.isidentifier():
        raise UserError(f"new {kind}: got '{short(name)}', expected a name of letters, digits and _; write another.")
    paths = [Path(name + suffix) for suffix in FILES[kind]]
    for path in paths:
        if os.path.exists(path):  # unlike Path.exists, it accepts names that are too long
            raise UserError(f"new {kind}: {path} exists already, expected a new file; give another name.")
    for path in paths:
        if kind == "recording":
            copy_recording(path, example or "car")
            continue
        if kind == "scenario":
            setup()
            from pcbench.scenarios import SCENARIOS
            from pcbench.study import scenario_template

            text = scenario_template.as_study(SCENARIOS[BASE])
            text = text.replace('name = "my-cart-white"', f'name = "{name}"', 1)
        else:
            text = (TEMPLATES / (kind + path.suffix)).read_text(encoding="utf-8").replace(PLACEHOLDER, name)
        write_new(path, text, f"new {kind}")
    print(f"{' and '.join(map(str, paths))} {'are' if len(paths) > 1 else 'is'} written. Next:")
    for command in EXAMPLES[example or "car"] if kind == "recording" else NEXT[kind]:
        print("  " + command.format(name=name))


def copy_recording(folder: Path, example: Example) -> None:
    """Write a real recording into a new folder, with its source and licence; raise UserError if that fails."""
    try:
        shutil.copytree(TEMPLATES / "recordings" / example, folder)
    except OSError as error:
        shutil.rmtree(folder, ignore_errors=True)
        raise UserError(
            f"new recording: {folder} cannot be written ({error.strerror or error}), expected a writable folder; use another."
        ) from None


FOLDER = Path(__file__).parents[1] / "guide"
GROUPS = {  # the pages by kind, in the order of the list
    "Getting started": (
        *("quickstart", "linear-plant", "delayed-camera", "recording-to-c", "a-real-recording", "synchronous-sensors"),
    ),
    "How-to guides": (
        *("choose-an-observer", "axes", "find-limit", "delayed-measurements", "unknown-delay", "unknown-inputs"),
        *("nonlinear-filters", "consistency", "measurement-errors", "send-on-delta", "processor", "closed-loops"),
        *("your-own-observer", "your-own-plant"),
        *("recordings", "recording-files", "find-a-delay", "gains", "export-to-c", "large-studies", "paper"),
    ),
    "Concepts": ("timing-model", "glossary", "how-it-works", "exact-evaluation", "limitations"),
    "Reference": (
        *("results", "figures", "commands", "study-keys", "axis-list", "metrics", "observers", "scenarios", "columns"),
        "versioning",
    ),
    "Findings": (
        *("wrong-assumptions", "measurement-error-findings", "delay-findings", "reactor-findings", "network-findings"),
        *("five-papers", "the-field", "field-findings"),
    ),
    "About": ("comparison", "decisions"),  # followed by the pages of the decisions
}


def pages() -> dict[str, Path]:
    """Return the guide's pages by topic, in order."""
    entries = ((path.parent.name if path.stem == "README" else path.stem, path) for path in FOLDER.rglob("*.md"))
    by_topic = {name.replace("_", "-"): path for name, path in entries}
    first = [topic for group in GROUPS.values() for topic in group]
    return {topic: by_topic[topic] for topic in [*first, *sorted(by_topic.keys() - set(first))]}


def title(page: str) -> str:
    """Return a page's title: the text after its first #."""
    return next(line for line in page.splitlines() if line.startswith("# ")).removeprefix("# ")


def guide(topic: Annotated[str | None, argument("Name of a page [default: the list of pages]")] = None) -> None:
    """Print a page of the guide, or the list of its pages.

    Example: pcbench guide choose-an-observer
    """
    topics = pages()
    if topic is None:
        width = max(len(topic) for group in GROUPS.values() for topic in group)
        for group, group_topics in GROUPS.items():
            print(f"{group}\n")
            print(
                "\n".join(f"  {topic:<{width}}  {title(topics[topic].read_text('utf-8'))}" for topic in group_topics),
                end="\n\n",
            )
        print("Show a page: pcbench guide choose-an-observer")
        return
    path = topics.get(topic.strip().lower().removesuffix(".md").replace("_", "-"))
    if path is None:
        raise unknown("guide", "page", topic, topics)
    from rich.markdown import Markdown

    console().print(Markdown(path.read_text("utf-8"), hyperlinks=False))


def check(
    target: Annotated[
        str,
        argument(
            "Observer, plant, controller or scenario as MODULE:NAME or FILE.py:NAME, or a study file",
            metavar="MODULE:NAME|FILE.toml",
        ),
    ],
    scenario: Annotated[
        str | None,
        option("Scenario for the checks: a name, a study file or MODULE:NAME [default: cart/white; for a plant none]"),
    ] = None,
    options: Annotated[
        list[str] | None,
        option(
            "Option of the observer or controller, or parameter of the plant (repeatable)", "--set", metavar="KEY=VALUE"
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Check that your own code follows the protocol, and that a closed loop is stable. Exit code 1 if a check fails.

    Examples: pcbench check mine.py:nudge --set share=0.2;  pcbench check mine.py:pendulum;  pcbench check motor.toml
    """
    values = dict(map(_option, options or []))
    setup()
    from pcbench import checking
    from pcbench.checking.targets import FAILS
    from pcbench.cli.render import gains

    with contextlib.redirect_stdout(sys.stderr):  # output of user code is not part of the result
        kind, label, scenario_name, findings = checking.check(target, scenario, values)
    if as_json:
        summary = {"kind": kind, kind: label} | (
            {"scenario": scenario_name} if scenario_name and kind != "scenario" else {}
        )
        print(json.dumps(summary | {"checks": [f._asdict() for f in findings]}, indent=2))
    else:
        gains.print_findings(f"{kind} {label}" + (f" on {scenario_name}" if scenario_name else ""), findings, console())
    if any(f.verdict == FAILS for f in findings):
        raise typer.Exit(1)


def _option(text: str) -> tuple[str, object]:
    """Return the name and the value of KEY=VALUE; a value is TOML, or a plain word."""
    name, equals, value = text.partition("=")
    if not equals or not name.strip():
        raise UserError(f"check --set: got '{short(text)}', expected KEY=VALUE; write --set share=0.2, for example.")
    try:
        return name.strip(), toml_text.parse(f"value = {value}")["value"]
    except ValueError:
        return name.strip(), value.strip()
