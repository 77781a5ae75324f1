"""From a study's table `[scenario]` to a scenario, with defaults, and sizes that fit the plant.

Every error is one sentence: the place, the value, what was expected, and how to correct it.
"""

from collections.abc import Mapping

from pcbench.controllers import CONTROLLERS
from pcbench.controllers import entry_of as controller_of
from pcbench.errors import UserError, brief_repr, unknown
from pcbench.plants import PLANTS, PlantSpec, entry_of, estimated_of, numbers_of, parameters_of, signals_of, states_of
from pcbench.scenarios import INTERVAL, NOTHING, SCENARIOS, Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.signals import PATHS, SIGNALS, SINGLE
from pcbench.signal_names import names_and_units, require_different
from pcbench.study import axes, controller_table, times
from pcbench.study.lti_inputs import sources
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.plugins.user_observers import validate_options
from pcbench.study.scenario_schema import ScenarioTable
from pcbench.toml_text import TomlTable

REQUIRED = ("plant", "x0", "sampling_period", "delay", "noise_std")
# by field: the size, and whether it may be empty
SIZES = {
    "x0": ("n", False),
    "process_std": ("n", True),
    "xhat0": ("n", False),
    "prior_std": ("n", False),
    "unknown0": ("s", True),
    "unknown_std": ("s", False),
    "assumed_noise_std": ("q", True),
    "assumed_process_std": ("n", True),
    "initial_box": ("n", True),
    "settle_band": ("signal", False),
}
EACH = {"n": "state", "s": "unknown", "q": "output", "signal": "signal"}
AS_GIVEN = ("prefilled", "continuous", "drift_intensity", "steady_start", "options")


