"""BibTeX entries of the sources that a study uses, found in references.bib by words in the sources of observers and scenarios.

Solvers are cited if a result records that they certified its gains. A study that has not run cites no solver.
"""

import re
from collections.abc import Iterable
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

from pcbench.dataset import close, manifest, storage
from pcbench.observers.methods import METHODS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.study import Study, observers_of, scenarios_of
from pcbench.study.labels import base_in, plugin_in
from pcbench.study.parse import outline

FILE = Path(__file__).parent / "references.bib"
ENTRY = re.compile(r"^% known by: (?P<words>[^\n]+)\n(?P<text>@\w+\{(?P<key>[\w-]+),.*?^\})$", re.M | re.S)
ALWAYS = ("pcbench", "jax", "numpy", "scipy")  # cited for every result
SOLVERS = ("CLARABEL", "SCS")
MODELLING = "cvxpy"  # the modelling language of the inequalities


class Reference(NamedTuple):
    """An entry of references.bib."""

    key: str
    words: str  # words by which it is found
    text: str


def references() -> list[Reference]:
    """Return all entries."""
    entries = ENTRY.finditer(FILE.read_text(encoding="utf-8"))
    return [Reference(m["key"], m["words"].strip(), m["text"]) for m in entries]


def find_citations(sources: Iterable[str]) -> list[str]:
    """Return the keys of the entries that the sources refer to."""
    texts = list(sources)
    return [r.key for r in references() if any(r.words in source for source in texts)]


def bibtex(source: str | None = None) -> str:
    """Return BibTeX of the sources of a result's folder or a study; None: all entries.

    Raises UserError if `source` is neither.
    """
    entries, about = references(), ["everything that pcbench has"]
    if source is not None:
        target = storage.target(source)
        is_result = storage.read_bytes(target, manifest.TEXT) is not None
        study = manifest.load_manifest(target).study if is_result else outline(source, [])
        record = (close.record(target) if is_result else None) or {}
        solvers = {c["solver"] for table in record.get("certificates", {}).values() for c in table.values()} & set(
            SOLVERS
        )
        keys = {*find_citations(_sources(study)), *ALWAYS, *(r.key for r in entries if r.words in solvers)}
        keys |= {MODELLING} if solvers else set()
        entries = [r for r in entries if r.key in keys]
        releases = ", ".join(f"{k} {v}" for k, v in record.get("versions", {}).items())
        custom = ", ".join(label for label in study.custom_observers if plugin_in(study, label))
        about = [f"what the study {study.name} used"]
        about += [f"releases: {releases}"] if releases else []
        about += [f"your own, cite it yourself: {custom}"] if custom else []
        about += [] if record else ["not run yet: which solvers its gains need is not known"]
    head = [f"% {line}" for line in [f"pcbench {version('pcbench')}: {about[0]}", *about[1:]]]
    return "\n".join([*head, "", "\n\n".join(r.text for r in entries), ""])


def _sources(study: Study) -> list[str]:
    """Return the sources of the scenarios and observers of a study.

    A scenario derived from a published plant also has the sources of the plant's own scenarios.
    """
    by_name, sources = scenarios_of(study), []
    for s in (by_name[name] for name in study.scenarios):
        if s.name not in SCENARIOS and s.plant in PLANTS and s.plant != "lti":
            sources += [p.source for p in SCENARIOS.values() if p.plant == s.plant][:1]
        labels = [o for o in observers_of(study, s.name) if not plugin_in(study, o)]
        sources += [s.source, *(METHODS[base_in(study, o) or o].source for o in labels)]
    return sources
