"""From a study's table `[scenario]` to a scenario: what is left out filled in, and all of it fitted to the plant.

Every mistake ends in one sentence: where, what was found, what was expected, what to write instead.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from pcbench.controllers import entry_of as controller_of
from pcbench.errors import UserError, shown, unknown
from pcbench.plants import PLANTS, entry_of, numbers_of, parameters_of, signals_of, states_of
from pcbench.scenarios import INTERVAL, SCENARIOS, Belief, Loop, Sampling, Scenario, Scoring, Truth
from pcbench.scenarios.signals import SIGNALS, SINGLE
from pcbench.scenarios.sources import Sources
from pcbench.study import axes, controller_table, times
from pcbench.study import validate as fit
from pcbench.study.lti_inputs import sources
from pcbench.study.plugins.user_code import Own
from pcbench.study.scenario_schema import ScenarioTable

REQUIRED = ("plant", "x0", "sampling_period", "delay", "noise_std")


def scenario_of(table: ScenarioTable, name: str, where: str, own: Mapping[str, Own]) -> Scenario:
    """Return the scenario that a table describes; `own` has the plants and controllers of the user's, by MODULE:NAME.

    Raises UserError naming the key that does not fit.
    """
    if name in SCENARIOS or name == "lti":
        raise UserError(
            f"{where}.name: got '{name}', expected a name that no other scenario has; write another, such as "
            f"'my-{name.replace('/', '-')}'."
        )
    given = table.given()
    start = _base(table, given, where)._replace(name=name)
    start = start.having(**{key: given[key] for key in ("dt", "duration") if key in given})
    times.ticks_of(start.duration, start.dt, where)
    s = _of_plant(start, given, where, own)
    entry, model = entry_of(s), entry_of(s).nominal(numbers_of(s))
    many = {"n": len(model.A), "s": len(signals_of(s)) - len(states_of(s)), "q": len(model.C)}
    many["n + s"] = many["n"] + many["s"]
    given |= {key: fit.each(given[key], many[size]) for key, (size, _) in fit.SIZES.items() if key in given}
    s = s.having(**{key: tuple(given[key]) for key in (*fit.SIZES, "delay_sine", "headline") if key in given})
    s = _filled(s, given, many) if table.base is None else s
    s = _measured(s, given, many["q"], where)
    plain = ("prefilled", "continuous", "drift_intensity", "steady_start", "options")
    s = s.having(**{key: given[key] for key in plain if key in given})
    if (limit := given.get("divergence_threshold")) is not None:
        s = s.having(divergence_threshold=tuple(limit) if isinstance(limit, list) else limit)
    s = _driven(s, given, model.B.shape[1], where, own)
    fit.require_fit(s, many, entry, where)
    if s.sampling.continuous and (entry.plant.field is None or model.discrete):
        raise UserError(
            f"{where}.continuous: got true for {s.plant}, expected a plant that is a vector field; leave it out."
        )
    return s


def _base(table: ScenarioTable, given: dict[str, Any], where: str) -> Scenario:
    """The scenario that the table's keys change: a published one, or one of nothing but what must be given."""
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
        summary=given.get("summary", "a scenario of one's own"),
        source=given.get("source", "the study"),
        plant="",
        observers=observers,
        truth=Truth(()),
        loop=Loop(),
        sampling=Sampling((), (), ()),
        belief=Belief((), ()),
        scoring=Scoring((), 1e6),
    )


def _of_plant(s: Scenario, given: dict[str, Any], where: str, own: Mapping[str, Own]) -> Scenario:
    """The scenario with its plant: what it is called, its parameters, its signals."""
    valid = [name for name in PLANTS if name != "lti"]
    plant = given.get("plant", s.plant)
    if plant == "lti":
        raise UserError(
            f"{where}.plant: got 'lti', expected a plant with equations of its own; write the table [lti] for a linear plant."
        )
    if mine := own.get(plant):
        s = s._replace(plant=mine.code.name, own={**s.own, "plant": mine})
    elif plant not in valid:
        raise unknown(f"{where}.plant", "plant (or MODULE:NAME)", plant, valid)
    else:
        s = s._replace(plant=plant)
    if "parameters" in given:
        known = parameters_of(entry_of(s))
        s = s.having(
            parameters={k: _parameter(s, k, v, known, f"{where}.parameters") for k, v in given["parameters"].items()}
        )
    if "model" in given:
        known = [name for name in entry_of(s).numbers._fields if name not in ("drift", "unknown_input")]
        s = s.having(model={k: _parameter(s, k, v, known, f"{where}.model") for k, v in given["model"].items()})
    states, unknowns = entry_of(s).signals, entry_of(s).unknowns
    for key, known_ones in (("signals", states), ("unknowns", unknowns)):
        if given.get(key):
            s = s.having(**{key: fit.signals(given[key], len(known_ones), f"{where}.{key}")})
    return s


