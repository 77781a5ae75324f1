"""A page of the guide as its reader goes through it: in an empty folder, block by block, in the order of the page.

Commands are made short: what a command line does is the same, with fewer seeds, cells and rounds.
"""

import re
import shlex
import subprocess
from typing import NamedTuple

from commands import call, start
from documents import RUN, code_blocks, commands, lines

from pcbench.study import STUDIES as BUILT_IN


def axes(**values):
    """Options that leave these values of a study's axes."""
    return [word for name, some in values.items() for word in ("--set", f"axes.{name}={some}".replace(" ", ""))]


STUDIES = {  # what makes a study that pcbench brings along short, every scenario and observer of it kept
    "all": ["--seeds", "2"],
    "model-mismatch": ["--seeds", "2"],
    "cart": ["--seeds", "2"],
    "equal-tuning": ["--seeds", "2", "--set", "tune.budget=2"],
    "equal-tuning-reactor": ["--seeds", "2", "--set", "tune.budget=2", "--set", "tune.training=4"],
    "measurement-errors": [
        "--seeds",
        "2",
        *axes(**{name: [some[0], some[-1]] for name, some in BUILT_IN["measurement-errors"].axes.items() if some[1:]}),
    ],
    "helicopter": [
        "--seeds",
        "2",
        *axes(sampling_period=[0.2], delay=[0.03], noise_std=[2e-2], parameter_drift=[0.0, 0.3]),
    ],
    "delayed-measurements": ["--seeds", "2"],
    "camera-target": ["--seeds", "2", *axes(delay=[[0.1, 0.0]])],
    "digester": ["--seeds", "2", *axes(delay=[[0.0] * 3 + [25200.0] * 3])],
    "period-delay-map": axes(sampling_period=[0.1, 0.2], delay=[0.0, 0.2]),
    "processor": ["--seeds", "2", *axes(processor_speed=[2e4, 1e6])],
    "reactor": ["--seeds", "2"],
    "unequal-delays": ["--seeds", "2", *axes(delay=[[40.0, 40.0, 40.0], [10.0, 40.0, 70.0]])],
    "unknown-input": [
        "--seeds",
        "2",
        *axes(sampling_period=[0.02], delay=[0.02], noise_std=[1e-3], parameter_drift=[0.0, 0.05]),
    ],
    "variable-sampling": [  # of each scenario a schedule that all runs share, and one of each run's own
        "--seeds",
        "2",
        *axes(sampling_pattern=["sine"], loss=[0.0]),
    ],
}
AS_USERS_HAVE_IT = (  # the pages whose programs are those of a user: their runs are long, or are of a study as it is
    "quickstart.md",
    "closed_loops.md",
    "measurement_errors.md",
    "unknown_delay.md",
    "unknown_inputs.md",
)
EVERY_STUDY = "quickstart.md"  # the page that runs one after the other
TUNING = {"--budget": "2", "--training-seeds": "1000:1008", "--validation-seeds": "2000:2008"}
SEARCH = {"--seeds": "8", "--max-seeds": "16", "--tol": "0.5"}
FIRST, MORE = "8", "64"  # seeds of a run, and of one that says how many: exact answers are held against 64 or more


class Step(NamedTuple):
    """What a page had its reader do, and what came of it."""

    what: str
    code: int
    out: str
    err: str


def walk(name, folder):
    """Every step of a page, one after the other: a line of shell, or a block of Python."""
    for page in RUN:  # a page may name a file of another, which its reader then has
        for block in code_blocks(page):
            if page != name and block.title and f"`{block.title}`" in RUN[name]:
                (folder / block.title).write_text(block.text)
    for number, block in enumerate(code_blocks(name)):
        path = folder / (block.title or f"block-{number}.py")
        if block.title or block.language == "python":
            path.write_text(block.text)
        if block.reason is None and block.language == "python":
            yield step(path.name, start(path.name, cwd=folder))
        elif block.reason is None and block.language == "sh":
            for line in lines(block.text):
                if line not in shared_runs(name):
                    yield step(line, of_a_shell(line, folder))


def shared_runs(name):
    """The runs of a study that EVERY_STUDY has too, the same word for word, and of whose results this page reads nothing."""
    there = [shorten(shlex.split(line)[1:]) for line in commands(EVERY_STUDY)]
    found = [shlex.split(line) for line in commands(name) if name != EVERY_STUDY]
    studies = [words for words in found if words[1] == "run" and words[2] in BUILT_IN]
    once = [w for w in studies if shorten(w[1:]) in there and f"results/{w[2]}" not in RUN[name]]
    return [shlex.join(words) for words in once]


def of_a_shell(line, folder):
    """What a line does, where it is one of pcbench in its short form."""
    words = shlex.split(line)
    if words[0] == "pcbench":
        return call(*shorten(words[1:]), cwd=folder)
    return subprocess.run(["bash", "-ec", line], cwd=folder, capture_output=True, text=True, check=False)


def step(what, done):
    return Step(what, done.returncode, done.stdout, done.stderr)


def shorten(words):
    """The words of a command that does the same in less time."""
    if words[0] == "tune":
        on_runs = not {"--exact-objective", "--log"} & set(words)
        return with_options(words, TUNING if on_runs else {"--budget": "2"})
    if words[0] == "find-limit":
        return with_options(words, SEARCH)
    if words[0] == "replay":  # the ends of each axis
        return [re.sub(r"^(axes\.\w+=\[[^,\]]+),.*(,[^,]+\])$", r"\1\2", word) for word in words]
    if words[0] != "run" or "exact" in words:
        return words
    if words[1] in STUDIES:
        at = words.index("--seeds") if "--seeds" in words else len(words)
        return [*words[:at], *words[at + 2 :], *STUDIES[words[1]]]
    less = {"--max-seeds": "128"} if "--until-se" in words else {}
    less |= {"--workers": "2"} if "--workers" in words else {}
    return with_options(words, less | {"--seeds": MORE if "--seeds" in words else FIRST})


def with_options(words, options):
    """The same words with other values of these options, which are added where they are missing."""
    for name, value in options.items():
        at = words.index(name) if name in words else len(words)
        words = [*words[:at], name, value, *words[at + 2 :]]
    return words
