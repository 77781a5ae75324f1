"""Options of observers, and choices of scenarios: merged, validated, with defaults."""

from pydantic import BaseModel

from pcbench.errors import UserError, brief_repr, unknown
from pcbench.observers import OBSERVERS
from pcbench.scenarios import Scenario
from pcbench.scenarios.signals import PATHS, SIGNALS, SINGLE
from pcbench.study import axes
from pcbench.study.labels import base_in, entry_in
from pcbench.study.plugins.user_observers import validate_options
from pcbench.study.schema import Choices, Study
from pcbench.toml_text import TomlTable

LEAST = 1e-30  # an option is 0 or at least this, so that its square does not underflow


def options_of(study: Study, scenario: Scenario, observer: str) -> BaseModel:
    """Return an observer's options, validated and with defaults: see `merge_options`."""
    return checked_options(
        study, observer, merge_options(study, scenario, observer), f"{study.name}: options.{observer}"
    )


def merge_options(study: Study, scenario: Scenario, observer: str) -> TomlTable:
    """Return the options as given: the study's override the scenario's, and a label's override its observer's."""
    out: TomlTable = {}
    for label in dict.fromkeys([base_in(study, observer) or observer, observer]):
        out |= to_underscores(dict(scenario.options.get(label, {}))) | to_underscores(study.options.get(label, {}))
    return out


def with_options_of(study: Study, observer: str) -> Study:
    """Return a study with only the options of its scenario and of one observer."""
    names = ("scenario", observer, base_in(study, observer) or observer)
    return study.model_copy(
        update={"options": {name: values for name, values in study.options.items() if name in names}}
    )


def choices_of(study: Study) -> Choices:
    """Return the study's `[options.scenario]`."""
    return Choices.model_validate(to_underscores(study.options.get("scenario", {})))


def checked_options(study: Study, name: str, table: TomlTable, where: str) -> BaseModel:
    """Return the options of an observer's label, or of 'scenario', validated and with defaults."""
    bare = name.rstrip("0123456789")
    if bare != name and base_in(study, name) is None and base_in(study, bare) == bare:
        raise UserError(
            f"{where}: got no observer, expected a label of {bare}; write [options.{bare}-{name[len(bare) :]}]."
        )
    if name != "scenario" and base_in(study, name) is None:
        raise unknown(
            where, "observer with options (or 'scenario')", name, [*study.custom_observers, *OBSERVERS, "scenario"]
        )
    model = Choices if name == "scenario" else entry_in(study, name).options
    for key in to_underscores(table) if model.model_config.get("extra") != "allow" else ():
        if model is Choices and key == "drift_sign":
            raise UserError(
                f"{where}: got drift_sign, expected it as a parameter of the cart; write axes.plant.drift_sign."
            )
        if key not in model.model_fields:
            raise unknown(where, "key here", key, model.model_fields)
    underscore_keys(table, where)
    for key, value in table.items():
        _require_sensible_size(value, f"{where}.{key}")
    options = validate_options(model, to_underscores(table), where)
    if not isinstance(options, Choices):
        return options
    names = {"input": ("input", SIGNALS), "unknown_input": ("input", SINGLE), "path": ("path", PATHS)}
    for key, (kind, valid) in names.items():
        if (signal := getattr(options, key)) is not None and signal not in valid:
            raise unknown(f"{where}.{key}", kind, signal, valid)
    if options.random_initial_state and options.initial_spread:
        raise UserError(
            f"{where}: got random_initial_state and initial_spread, expected one of them; leave the other out."
        )
    if options.consistency and not options.random_initial_state:
        raise UserError(
            f"{where}: got consistency with a fixed initial state, expected x(0) drawn from the assumed "
            "prior; add random_initial_state = true."
        )
    return options


def to_underscores(table: TomlTable) -> TomlTable:
    """Return a table with _ for - in its keys."""
    return {key.replace("-", "_"): value for key, value in table.items()}


def underscore_keys(table: TomlTable, where: str, excluded_prefix: str = "\n") -> TomlTable:
    """Return a table with _ for - in its keys, except those that begin with a prefix; raise UserError for a key given twice."""
    out = {key if key.startswith(excluded_prefix) else key.replace("-", "_"): value for key, value in table.items()}
    if len(out) < len(table):
        duplicate = next(key for key in table if "-" in key and key.replace("-", "_") in table)
        raise UserError(f"{where}: got {duplicate} twice, with - and with _, expected it once; remove one.")
    return out


def _require_sensible_size(value: object, where: str) -> None:
    """Raise UserError if a number, or one in a list, is too large or too small to be squared."""
    children = value.values() if isinstance(value, dict) else value if isinstance(value, list) else []
    for child in children:
        _require_sensible_size(child, where)
    if isinstance(value, int | float) and value == value and value and not LEAST <= abs(value) <= axes.LARGEST:
        raise UserError(
            f"{where}: got {brief_repr(value)}, expected 0 or a number of {LEAST:g} to {axes.LARGEST:g} in size; "
            "write SI units."
        )