def scenario_of(table: ScenarioTable, name: str, where: str, own: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario of a table; `own` has user-defined plants and controllers by MODULE:NAME.

    Raises UserError with the invalid key.
    """
    if name in SCENARIOS or name == "lti":
        raise UserError(
            f"{where}.name: got '{name}', expected a name that no other scenario has; write another, such as "
            f"'my-{name.replace('/', '-')}'."
        )
    given = table.given()
    s = _base(table, given, where)._replace(name=name)
    s = s.having(**{key: given[key] for key in ("dt", "duration") if key in given})
    times.ticks_of(s.duration, s.dt, where)
    s = _of_plant(s, given, where, own)
    s = experiment_on(s, given, where, own, is_new=table.base is None)
    if s.sampling.continuous and (entry_of(s).plant.field is None or entry_of(s).nominal(numbers_of(s)).discrete):
        raise UserError(
            f"{where}.continuous: got true for {s.plant}, expected a plant that is a vector field; leave it out."
        )
    return s


def experiment_on(
    s: Scenario, given: TomlTable, where: str, own: Mapping[str, UserPlugin] = NOTHING, is_new: bool = True
) -> Scenario:
    """Return a scenario that has a plant with the experiment of a table; a new scenario gets defaults.

    Raises UserError with the invalid key.
    """
    entry, model = entry_of(s), entry_of(s).nominal(numbers_of(s))
    many = {"n": len(model.A), "s": len(estimated_of(s)) - len(states_of(s)), "q": len(model.C)}
    many["signal"] = len(signals_of(s))
    for key, (size, _) in SIZES.items():
        if key in given and not isinstance(given[key], list):
            given[key] = [float(given[key])] * many[size]
    for key in ("process_std", "assumed_process_std"):
        if key in given and (
            wrong := [i for i, row in enumerate(given[key]) if isinstance(row, list) and len(row) != many["n"]]
        ):
            got = len(given[key][wrong[0]])
            raise UserError(f"{where}.{key}[{wrong[0]}]: got {got} numbers, expected {many['n']}, one for each state.")
        given |= {key: [tuple(row) if isinstance(row, list) else row for row in given[key]]} if key in given else {}
    s = s.having(**{key: tuple(given[key]) for key in (*SIZES, "delay_sine", "headline") if key in given})
    if is_new:
        s = with_defaults(s, many["n"], many["s"], len(entry.errors)).having(
            steady_start=round(0.3 * s.duration / s.dt) * s.dt
        )
        s = s if "controller" in given or "input" in given else s.having(input="sine")
        linear = ("kf", "model-only") if entry.model is None or entry.residual is not None else ()
        usual = linear if entry.model is None else ("ekf", *linear)
        s = s if "observers" in given else s._replace(observers=usual)
    s = _resolve_axis_fields(s, given, many["q"], where)
    s = s.having(**{key: given[key] for key in AS_GIVEN if key in given})
    if "noise_correlation" in given:
        s = s.having(noise_correlation=tuple(map(tuple, given["noise_correlation"])))
    if (limit := given.get("divergence_threshold")) is not None:
        s = s.having(divergence_threshold=tuple(limit) if isinstance(limit, list) else limit)
    s = _driven(s, given, model.B.shape[1], where, own)
    _require_fit(s, many, where)
    return s


def with_defaults(s: Scenario, n: int, unknowns: int, errors: int = 0) -> Scenario:
    """Return a scenario with defaults for its n states, its unknown inputs and its errors, except x(0)."""
    x0, xhat0 = s.truth.x0, s.belief.xhat0 or (0.0,) * n
    apart = tuple(abs(a - b) or 1.0 for a, b in zip(x0, xhat0, strict=False))
    prior, size = s.belief.prior_std or apart, s.belief.unknown_std or (1.0,) * unknowns
    rest = (*size, *(1.0,) * errors)
    usual = zip((*prior, *rest), (*apart, *rest), strict=False)
    band = s.scoring.settle_band or tuple(0.05 * (p or default) for p, default in usual)
    return s.having(xhat0=xhat0, prior_std=prior, unknown_std=size, settle_band=band)


def _base(table: ScenarioTable, given: TomlTable, where: str) -> Scenario:
    """Return the scenario that the table's keys change: the base, or one with only the required keys."""
    observers = tuple(given.get("observers", ()))
    if table.base is not None:
        if table.base not in SCENARIOS:
            raise unknown(f"{where}.base", "published scenario", table.base, SCENARIOS)
        base = SCENARIOS[table.base]
        return base._replace(
            summary=given.get("summary", f"{base.name}, changed"),
            source=given.get("source", f"the study, after {base.source}"),
            observers=observers or base.observers,
        )
    for key in REQUIRED:
        if key not in given:
            raise UserError(f"{where}: {key} is missing; write {key} = ..., or base = a published scenario.")
    return Scenario(
        name="",
        summary=given.get("summary", "a user's scenario"),
        source=given.get("source", "the study"),
        plant="",
        observers=observers,
        truth=Truth(()),
        loop=Loop(),
        sampling=Sampling((), (), ()),
        belief=Belief((), ()),
        scoring=Scoring((), 1e6),
    )


def _of_plant(s: Scenario, given: TomlTable, where: str, own: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario with its plant, the plant's parameters and its signals."""
    valid = [name for name in PLANTS if name != "lti"]
    plant = given.get("plant", s.plant)
    if plant == "lti":
        raise UserError(
            f"{where}.plant: got 'lti', expected a plant with its own equations; write the table [lti] for a linear plant."
        )
    if mine := own.get(plant):
        s = s._replace(plant=mine.code.name, own={**s.own, "plant": mine})
    elif plant not in valid:
        raise unknown(f"{where}.plant", "plant (or MODULE:NAME)", plant, valid)
    else:
        s = s._replace(plant=plant)
    entry = entry_of(s)
    known_to_observers = [name for name in entry.numbers._fields if name not in ("drift", "unknown_input")]
    for table, known in (("parameters", parameters_of(entry)), ("model", known_to_observers)):
        values = {}
        for name, value in given.get(table, {}).items():
            if name not in known:
                raise unknown(f"{where}.{table}", f"parameter of plant {s.plant}", name, known)
            usual = getattr(entry.numbers, name)
            if type(usual) is float:
                value = axes.point(f"plant.{name}", value, s, f"{where}.{table}.{name}")
            elif type(value) is not type(usual):
                raise UserError(
                    f"{where}.{table}.{name}: got {brief_repr(value)}, expected a value such as {brief_repr(usual)}."
                )
            values[name] = value
        s = s.having(**{table: values}) if table in given else s
    for key, signals in (("signals", entry.signals), ("unknowns", entry.unknowns)):
        if texts := given.get(key):
            if len(texts) != len(signals):
                raise UserError(f"{where}.{key}: got {len(texts)} names, expected {len(signals)}.")
            s = s.having(**{key: names_and_units(texts, f"{where}.{key}")})
    return s


def _resolve_axis_fields(s: Scenario, given: TomlTable, q: int, where: str) -> Scenario:
    """Return the scenario with the axes' fields in the form of an axis: whole ticks, one value per output."""
    if len(s.sampling.delay) != q:
        s = s.having(delay=(0.0,) * q, sampling_period=(s.dt,) * q, noise_std=(0.0,) * q)
    changed = "dt" in given or "duration" in given  # times of a base may not fit the new ticks
    for key in (name for name in axes.AXES if name not in axes.STATES):
        if key in given or (changed and s.value(key) is not None):
            value = given.get(key, axes.plain(key, s.value(key), apart=True) if key not in axes.LISTS else s.value(key))
            value = INTERVAL if value == [None] * q else value
            s = s.having(**{key: axes.point(key, value, s, f"{where}.{key}")})
    return s


def _driven(s: Scenario, given: TomlTable, m: int, where: str, own: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario with its input, its controller and its unknown input."""
    entry, horizon = entry_of(s), (times.to_ticks(s.duration, s), s.dt)
    loop = {key: given[key] for key in ("input", "controller", "control") if key in given}
    if mine := own.get(loop.get("controller", "")):
        loop["controller"] = mine.code.name
        s = s._replace(own={**s.own, "controller": mine})
    s = s.having(**loop)
    if loop.get("input") and s.loop.controller and "controller" not in loop:
        s = s.having(controller="", control={})  # an input replaces the controller of a base
    elif loop.get("controller") and "input" not in loop:
        s = s.having(input="")
    if bool(s.loop.input) == bool(s.loop.controller):
        raise UserError(
            f"{where}: got {'an input and a controller' if s.loop.input else 'neither an input nor a controller'}, expected "
            "one of them; write input = ... for an open loop, controller = ... for a closed one."
        )
    if s.loop.controller:
        _require_controller(s, entry, where)
    elif not isinstance(s.loop.input, tuple):  # from the base
        found = sources(s.loop.input, m, SIGNALS, horizon, "inputs", f"{where}.input")
        s = s if isinstance(s.loop.input, str) else s.having(input=found)
    for key in axes.COMMANDS:
        if value := given.get(key):
            if key not in axes.axes_of(s):
                raise UserError(
                    f"{where}.{key}: got {brief_repr(value)} where no controller for any plant gives commands, expected none; "
                    "leave it out."
                )
            s = s.having(**{key: axes.point(key, value, s, f"{where}.{key}")})
    pushing = given.get("unknown_input")
    if pushing == "":
        return s.having(unknown_input="")
    if pushing:
        here = f"{where}.unknown_input"
        if "unknown_input" not in entry.numbers._fields:
            raise UserError(
                f"{here}: got {brief_repr(pushing)} for {s.plant}, expected none: it has no unknown input; leave it out."
            )
        many = len(estimated_of(s)) - len(states_of(s))
        found = sources(pushing, many, SINGLE, horizon, "unknown inputs", here)
        s = s.having(unknown_input=pushing if isinstance(pushing, str) else found)
    return s


def _require_controller(s: Scenario, entry: PlantSpec, where: str) -> None:
    """Raise UserError for a controller that is unknown or unsupported by the plant, and for invalid options."""
    name, control = s.loop.controller, dict(s.loop.control)
    if name not in CONTROLLERS and "controller" not in s.own:
        raise unknown(f"{where}.controller", "controller (or MODULE:NAME)", name, CONTROLLERS)
    if name == "pd" and entry.inverse is None:
        able = ", ".join(each for each, plant in PLANTS.items() if plant.inverse)
        raise UserError(f"{where}.controller: got 'pd' on {s.plant}, expected a plant that it supports: {able}.")
    law = controller_of(s)
    options = validate_options(law.options, control, f"{where}.control")
    if "path" in control and control["path"] not in PATHS:
        raise unknown(f"{where}.control.path", "path", str(control["path"]), PATHS)
    if law.check:
        law.check(options, controller_table.sizes(s, f"{where}.control"))


def _require_fit(s: Scenario, many: dict[str, int], where: str) -> None:
    """Raise UserError for a list of the wrong length, and for invalid scoring."""
    for key, (size, optional) in SIZES.items():
        got, want = len(s.value(key)), many[size]
        if got != want and not (optional and not got):
            raise UserError(
                f"{where}.{key}: got {got} numbers, expected {want}, one for each {EACH[size]}"
                + (f" of {s.plant}." if s.plant != "lti" else ".")
            )
    bound, tail = s.scoring.divergence_threshold, s.scoring.steady_start
    if isinstance(bound, tuple) and len(bound) != many["signal"]:
        raise UserError(
            f"{where}.divergence_threshold: got {len(bound)} numbers, expected one, or {many['signal']}, one for each "
            "signal."
        )
    if not 0 <= tail < s.duration:
        raise UserError(f"{where}.steady_start: got {tail:g} s, expected less than the duration of {s.duration:g} s.")
    names = [name for name, _ in signals_of(s)]
    for name in s.scoring.headline:
        if name not in names:
            raise unknown(f"{where}.headline", "signal", name, names)
    require_different(names, f"{where}.signals")
