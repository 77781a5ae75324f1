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
UNCHECKED_KEYS = ("prefilled", "continuous", "drift_intensity", "steady_start", "options")


def scenario_of(table: ScenarioTable, name: str, where: str, plugins: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario of a table; `plugins` has user-defined plants and controllers by MODULE:NAME.

    Raises UserError with the invalid key.
    """
    if name in SCENARIOS or name == "lti":
        raise UserError(
            f"{where}.name: got '{name}', expected a name that no other scenario has; write another, such as "
            f"'my-{name.replace('/', '-')}'."
        )
    values = table.as_table()
    s = _base(table, values, where)._replace(name=name)
    s = s.with_fields(**{key: values[key] for key in ("dt", "duration") if key in values})
    times.ticks_of(s.duration, s.dt, where)
    s = _with_plant(s, values, where, plugins)
    s = experiment_on(s, values, where, plugins, is_new=table.base is None)
    if s.sampling.continuous and (entry_of(s).plant.field is None or entry_of(s).nominal(numbers_of(s)).discrete):
        raise UserError(
            f"{where}.continuous: got true for {s.plant}, expected a plant that is a vector field; leave it out."
        )
    return s


def experiment_on(
    s: Scenario, values: TomlTable, where: str, plugins: Mapping[str, UserPlugin] = NOTHING, is_new: bool = True
) -> Scenario:
    """Return a scenario that has a plant with the experiment of a table; a new scenario gets defaults.

    Raises UserError with the invalid key.
    """
    entry, model = entry_of(s), entry_of(s).nominal(numbers_of(s))
    sizes = {"n": len(model.A), "s": len(estimated_of(s)) - len(states_of(s)), "q": len(model.C)}
    sizes["signal"] = len(signals_of(s))
    for key, (size, _) in SIZES.items():
        if key in values and not isinstance(values[key], list):
            values[key] = [float(values[key])] * sizes[size]
    for key in ("process_std", "assumed_process_std"):
        if key in values and (
            bad_rows := [i for i, row in enumerate(values[key]) if isinstance(row, list) and len(row) != sizes["n"]]
        ):
            got = len(values[key][bad_rows[0]])
            raise UserError(
                f"{where}.{key}[{bad_rows[0]}]: got {got} numbers, expected {sizes['n']}, one for each state."
            )
        values |= {key: [tuple(row) if isinstance(row, list) else row for row in values[key]]} if key in values else {}
    s = s.with_fields(**{key: tuple(values[key]) for key in (*SIZES, "delay_sine", "headline") if key in values})
    if is_new:
        s = with_defaults(s, sizes["n"], sizes["s"], len(entry.errors)).with_fields(
            steady_start=round(0.3 * s.duration / s.dt) * s.dt
        )
        s = s if "controller" in values or "input" in values else s.with_fields(input="sine")
        linear = ("kf", "model-only") if entry.model is None or entry.residual is not None else ()
        observers = linear if entry.model is None else ("ekf", *linear)
        s = s if "observers" in values else s._replace(observers=observers)
    s = _resolve_axis_fields(s, values, sizes["q"], where)
    s = s.with_fields(**{key: values[key] for key in UNCHECKED_KEYS if key in values})
    if "noise_correlation" in values:
        s = s.with_fields(noise_correlation=tuple(map(tuple, values["noise_correlation"])))
    if (limit := values.get("divergence_threshold")) is not None:
        s = s.with_fields(divergence_threshold=tuple(limit) if isinstance(limit, list) else limit)
    s = _with_inputs(s, values, model.B.shape[1], where, plugins)
    _require_fit(s, sizes, where)
    return s


def with_defaults(s: Scenario, n: int, unknowns: int, errors: int = 0) -> Scenario:
    """Return a scenario with defaults for its n states, its unknown inputs and its errors, except x(0)."""
    x0, xhat0 = s.truth.x0, s.belief.xhat0 or (0.0,) * n
    distance = tuple(abs(a - b) or 1.0 for a, b in zip(x0, xhat0, strict=False))
    prior, unknown_std = s.belief.prior_std or distance, s.belief.unknown_std or (1.0,) * unknowns
    extra = (*unknown_std, *(1.0,) * errors)
    defaults = zip((*prior, *extra), (*distance, *extra), strict=False)
    band = s.scoring.settle_band or tuple(0.05 * (p or default) for p, default in defaults)
    return s.with_fields(xhat0=xhat0, prior_std=prior, unknown_std=unknown_std, settle_band=band)


def _base(table: ScenarioTable, values: TomlTable, where: str) -> Scenario:
    """Return the scenario that the table's keys change: the base, or one with only the required keys."""
    observers = tuple(values.get("observers", ()))
    if table.base is not None:
        if table.base not in SCENARIOS:
            raise unknown(f"{where}.base", "built-in scenario", table.base, SCENARIOS)
        base = SCENARIOS[table.base]
        return base._replace(
            summary=values.get("summary", f"{base.name}, changed"),
            source=values.get("source", f"the study, after {base.source}"),
            observers=observers or base.observers,
        )
    for key in REQUIRED:
        if key not in values:
            raise UserError(f"{where}: {key} is missing; write {key} = ..., or base = a built-in scenario.")
    return Scenario(
        name="",
        summary=values.get("summary", "a user's scenario"),
        source=values.get("source", "the study"),
        plant="",
        observers=observers,
        truth=Truth(()),
        loop=Loop(),
        sampling=Sampling((), (), ()),
        belief=Belief((), ()),
        scoring=Scoring((), 1e6),
    )


def _with_plant(s: Scenario, values: TomlTable, where: str, plugins: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario with its plant, the plant's parameters and its signals."""
    valid = [name for name in PLANTS if name != "lti"]
    plant = values.get("plant", s.plant)
    if plant == "lti":
        raise UserError(
            f"{where}.plant: got 'lti', expected a plant with its own equations; write the table [lti] for a linear plant."
        )
    if plugin := plugins.get(plant):
        s = s._replace(plant=plugin.code.name, user_code={**s.user_code, "plant": plugin})
    elif plant not in valid:
        raise unknown(f"{where}.plant", "plant (or MODULE:NAME)", plant, valid)
    else:
        s = s._replace(plant=plant)
    entry = entry_of(s)
    observer_parameters = [name for name in entry.numbers._fields if name not in ("drift", "unknown_input")]
    for table, valid_names in (("parameters", parameters_of(entry)), ("model", observer_parameters)):
        numbers = {}
        for name, value in values.get(table, {}).items():
            if name not in valid_names:
                raise unknown(f"{where}.{table}", f"parameter of plant {s.plant}", name, valid_names)
            default = getattr(entry.numbers, name)
            if type(default) is float:
                value = axes.axis_value(f"plant.{name}", value, s, f"{where}.{table}.{name}")
            elif type(value) is not type(default):
                raise UserError(
                    f"{where}.{table}.{name}: got {brief_repr(value)}, expected a value such as {brief_repr(default)}."
                )
            numbers[name] = value
        s = s.with_fields(**{table: numbers}) if table in values else s
    for key, signals in (("signals", entry.signals), ("unknowns", entry.unknowns)):
        if texts := values.get(key):
            if len(texts) != len(signals):
                raise UserError(f"{where}.{key}: got {len(texts)} names, expected {len(signals)}.")
            s = s.with_fields(**{key: names_and_units(texts, f"{where}.{key}")})
    return s


def _resolve_axis_fields(s: Scenario, values: TomlTable, q: int, where: str) -> Scenario:
    """Return the scenario with the axes' fields in the form of an axis: whole ticks, one value per output."""
    if len(s.sampling.delay) != q:
        s = s.with_fields(delay=(0.0,) * q, sampling_period=(s.dt,) * q, noise_std=(0.0,) * q)
    has_new_ticks = "dt" in values or "duration" in values  # times of a base may not fit the new ticks
    for key in (name for name in axes.AXES if name not in axes.STATES):
        if key in values or (has_new_ticks and s.value(key) is not None):
            entry = values.get(
                key, axes.plain(key, s.value(key), as_list=True) if key not in axes.LISTS else s.value(key)
            )
            entry = INTERVAL if entry == [None] * q else entry
            s = s.with_fields(**{key: axes.axis_value(key, entry, s, f"{where}.{key}")})
    return s


def _with_inputs(s: Scenario, values: TomlTable, m: int, where: str, plugins: Mapping[str, UserPlugin]) -> Scenario:
    """Return the scenario with its input, its controller and its unknown input."""
    entry, ticks = entry_of(s), (times.to_ticks(s.duration, s), s.dt)
    loop = {key: values[key] for key in ("input", "controller", "control") if key in values}
    if plugin := plugins.get(loop.get("controller", "")):
        loop["controller"] = plugin.code.name
        s = s._replace(user_code={**s.user_code, "controller": plugin})
    s = s.with_fields(**loop)
    if loop.get("input") and s.loop.controller and "controller" not in loop:
        s = s.with_fields(controller="", control={})  # an input replaces the controller of a base
    elif loop.get("controller") and "input" not in loop:
        s = s.with_fields(input="")
    if bool(s.loop.input) == bool(s.loop.controller):
        raise UserError(
            f"{where}: got {'an input and a controller' if s.loop.input else 'neither an input nor a controller'}, expected "
            "one of them; write input = ... for an open loop, controller = ... for a closed one."
        )
    if s.loop.controller:
        _require_controller(s, entry, where)
    elif not isinstance(s.loop.input, tuple):  # from the base
        signals = sources(s.loop.input, m, SIGNALS, ticks, "inputs", f"{where}.input")
        s = s if isinstance(s.loop.input, str) else s.with_fields(input=signals)
    for key in axes.COMMANDS:
        if value := values.get(key):
            if key not in axes.axes_of(s):
                raise UserError(
                    f"{where}.{key}: got {brief_repr(value)} where no controller for any plant gives commands, expected none; "
                    "leave it out."
                )
            s = s.with_fields(**{key: axes.axis_value(key, value, s, f"{where}.{key}")})
    unknown_input = values.get("unknown_input")
    if unknown_input == "":
        return s.with_fields(unknown_input="")
    if unknown_input:
        place = f"{where}.unknown_input"
        if "unknown_input" not in entry.numbers._fields:
            raise UserError(
                f"{place}: got {brief_repr(unknown_input)} for {s.plant}, expected none: it has no unknown input; leave it out."
            )
        n_unknowns = len(estimated_of(s)) - len(states_of(s))
        signals = sources(unknown_input, n_unknowns, SINGLE, ticks, "unknown inputs", place)
        s = s.with_fields(unknown_input=unknown_input if isinstance(unknown_input, str) else signals)
    return s


def _require_controller(s: Scenario, entry: PlantSpec, where: str) -> None:
    """Raise UserError for a controller that is unknown or unsupported by the plant, and for invalid options."""
    name, control = s.loop.controller, dict(s.loop.control)
    if name not in CONTROLLERS and "controller" not in s.user_code:
        raise unknown(f"{where}.controller", "controller (or MODULE:NAME)", name, CONTROLLERS)
    if name == "pd" and entry.inverse is None:
        plants = ", ".join(p for p, plant in PLANTS.items() if plant.inverse)
        raise UserError(f"{where}.controller: got 'pd' on {s.plant}, expected a plant that it supports: {plants}.")
    spec = controller_of(s)
    options = validate_options(spec.options, control, f"{where}.control")
    if "path" in control and control["path"] not in PATHS:
        raise unknown(f"{where}.control.path", "path", str(control["path"]), PATHS)
    if spec.check:
        spec.check(options, controller_table.sizes(s, f"{where}.control"))


def _require_fit(s: Scenario, sizes: dict[str, int], where: str) -> None:
    """Raise UserError for a list of the wrong length, and for invalid scoring."""
    for key, (size, optional) in SIZES.items():
        got, expected = len(s.value(key)), sizes[size]
        if got != expected and not (optional and not got):
            raise UserError(
                f"{where}.{key}: got {got} numbers, expected {expected}, one for each {EACH[size]}"
                + (f" of {s.plant}." if s.plant != "lti" else ".")
            )
    threshold, start = s.scoring.divergence_threshold, s.scoring.steady_start
    if isinstance(threshold, tuple) and len(threshold) != sizes["signal"]:
        raise UserError(
            f"{where}.divergence_threshold: got {len(threshold)} numbers, expected one, or {sizes['signal']}, one for each "
            "signal."
        )
    if not 0 <= start < s.duration:
        raise UserError(f"{where}.steady_start: got {start:g} s, expected less than the duration of {s.duration:g} s.")
    names = [name for name, _ in signals_of(s)]
    for name in s.scoring.headline:
        if name not in names:
            raise unknown(f"{where}.headline", "signal", name, names)
    require_different(names, f"{where}.signals")
