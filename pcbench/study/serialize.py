"""A study with everything that decides its numbers, as TOML and as a digest."""

import hashlib
import json

import tomli_w

from pcbench.study import Study, choices_of, observers_of, scenarios_of
from pcbench.study.grid import Cell, numbering
from pcbench.study.plugins.references import PluginReference, references_in, replace_references
from pcbench.study.plugins.user_code import Code
from pcbench.study.plugins.user_plants import facts
from pcbench.toml_text import TomlTable


def resolve_study(study: Study, cells: list[Cell]) -> TomlTable:
    """Return everything that decides the numbers, for `study.toml` and its hash."""
    by_name = scenarios_of(study)
    options: TomlTable = {"scenario": choices_of(study).model_dump(exclude_none=True)}
    by_scenario = {s: TomlTable() for s in study.scenarios}
    for cell in cells:  # a grid point may lack observers that do not support it
        by_label = by_scenario[cell.scenario.name]
        by_label |= {o: m.model_dump(exclude_none=True) for o, m in cell.options.items() if o not in by_label}
    options |= {s: by_label for s, by_label in by_scenario.items() if s not in options}
    scenarios = {}
    for name in study.scenarios:  # without None, which TOML does not have
        flat = json.loads(json.dumps(by_name[name].flat(), default=dict))
        flat["model"] = {k: v for k, v in flat["model"].items() if v is not None}
        scenarios[name] = {k: v for k, v in flat.items() if v is not None}
    observers_by_scenario = {s: [o for o in observers_of(study, s) if o in options[s]] for s in study.scenarios}
    out = {"options": options, "scenarios": scenarios, "observers": observers_by_scenario, "cells": numbering(cells)}
    plugins = {r: study._plugins[r.key] for r in references_in(study.model_dump(exclude_none=True))}
    if plugins:
        out["code"] = {name: code.digest for name, code in codes(study).items()}
    if plants := {plugin.code.reference: facts(plugin.entry) for r, plugin in plugins.items() if r.kind == "plant"}:
        out["plants"] = plants
    return as_dict(study) | {"resolved": out}


def codes(study: Study) -> dict[str, Code]:
    """Return the code of each user-defined observer, plant and controller, by its name under [resolved.code]."""
    by_reference = {r: study._plugins[r.key].code for r in references_in(study.model_dump(exclude_none=True))}
    return {r.key if r.kind == "observer" else f"{r.kind} {code.name}": code for r, code in by_reference.items()}


def as_dict(study: Study) -> TomlTable:
    """Return a study in a form that can be run again, without its tuning: tuned gains are ordinary options."""
    excluded = {"tuning", "tune"} | (set() if study.custom_observers else {"custom_observers"})
    excluded |= {"evaluation", "schedules"} if study.evaluation == "runs" else set()
    excluded |= set() if study.vary == "one-at-a-time" else {"vary"}

    def dataset_reference(reference: PluginReference) -> str:
        plugin = study._plugins.get(reference.key)
        return plugin.code.reference if plugin else reference.reference

    return replace_references(study.model_dump(exclude_none=True, exclude=excluded), dataset_reference)


def to_toml(study: Study, cells: list[Cell]) -> str:
    """Return the resolved study as TOML; the part under `[resolved]` is for readers, the rest can be run again."""
    return tomli_w.dumps(resolve_study(study, cells))


def digest(study: Study, cells: list[Cell]) -> str:
    """Return the hash of the resolved study, independent of the numbering of its grid points."""
    decisive = resolve_study(study, cells)
    del decisive["resolved"]["cells"]
    return hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()
