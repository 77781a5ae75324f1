"""The differences between a study on disk and one that would continue it, one phrase each."""

import re
from collections.abc import Iterator, Mapping

from pcbench.dataset.seed_ranges import common, seed_range
from pcbench.study.plugins import user_code
from pcbench.study.plugins.references import PluginReference, replace_references
from pcbench.toml_text import TomlTable

Files = Mapping[str, Mapping[str, str]]  # of the code of each name, the digest of each file
EXTENSIBLE = {
    *("seeds", "first_seed", "evaluation", "schedules", "axes", "observers", "excluded", "tuned", "custom_observers"),
    *("scenarios", "scenario", "tables", "options", "lti", "resolved"),
}


def changes(old_study: TomlTable, new_study: TomlTable, files: tuple[Files, Files] = ({}, {})) -> Iterator[str]:
    """Yield the differences between a study on disk and one that would continue it, one phrase each.

    `files` are the digests of the files of users' code, on disk and here, by the names under [resolved.code].
    """
    code_changes = list(_code_changes(old_study, new_study, files))
    yield from code_changes
    old_texts, new_texts = (replace_references(study, _strip_digest) for study in (old_study, new_study))
    for key in sorted((old_study.keys() | new_study.keys()) - EXTENSIBLE):
        if old_texts.get(key) != new_texts.get(key):
            yield _phrase(key, old_texts.get(key), new_texts.get(key))
    a, b = (seed_range(study["first_seed"], study["seeds"]) for study in (old_study, new_study))
    if common(a, b) != a:
        yield f"seeds: {a.first} .. {a.stop - 1} there, {b.first} .. {b.stop - 1} here"
    old, new = old_study["resolved"], new_study["resolved"]
    for scenario, names in old["observers"].items():
        if scenario not in new["observers"]:
            yield f"scenarios: {scenario} there, not here"
            continue
        for name in names:
            if name not in new["observers"][scenario]:
                yield f"observers: {name} there, not here"
        yield from _nested_changes(
            f"options of {scenario}", old["options"].get(scenario, {}), new["options"][scenario], names
        )
        old_scenario, new_scenario = (
            {k: v for k, v in t["scenarios"].get(scenario, {}).items() if k != "code"} for t in (old, new)
        )
        yield from _nested_changes(scenario, old_scenario, new_scenario)
    old_tuned, new_tuned = (_tuned_cells(study) for study in (old_study, new_study))
    for cell, options in old_tuned.items():
        if cell in new_tuned:
            yield from _nested_changes(f"options tuned at {cell}", options, new_tuned[cell], list(options))
    yield from _nested_changes("options.scenario", old["options"]["scenario"], new["options"]["scenario"])
    if not code_changes:  # changed code explains changed cells
        yield from _axis_changes(old_study, new_study)


def _tuned_cells(study: TomlTable) -> dict[str, TomlTable]:
    """The options of cells that were tuned one by one, by their values of the axes."""
    cells = (study.get("tuned") or {}).get("cells") or []
    return {", ".join(f"{name} = {value}" for name, value in c["cell"].items()): c["options"] for c in cells}


def _code_changes(old_study: TomlTable, new_study: TomlTable, files: tuple[Files, Files]) -> Iterator[str]:
    """Yield the objects with changed code, with the changed files if they are known."""
    old, new = (study["resolved"].get("code", {}) for study in (old_study, new_study))
    for name, digest in old.items():
        if new.get(name, digest) == digest:
            continue
        a, b = (f.get(name, {}) for f in files)
        if a and b:
            names = sorted(file for file in a.keys() | b.keys() if a.get(file) != b.get(file))
            yield f"the code of {name}: {' and '.join(names)} {'has' if len(names) == 1 else 'have'} changed since"
            continue
        sides = (old_study, digest), (new_study, new[name])
        where = [study.get("custom_observers", {}).get(name, f"{user_code.FOLDER}/{d}") for study, d in sides]
        yield f"the code of {name}: {where[0]} there, {where[1]} here"


def _strip_digest(reference: PluginReference) -> str:
    """MODULE:NAME without the digest of the file's content."""
    return re.sub(rf"^{user_code.FOLDER}/\w+/", "", reference.reference)


def _axis_changes(old_study: TomlTable, new_study: TomlTable) -> Iterator[str]:
    """If cells are missing, yield the axes that lost a value or are new."""
    old, new = (
        {s: set(digests) for s, digests in t["resolved"].get("cells", {}).items()} for t in (old_study, new_study)
    )
    if all(digests <= new.get(s, set()) for s, digests in old.items()):
        return
    axes = old_study.get("axes", {}), new_study.get("axes", {})
    pairs = [(name, *(t.get(name) for t in axes)) for name in sorted(axes[0].keys() | axes[1].keys())]
    changes = [(name, a, b) for name, a, b in pairs if a is None or b is None or any(v not in b for v in a)]
    yield from (_phrase(f"axes.{name}", a, b) for name, a, b in changes)
    if not changes:
        yield "cells: some that stand there are not of this study"


def _nested_changes(where: str, old: TomlTable, new: TomlTable, names: list[str] | None = None) -> Iterator[str]:
    for key in sorted(names if names is not None else old.keys() | new.keys()):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            yield from _nested_changes(f"{where}.{key}", a, b)
        elif a != b:
            yield _phrase(f"{where}.{key}", a, b)


def _phrase(where: str, old: object, new: object) -> str:
    sides = ["nothing" if v is None else repr(v) if len(repr(v)) < 60 else repr(v)[:57] + "..." for v in (old, new)]
    return f"{where}: {sides[0]} there, {sides[1]} here"
