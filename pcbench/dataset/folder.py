"""Whose folder it is: a dataset belongs to one study, may grow with it, and refuses another.

A study may grow: more seeds, more values of its axes, more scenarios, more observers. What decides a number may not change.
Cells keep their numbers; new ones follow.
"""

import tomllib
from typing import Any, NamedTuple

from pcbench.cells import Cell, cells_of, to_toml
from pcbench.dataset import store
from pcbench.errors import UserError
from pcbench.study import Study
from pcbench.study_file import parse

TEXT = "study.toml"
CLOSING = ("stats.parquet", "pairs.parquet", "provenance.json")  # written last: they say that a run is whole
GROWS = ("seeds", "first_seed", "axes", "observers", "scenarios", "options", "lti", "resolved")
SHOWN = 3  # differences that a refusal names


class Claim(NamedTuple):
    """A study and the cells it has in its folder."""

    study: Study
    cells: list[Cell]
    text: str  # of study.toml
    new: bool  # nothing stands there yet


def claim(place: store.Target, study: Study) -> Claim:
    """Return the study with its cells as numbered in a place; raise UserError where that belongs to another. Writes nothing."""
    said = store.get(place, TEXT)
    if said is None:
        others = store.names(place)
        if others:
            raise UserError(
                f"{place.name}: holds other files ({others[0]}), expected a new or empty folder; give another one with --out."
            )
        every = cells_of(study)
        return Claim(study, every, to_toml(study, every), True)
    there = _read(place, said)
    every = cells_of(study, there["resolved"].get("cells", {}))
    changed = [*_changes(there, tomllib.loads(to_toml(study, every)))]
    if changed and any(name.startswith("runs/") for name in store.names(place, "runs")):
        more = f" and {len(changed) - SHOWN} more" if len(changed) > SHOWN else ""
        raise UserError(
            f"{place.name}: holds the results of another study ({'; '.join(changed[:SHOWN])}{more}), expected the same one, or "
            "one with more seeds, cells or observers; give a new folder with --out, or start over with --fresh."
        )
    if changed:  # nothing was finished there
        every = cells_of(study)
    return Claim(study, every, to_toml(study, every), False)


def opened(place: store.Target) -> Claim:
    """Return the study that stands in a place, with its cells; raise UserError where there is none."""
    said = store.get(place, TEXT)
    if said is None:
        raise UserError(
            f"{place.name}: holds no study.toml, expected a folder that pcbench run has made; name that one."
        )
    there = _read(place, said)
    study = parse({k: v for k, v in there.items() if k != "resolved"}, f"{place.name}/{TEXT}")
    every = cells_of(study, there["resolved"].get("cells", {}))
    return Claim(study, every, said.decode(), False)


def differences(a: Claim, b: Claim) -> list[str]:
    """Return what differs between two studies besides their seeds and the order of their cells, a phrase each."""
    old, new = (tomllib.loads(each.text) for each in (a, b))
    for each in (old, new):
        each.update(first_seed=0, seeds=1)
        each["resolved"]["cells"] = {s: sorted(found) for s, found in each["resolved"]["cells"].items()}
    return list(dict.fromkeys([*_changes(old, new), *_changes(new, old)]))


def numbers_in(claimed: Claim) -> dict[str, list[str]]:
    """Return by scenario the digests of the cells in order of number, as a study's text says."""
    return dict(tomllib.loads(claimed.text)["resolved"]["cells"])


def begin(place: store.Target, claimed: Claim) -> None:
    """Make the place the study's own, before anything is written there; what closes an older run goes."""
    store.make(place)
    for name in CLOSING:
        store.remove(place, name)
    store.put(place, TEXT, claimed.text.encode())


def clear(place: store.Target) -> None:
    """Remove a study's results (`--fresh`); raise UserError where the place holds no study but other files."""
    names = store.names(place)
    if names and store.get(place, TEXT) is None:
        raise UserError(
            f"{place.name}: holds other files ({names[0]}) and no study, so nothing is removed; move them away."
        )
    mine = [n for n in names if n.startswith("runs/") or n in CLOSING]
    for name in [*mine, *([TEXT] if TEXT in names else [])]:  # the study's text last: it says whose files these are
        store.remove(place, name)


def _read(place: store.Target, said: bytes) -> dict[str, Any]:
    try:
        there = tomllib.loads(said.decode())
        return there | {"resolved": dict(there["resolved"])}
    except (ValueError, KeyError, TypeError):
        raise UserError(
            f"{place.name}/{TEXT}: is not as pcbench run has written it, expected a resolved study; give a new folder with "
            "--out, or start over with --fresh."
        ) from None


def _changes(there: dict[str, Any], here: dict[str, Any]) -> Any:
    """Yield what differs between a study on disk and one that is to go on there, a phrase each."""
    for key in sorted((there.keys() | here.keys()) - set(GROWS)):
        if there.get(key) != here.get(key):
            yield _phrase(key, there.get(key), here.get(key))
    (a, b), (c, d) = ((s["first_seed"], s["first_seed"] + s["seeds"]) for s in (there, here))
    if a < c or b > d:
        yield f"seeds: {a} .. {b - 1} there, {c} .. {d - 1} here"
    old, new = there["resolved"], here["resolved"]
    for scenario, names in old["observers"].items():
        if scenario not in new["observers"]:
            yield f"scenarios: {scenario} there, not here"
            continue
        for name in names:
            if name not in new["observers"][scenario]:
                yield f"observers: {name} there, not here"
        yield from _deep(f"options of {scenario}", old["options"].get(scenario, {}), new["options"][scenario], names)
        yield from _deep(scenario, old["scenarios"].get(scenario, {}), new["scenarios"][scenario])
    yield from _deep("options.scenario", old["options"]["scenario"], new["options"]["scenario"])
    yield from _lost(there, here)


def _lost(there: dict[str, Any], here: dict[str, Any]) -> Any:
    """Yield the axes that have lost a value or come anew where cells were lost."""
    old, new = there["resolved"].get("cells", {}), here["resolved"].get("cells", {})
    if any(set(old[s]) - set(new.get(s, [])) or len(set(new.get(s, []))) < len(old[s]) for s in old):
        for name in sorted(there.get("axes", {}).keys() | here.get("axes", {}).keys()):
            a, b = there.get("axes", {}).get(name), here.get("axes", {}).get(name)
            if a is None or b is None or any(v not in b for v in a):
                yield _phrase(f"axes.{name}", a, b)


def _deep(where: str, old: dict[str, Any], new: dict[str, Any], names: list[str] | None = None) -> Any:
    for key in sorted(names if names is not None else old.keys() | new.keys()):
        a, b = old.get(key), new.get(key)
        if isinstance(a, dict) and isinstance(b, dict):
            yield from _deep(f"{where}.{key}", a, b)
        elif a != b:
            yield _phrase(f"{where}.{key}", a, b)


def _phrase(where: str, there: Any, here: Any) -> str:
    say = ["nothing" if v is None else repr(v) if len(repr(v)) < 60 else repr(v)[:57] + "..." for v in (there, here)]
    return f"{where}: {say[0]} there, {say[1]} here"