def _parameter(s: Scenario, name: str, value: Any, known: list[str], where: str) -> Any:
    """A parameter of a plant: a number, or what the plant has in its place."""
    if name not in known:
        raise unknown(where, f"parameter of plant {s.plant}", name, known)
    own = getattr(entry_of(s).numbers, name)
    if type(own) is float:
        return axes.point(f"plant.{name}", value, s, f"{where}.{name}")
    if type(value) is not type(own):
        raise UserError(f"{where}.{name}: got {shown(value)}, expected a value such as {shown(own)}.")
    return value


def _filled(s: Scenario, given: dict[str, Any], many: dict[str, int]) -> Scenario:
    """The scenario with a value for everything that neither a base nor the table says."""
    x0 = s.truth.x0
    xhat0 = s.belief.xhat0 or (0.0,) * many["n"]
    apart = tuple(abs(a - b) or 1.0 for a, b in zip(x0, xhat0, strict=False))
    prior = s.belief.prior_std or apart
    size = s.belief.unknown_std or (1.0,) * many["s"]
    band = s.scoring.settle_band or tuple(
        0.05 * (p or default) for p, default in zip((*prior, *size), (*apart, *size), strict=False)
    )
    tail = round(0.3 * s.duration / s.dt) * s.dt
    s = s.having(xhat0=xhat0, prior_std=prior, unknown_std=size, settle_band=band, steady_start=tail)
    if "controller" not in given and "input" not in given:
        s = s.having(input="sine")
    entry = entry_of(s)
    linear = ("kf", "model-only") if entry.model is None or entry.residual is not None else ()
    usual = ("ekf", *linear) if entry.model is not None else linear
    return s if "observers" in given else s._replace(observers=usual)


def _measured(s: Scenario, given: dict[str, Any], q: int, where: str) -> Scenario:
    """The scenario with the axes' fields as an axis would have them: whole ticks, one value for each output."""
    if len(s.sampling.delay) != q:
        s = s.having(delay=(0.0,) * q, sampling_period=(s.dt,) * q, noise_std=(0.0,) * q)
    changed = "dt" in given or "duration" in given  # then times of a base may fit no more
    for key in (name for name in axes.AXES if name not in axes.STATES):
        if key in given or (changed and s.value(key) is not None):
            value = given.get(key, axes.plain(key, s.value(key), apart=True) if key not in axes.LISTS else s.value(key))
            value = INTERVAL if value == [None] * q else value
            s = s.having(**{key: axes.point(key, value, s, f"{where}.{key}")})
    return s


def _driven(s: Scenario, given: dict[str, Any], m: int, where: str, own: Mapping[str, Own]) -> Scenario:
    """The scenario with its input, its controller and its unknown input."""
    entry = entry_of(s)
    loop = {key: given[key] for key in ("input", "controller", "control") if key in given}
    commands = {key: given[key] for key in axes.COMMANDS if given.get(key)}
    if mine := own.get(loop.get("controller", "")):
        loop["controller"] = mine.code.name
        s = s._replace(own={**s.own, "controller": mine})
    s = s.having(**loop)
    if loop.get("input") and s.loop.controller and "controller" not in loop:
        s = s.having(controller="", control={})  # an input opens the loop of a base
    elif loop.get("controller") and "input" not in loop:
        s = s.having(input="")
    if bool(s.loop.input) == bool(s.loop.controller):
        raise UserError(
            f"{where}: got {'an input and a controller' if s.loop.input else 'neither an input nor a controller'}, expected "
            "one of them; write input = ... for an open loop, controller = ... for a closed one."
        )
    if s.loop.controller:
        s = s.having(control=fit.control(s, entry, where))
        law = controller_of(s)
        if law.check:
            law.check(law.options.model_validate(dict(s.loop.control)), controller_table.sizes(s, f"{where}.control"))
    else:
        s = s.having(input=_sources(s, s.loop.input, m, SIGNALS, "input", f"{where}.input"))
    for key, value in commands.items():
        if key not in axes.axes_of(s):
            raise UserError(
                f"{where}.{key}: got {shown(value)} where no controller for any plant gives commands, expected none; "
                "leave it out."
            )
        s = s.having(**{key: axes.point(key, value, s, f"{where}.{key}")})
    if given.get("unknown_input"):
        if "unknown_input" not in entry.numbers._fields:
            raise UserError(
                f"{where}.unknown_input: got {shown(given['unknown_input'])} for {s.plant}, expected none: it has no unknown "
                "input; leave it out."
            )
        many = len(signals_of(s)) - len(states_of(s))
        pushing = _sources(s, given["unknown_input"], many, SINGLE, "unknown input", f"{where}.unknown_input")
        s = s.having(unknown_input=pushing)
    return s.having(unknown_input="") if given.get("unknown_input") == "" else s


def _sources(s: Scenario, given: Any, many: int, valid: Iterable[str], kind: str, where: str) -> Sources:
    """What drives `many` inputs, from a signal's names or from data."""
    if isinstance(given, str):
        fit.require_names(given, valid, many, kind, where)
        return given
    if isinstance(given, tuple):  # a base's
        return given
    return sources(given, many, valid, (times.whole(s.duration, s), s.dt), f"{kind}s", where)
