"""A study with everything that decides its numbers, as TOML and as a digest."""

import hashlib
import json

import tomli_w

from pcbench.study import Study, choices_of, observers_of, scenarios_of
from pcbench.study.grid import Cell, numbering
from pcbench.study.plugins.references import PluginReference, named_in, replace_references
from pcbench.study.plugins.user_code import Code
from pcbench.study.plugins.user_plants import facts
from pcbench.toml_text import TomlTable


def resolve_study(study: Study, every: list[Cell]) -> TomlTable:
    """Return everything that decides the numbers, for `study.toml` and its hash."""
    known = scenarios_of(study)
    options: TomlTable = {"scenario": choices_of(study).model_dump(exclude_none=True)}
    given = {s: TomlTable() for s in study.scenarios}
    for cell in every:  # a grid point may lack observers that do not support it
        mine = given[cell.scenario.name]
        mine |= {o: each.model_dump(exclude_none=True) for o, each in cell.options.items() if o not in mine}
    options |= {s: mine for s, mine in given.items() if s not in options}
    scenarios = {}
    for name in study.scenarios:  # without None, which TOML does not have
        flat = json.loads(json.dumps(known[name].flat(), default=dict))
        flat["model"] = {k: v for k, v in flat["model"].items() if v is not None}
        scenarios[name] = {k: v for k, v in flat.items() if v is not None}
    ran_by = {s: [o for o in observers_of(study, s) if o in options[s]] for s in study.scenarios}
    out = {"options": options, "scenarios": scenarios, "observers": ran_by, "cells": numbering(every)}
    owned = {each: study._own[each.key] for each in named_in(study.model_dump(exclude_none=True))}
    if owned:
        out["code"] = {name: code.digest for name, code in codes(study).items()}
    if plants := {mine.code.reference: facts(mine.entry) for n, mine in owned.items() if n.kind == "plant"}:
        out["plants"] = plants
    return as_dict(study) | {"resolved": out}


def codes(study: Study) -> dict[str, Code]:
    """Return the code of each user-defined observer, plant and controller, by its name under [resolved.code]."""
    owned = {each: study._own[each.key].code for each in named_in(study.model_dump(exclude_none=True))}
    return {n.key if n.kind == "observer" else f"{n.kind} {code.name}": code for n, code in owned.items()}


def as_dict(study: Study) -> TomlTable:
    """Return a study in a form that can be run again, without its tuning: tuned gains are ordinary options."""
    left = {"tuning", "tune"} | (set() if study.custom_observers else {"custom_observers"})
    left |= {"evaluation", "schedules"} if study.evaluation == "runs" else set()
    left |= set() if study.vary == "one-at-a-time" else {"vary"}

    def copied(each: PluginReference) -> str:
        return study._own[each.key].code.reference if each.key in study._own else each.reference

    return replace_references(study.model_dump(exclude_none=True, exclude=left), copied)


def to_toml(study: Study, every: list[Cell]) -> str:
    """Return the resolved study as TOML; the part under `[resolved]` is for readers, the rest can be run again."""
    return tomli_w.dumps(resolve_study(study, every))


def digest(study: Study, every: list[Cell]) -> str:
    """Return the hash of the resolved study, independent of the numbering of its grid points."""
    decisive = resolve_study(study, every)
    del decisive["resolved"]["cells"]
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()
