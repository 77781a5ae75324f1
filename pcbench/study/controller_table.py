"""A study's table `[controller]`: the control law of its scenarios, its options, and its network to the plant."""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, Strict

from pcbench.controllers import CONTROLLERS, ControllerContext
from pcbench.controllers import entry_of as controller_of
from pcbench.controllers.parts.common import Sizes
from pcbench.dynamics.observability import format_mode
from pcbench.errors import DesignError, UserError, unknown
from pcbench.plants import entry_of, numbers_of, states_of
from pcbench.scenarios import Scenario
from pcbench.study import axes, times
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.plugins.user_observers import validate_options
from pcbench.synthesis import lqr
from pcbench.toml_text import TomlTable

Size = Annotated[float, Strict(), Field(ge=0)]


class Network(BaseModel):
    """Keys of `[controller]` for the path to the plant, in addition to the law's own options."""

    model_config = ConfigDict(extra="ignore", allow_inf_nan=False)
    use: str = Field(
        description="control law: "
        + ", ".join(name for name, e in CONTROLLERS.items() if e.check)
        + ", or your own MODULE:NAME"
    )
    actuator_delay: Size = Field(0.0, description="delay from command to plant [s]")
    command_jitter: Size = Field(0.0, description="largest additional delay of a command [s]")
    command_loss: Size = Field(
        0.0, le=1, description="probability that a command is lost; the plant holds the last one"
    )
    command_std: Size = Field(0.0, description="standard deviation of the noise of a command [unit of the input]")


def close_loop(s: Scenario, table: TomlTable, where: str, plugins: Mapping[str, UserPlugin]) -> Scenario:
    """Return a scenario with its loop closed by a study's controller; `plugins` has user-defined controllers by MODULE:NAME.

    Raises UserError with the invalid key.
    """
    config = validate_options(Network, table, where)
    valid = [name for name, entry in CONTROLLERS.items() if entry.check]
    plugin = plugins.get(config.use)
    if plugin is None and config.use not in valid:
        raise unknown(f"{where}.use", "controller for any plant (or MODULE:NAME)", config.use, valid)
    if s.sampling.prefilled:
        raise UserError(
            f"{where}: got a controller for {s.name}, whose sampling began before t = 0, expected a scenario that starts at "
            "t = 0; leave the table out, or use another scenario."
        )
    control = {key: value for key, value in table.items() if key not in Network.model_fields}
    entry = plugin.entry if plugin else CONTROLLERS[config.use]
    fields, allows_extra = entry.options.model_fields, entry.options.model_config.get("extra") == "allow"
    for key in control:
        if key not in fields and not allows_extra:
            raise unknown(where, f"option of {config.use}", key, [*fields, *Network.model_fields])
    options = validate_options(entry.options, control, where)
    if entry_of(s).nominal(numbers_of(s)).feedthrough.any():
        raise UserError(
            f"{where}: got a plant with D in {s.name}, expected none: a closed loop computes the input after the "
            "measurement; leave D out."
        )
    if entry.check:
        entry.check(options, sizes(s, where))
    if s.loop.actuator_delay is not None and not s.loop.controller:
        raise UserError(
            f"{where}: got an actuator_delay of {s.loop.actuator_delay:g} s in {s.name}, whose loop this table closes, "
            "expected none there; write actuator_delay in [controller]."
        )
    network = {name: getattr(config, name) for name in ("actuator_delay", *axes.COMMANDS)}
    for name, value in network.items():
        axes.axis_value(name, value, s, f"{where}.{name}")
    name, code = (plugin.code.name, {**s.user_code, "controller": plugin}) if plugin else (config.use, s.user_code)
    return s.with_fields(controller=name, control=control, input="", user_code=code, **network)


def has_generic_controller(s: Scenario) -> bool:
    """Return whether a scenario's loop is closed by a law for any plant, whose commands are held as they are."""
    return bool(s.loop.controller) and controller_of(s).check is not None


def sizes(s: Scenario, where: str) -> Sizes:
    """Return the sizes that the options of a law must fit."""
    model = entry_of(s).nominal(numbers_of(s))
    states = tuple(name for name, _ in states_of(s))
    return Sizes(states, model.B.shape[1], len(model.C), s.dt, where)


def controller_context(s: Scenario) -> ControllerContext:
    """Return the design context of a controller in a scenario, without the number of ticks and the room for it.

    The model includes the known part of the plant's unknown input, linearised at x = 0.
    """
    model, command_delay = entry_of(s).nominal(numbers_of(s)), s.loop.actuator_delay or 0.0
    if model.nonlinearity is not None and model.E is not None:
        import jax
        import jax.numpy as jnp

        known_part = jax.tree.map(jnp.asarray, model.nonlinearity)
        slope = np.asarray(jax.jacfwd(known_part)(jnp.zeros(len(model.A))))
        model = model._replace(A=model.A + model.E @ slope)
    return ControllerContext(
        model=model,
        dt=s.dt,
        ticks=0,
        rows=0,
        lookahead=0,
        late=times.to_ticks(command_delay, s) + times.to_ticks(s.loop.command_jitter, s) // 2,
        states=tuple(name for name, _ in states_of(s)),
        delay=times.actuator_delay(s),
    )


class SlowestMode(NamedTuple):
    """The eigenvalue of a closed loop with the largest absolute value, over one period of its controller."""

    mode: complex
    delay: float  # [s] of a command
    period: float  # [s]


def slowest_mode(s: Scenario, where: str) -> SlowestMode | None:
    """Return the slowest mode of a scenario's loop with known state; None without a law for any plant or a linear one."""
    entry = controller_of(s) if has_generic_controller(s) else None
    if entry is None or entry.linear is None:
        return None
    context, options = controller_context(s), entry.options.model_validate(dict(s.loop.control))
    try:
        law = entry.linear(options, context)
    except DesignError as error:
        raise DesignError(f"{where}: {error}") from None
    if law is None:
        return None
    delay = 0 if getattr(options, "knows_delay", False) else context.late
    period = context.period_ticks(getattr(options, "period", None))
    modes = np.linalg.eigvals(lqr.monodromy_matrix(context.tick, law, period, delay))
    return SlowestMode(complex(modes[np.argmax(np.abs(modes))]), delay * s.dt, period * s.dt)


def warning(s: Scenario, where: str) -> str:
    """Return a sentence with the unstable eigenvalue of a scenario's loop; empty if the loop is stable."""
    mode = slowest_mode(s, where)
    if mode is None or abs(mode.mode) < 1:
        return ""
    return (
        f"{where}: with commands delayed by {mode.delay:g} s, {s.loop.controller} does not stabilise the plant of "
        f"{s.name}: the closed loop has the eigenvalue {format_mode(mode.mode)} over {mode.period:g} s, of size "
        f"{abs(mode.mode):.6g}, expected below 1."
    )
