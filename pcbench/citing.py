"""BibTeX of what a study used: entries of references.bib, found by the words that docstrings and scenarios give as source.

Where a result says which solvers its gains were certified by, these alone are cited; of a study that has not run, none.
"""

import inspect
import re
import sys
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from pcbench.dataset import close, manifest, storage
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study import Study, observers_of, scenarios_of
from pcbench.study.labels import base_in, own_in
from pcbench.study.parse import outline

FILE = Path(__file__).parent / "references.bib"
ENTRY = re.compile(r"^% known by: (?P<words>[^\n]+)\n(?P<text>@\w+\{(?P<key>[\w-]+),.*?^\})$", re.M | re.S)
SOURCE = re.compile(r"Source: (.*?)(?:Different from print|Time index|Not claimed|$)", re.S)
ALWAYS = ("pcbench", "jax", "numpy", "scipy")  # every number is theirs
SOLVERS = ("CLARABEL", "SCS")
MODELLING = "cvxpy"  # what states the inequalities to them


class Reference(NamedTuple):
    """An entry of references.bib."""

    key: str
    words: str  # by which it is known
    text: str


def references() -> list[Reference]:
    """Return every entry there is."""
    found = ENTRY.finditer(FILE.read_text(encoding="utf-8"))
    return [Reference(m["key"], m["words"].strip(), m["text"]) for m in found]


def source_of(observer: str) -> str:
    """Return what the docstring of an observer's module says of its source; empty where it says nothing."""
    said = inspect.getdoc(sys.modules[OBSERVERS[observer].design.__module__]) or ""
    found = SOURCE.search(said)
    return " ".join(found[1].split()) if found else ""


def known(sources: Iterable[str]) -> list[str]:
    """Return the keys of what sources name."""
    every = list(sources)
    return [r.key for r in references() if any(r.words in source for source in every)]


def bibtex(what: str | None = None) -> str:
    """Return BibTeX of what a result's folder or a study uses; of nothing in particular, of all that there is.

    Raises UserError where `what` is neither.
    """
    every = {r.key: r for r in references()}
    if what is None:
        return _written(every.values(), ["everything that pcbench has"])
    target = storage.target(what)
    there = storage.text(target, manifest.TEXT) is not None
    study = manifest.opened(target).study if there else outline(what, [])
    record = (close.record(target) if there else None) or {}
    keys = {*known(_sources(study)), *ALWAYS, *_solvers(record)}
    return _written([r for key, r in every.items() if key in keys], _about(study, record))


def _sources(study: Study) -> list[str]:
    """What the scenarios and observers of a study have as their sources."""
    every = scenarios_of(study)
    mine = [every[name] for name in study.scenarios]
    labels = {o for s in mine for o in observers_of(study, s.name) if not own_in(study, o)}
    return [*(_of_scenario(s) for s in mine), *(source_of(base_in(study, o) or o) for o in labels)]


def _of_scenario(s: Scenario) -> str:
    """A scenario's source; of one that is made from a published plant, also that of the plant's own scenarios."""
    plants = [p.source for p in SCENARIOS.values() if p.plant == s.plant and s.plant in PLANTS and s.plant != "lti"]
    return s.source if s.name in SCENARIOS else " ".join([s.source, *plants[:1]])


def _solvers(record: dict[str, Any]) -> list[str]:
    """The keys of the solvers that the gains of a result were certified by."""
    used = {c["solver"] for each in record.get("certificates", {}).values() for c in each.values()}
    found = [r.key for r in references() if r.words in used & set(SOLVERS)]
    return [*found, MODELLING] if found else []


def _about(study: Study, record: dict[str, Any]) -> list[str]:
    """What a reader has to know of what is cited."""
    said = [f"what the study {study.name} used"]
    releases = record.get("versions", {})
    said += [f"releases: {', '.join(f'{k} {v}' for k, v in releases.items())}"] if releases else []
    own = [label for label in study.custom_observers if own_in(study, label)]
    said += [f"your own, cite it yourself: {', '.join(own)}"] if own else []
    if not record:
        said.append("not run yet: which solvers its gains need is not known")
    return said


def _written(entries: Iterable[Reference], about: list[str]) -> str:
    head = [f"% {line}" for line in [f"pcbench {version('pcbench')}: {about[0]}", *about[1:]]]
    return "\n".join([*head, "", "\n\n".join(r.text for r in entries), ""])
