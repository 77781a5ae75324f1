"""Checks that a user's own code follows the protocol; each check has a verdict and a reason."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from pcbench.checking import controller, observer, plant, study, targets
from pcbench.checking.observer_fixtures import load
from pcbench.checking.targets import WHERE, Finding, kind_of
from pcbench.errors import UserError, short, unknown
from pcbench.plants import parameters_of
from pcbench.runtime import config
from pcbench.scenarios import SCENARIOS, Scenario
from pcbench.study import STUDIES, parse
from pcbench.study.plugins import registry, user_code
from pcbench.study.scenario_template import toml_value

DEFAULT = "cart/white"  # scenario of the checks of an observer and a controller


class CheckReport(NamedTuple):
    """The results of all checks of one target."""

    kind: str  # observer, plant, controller, scenario or study
    label: str
    scenario: str  # scenario of the checks; empty: the target's own
    findings: list[Finding]


def check(target: str, scenario: str | None = None, options: Mapping[str, Any] | None = None) -> CheckReport:
    """Return the results of all checks of a target: MODULE:NAME, whose kind is determined from the object, or a study.

    `scenario` is the scenario of the checks: a published one, a study file, or MODULE:NAME of one. `options` are
    options of an observer or a controller, parameters of a plant, or changes of a study by key. Raises UserError if the
    target or the scenario does not exist.
    """
    if scenario is not None and not (
        user_code.is_reference(scenario) or scenario.endswith(".toml") or scenario in STUDIES or scenario in SCENARIOS
    ):  # reported before any code is run
        raise unknown(f"{WHERE} --scenario", "scenario", scenario, SCENARIOS)
    with config.float64():
        kind, values = kind_of(target), dict(options or {})
        label = target.rpartition(":")[2]
        if kind in (targets.STUDY, "scenario"):
            if scenario is not None:
                raise UserError(
                    f"{WHERE} --scenario: got '{short(scenario)}' for a {kind}, expected none: it is checked on its own; leave "
                    "it out."
                )
            parse.raw_of(target, [], parse.FROM_HERE)  # raises UserError for a missing file, which is no finding
            results = study.findings(target, [f"{key}={toml_value(value)}" for key, value in values.items()])
            return CheckReport(kind, label, "", results)
        if kind == "plant":
            s = _of_plant(target, label, scenario, values)
            return CheckReport(kind, label, s.name if scenario else "", plant.findings(label, s))
        s = parse.scenario_of(scenario or DEFAULT)
        if kind == "observer":
            return CheckReport(kind, label, s.name, observer.findings(load(target, values), s))
        plugin = registry.load("controller", target, WHERE)
        return CheckReport(kind, label, s.name, controller.findings(label, plugin, s, values))


def _of_plant(target: str, label: str, name: str | None, numbers: dict[str, Any]) -> Scenario:
    """Return a scenario of a user's plant, with some of its parameters changed."""
    plugin = registry.load("plant", target, WHERE)
    fields = {"user_code": {"plant": plugin}}
    s = plant.plant_scenario(label, plugin.entry, fields) if name is None else parse.scenario_of(name)
    code, actual = plugin.code, s.user_code.get("plant")
    if actual is None or (actual.code.name, actual.code.digest) != (code.name, code.digest):
        raise UserError(
            f"{WHERE} --scenario: got '{short(str(name))}', whose plant is {s.plant}, expected a scenario of {label}; name one "
            f'with plant = "{short(target)}", or leave it out.'
        )
    for key, value in numbers.items():
        if key not in parameters_of(plugin.entry):
            raise unknown(f"{WHERE} --set", f"number of {label}", key, parameters_of(plugin.entry))
        if isinstance(value, bool) or not isinstance(value, int | float):
            raise UserError(f"{WHERE} --set: got {key} = {short(str(value))}, expected a number; write one.")
    return s.with_fields(model={**s.belief.model, **{key: float(value) for key, value in numbers.items()}})
