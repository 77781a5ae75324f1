"""The built-in plants, one file each, and the dict of their names."""

from collections.abc import Mapping
from types import ModuleType

import numpy as np
from jaxtyping import PyTree

from pcbench.plants import (
    arm,
    camera_target,
    cart,
    coordinated_turn,
    csth,
    digester,
    double_well,
    falling_body,
    flexible_joint,
    growth,
    helicopter,
    intermittent,
    late_cart,
    lti,
    ncs_reactor,
    ncs_two_state,
    quadruple_tank,
    reactor,
)
from pcbench.plants.factory import PlantSpec, make_plant
from pcbench.scenarios import Scenario

__all__ = ["PLANTS", "PlantSpec", "make_plant"]
UNIT = 1e-12  # largest difference from a unit vector of a row of C that measures one state


def _of(module: ModuleType, summary: str) -> PlantSpec:
    spec = PlantSpec(module.PLANT, module.SIGNALS, module.Numbers(), module.nominal, module.prepare, summary)
    return spec._replace(outputs=getattr(module, "OUTPUTS", ()))


PLANTS: dict[str, PlantSpec] = {
    "cart": _of(cart, "mobile cart below a camera, 2 states")._replace(signs=("drift_sign",)),
    "late-cart": _of(late_cart, "mobile cart with an unknown measurement delay, 2 states")._replace(
        unknowns=late_cart.UNKNOWNS, ranges=((0.0, float("inf")),), drifts=False
    ),
    "csth": _of(csth, "stirred tank heater with three slow sensors, 3 states")._replace(drifts=False),
    "arm": _of(arm, "flexible-joint arm with an unknown input, 4 states")._replace(unknowns=arm.UNKNOWNS, heavy=True),
    "helicopter": _of(helicopter, "helicopter with two angles, unknown viscosities, 4 states")._replace(
        unknowns=helicopter.UNKNOWNS,
        heavy=True,
        model=helicopter.model,
        parts=helicopter.parts,
        inverse=helicopter.inverse,
        positive=("Jth", "Jps", "m", "l", "g", "Bth", "Bps"),
        ranges=helicopter.RANGE,
    ),
    "reactor": _of(reactor, "gas-phase batch reactor with measured total pressure, 2 states")._replace(
        heavy=True, model=reactor.model, positive=("k1", "k2"), drifts=False
    ),
    "ncs-two-state": _of(ncs_two_state, "two-state plant of networked control, 2 states")._replace(drifts=False),
    "ncs-reactor": _of(ncs_reactor, "unstable batch reactor of networked control, 4 states")._replace(drifts=False),
    "intermittent": _of(intermittent, "unstable scalar plant in discrete time, 1 state")._replace(drifts=False),
    "growth-model": _of(growth, "growth model in discrete time with measured square, 1 state")._replace(
        heavy=True, successor=growth.successor, sensor=growth.sensor, drifts=False, tick=growth.TICK
    ),
    "quadruple-tank": _of(quadruple_tank, "four tanks with two pumps and two level sensors, 4 states")._replace(
        heavy=True,
        model=quadruple_tank.model,
        residual=quadruple_tank.residual,
        positive=("A1", "A2", "a1", "a2", "k1", "k2", "kc", "g"),
        drifts=False,
    ),
    "flexible-joint": _of(flexible_joint, "flexible joint with measured motor angle, 4 states")._replace(
        heavy=True, model=flexible_joint.model, residual=flexible_joint.residual, drifts=False
    ),
    "falling-body": _of(falling_body, "falling body seen by a radar, 3 states")._replace(
        heavy=True,
        model=falling_body.model,
        sensor=falling_body.sensor,
        positive=("gamma", "distance"),
        drifts=False,
    ),
    "coordinated-turn": _of(coordinated_turn, "turning aircraft seen by a radar, 5 states")._replace(
        heavy=True,
        successor=coordinated_turn.successor,
        sensor=coordinated_turn.sensor,
        output_residual=coordinated_turn.output_residual,
        errors=coordinated_turn.ERRORS,
        drifts=False,
        tick=coordinated_turn.TICK,
    ),
    "double-well": _of(double_well, "particle in a double well, pushed by noise, 1 state")._replace(
        model=double_well.model, residual=double_well.residual, positive=("rate",), drifts=False
    ),
    "digester": _of(digester, "anaerobic digester with gas sensors and a laboratory, 12 states")._replace(
        heavy=True,
        successor=digester.successor,
        sensor=digester.sensor,
        residual=digester.residual,
        positive=("kF", "kS", "kp", "kl", "kd", "kla", "Kch4", "Kco2", "flow", "p0", "Vl", "Vg"),
        drifts=False,
    ),
    "camera-target": _of(camera_target, "platform that follows a target seen by its camera, 3 states")._replace(
        drifts=False
    ),
    "lti": _of(lti, "your own linear plant, in the table [lti] of a study")._replace(drifts=False),
}


def entry_of(scenario: Scenario) -> PlantSpec:
    """Return a scenario's plant: its user-defined one, or else the one of its name."""
    return scenario.user_code["plant"].entry if "plant" in scenario.user_code else PLANTS[scenario.plant]


def states_of(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """Return (state, unit) of every state of a scenario's plant."""
    return scenario.scoring.signals or entry_of(scenario).signals


def estimated_of(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """Return (signal, unit) of all signals that observers may estimate: states, and unknown inputs or parameters."""
    return states_of(scenario) + (scenario.scoring.unknowns or entry_of(scenario).unknowns)


def signals_of(scenario: Scenario) -> tuple[tuple[str, str], ...]:
    """Return (signal, unit) of all scored signals: those that observers may estimate, and the plant's user-defined errors."""
    return estimated_of(scenario) + entry_of(scenario).errors


def outputs_of_states(scenario: Scenario) -> dict[str, int]:
    """Return the index of the output that measures a state directly, by state."""
    C, states = np.asarray(entry_of(scenario).nominal(numbers_of(scenario)).C), states_of(scenario)
    return {states[j][0]: i for i, row in enumerate(C) for j, unit in enumerate(np.eye(len(row)))
            if np.abs(row - unit).max() < UNIT}  # fmt: skip


def output_units(scenario: Scenario) -> list[str]:
    """Return the unit of every output; empty if the plant names none and it measures no single state."""
    if outputs := entry_of(scenario).outputs:
        return [unit for _, unit in outputs]
    units = dict(states_of(scenario))
    state_units = {output: units[state] for state, output in outputs_of_states(scenario).items()}
    return [state_units.get(i, "") for i in range(len(scenario.sampling.noise_std))]


def numbers_of(scenario: Scenario) -> PyTree:
    """Return a plant's parameters as assumed by observers."""
    return entry_of(scenario).numbers._replace(**scenario.belief.model)


def replace_numbers(numbers: PyTree, values: Mapping[str, object]) -> PyTree:
    """Return a plant's parameters with some changed; named numbers of an [lti] plant are in its `parameters`."""
    fields = {name: v for name, v in values.items() if name in numbers._fields}
    by_name = {name: v for name, v in values.items() if name not in fields}
    out = numbers._replace(**fields)
    if not by_name:
        return out
    plant = {name: v for name, v in out.plant.items() if name not in by_name}
    return out._replace(parameters={**out.parameters, **by_name}, plant=plant)


def differs(numbers: PyTree, values: Mapping[str, object]) -> bool:
    """Return whether given parameters make a plant differ from its default."""
    by_name = getattr(numbers, "parameters", {})
    return any(
        value != (by_name[name] if name in by_name else getattr(numbers, name)) for name, value in values.items()
    )


def drifts(scenario: Scenario) -> bool:
    """Return whether the axis `parameter_drift` has an effect in a scenario."""
    return entry_of(scenario).drifts or "plant" in scenario.truth.parameters


def settles_alone(scenario: Scenario) -> bool:
    """Return whether a linear plant is known exactly and decays to its response to the input, with no disturbance."""
    true, loop = scenario.truth, scenario.loop
    noisy = any(true.process_std) if np.ndim(true.process_std) < 2 else True
    if scenario.plant not in PLANTS or nonlinear(scenario) or loop.controller or noisy:
        return False
    if true.parameter_drift or true.parameters or true.unknown_input:
        return False
    model = entry_of(scenario).nominal(numbers_of(scenario))
    modes = np.linalg.eigvals(model.A)
    return bool(np.abs(modes).max() < 1 if model.discrete else modes.real.max() < 0)


def nonlinear(scenario: Scenario) -> bool:
    """Return whether observers get a nonlinear model of a scenario's plant."""
    plant = entry_of(scenario)
    return plant.model is not None or plant.successor is not None


def parameters_of(plant: PlantSpec) -> list[str]:
    """Return the names of a plant's parameters that a study may vary."""
    numbers = plant.numbers._asdict()
    return [name for name, v in numbers.items() if type(v) is float and name != "drift"]


def parameters_in(scenario: Scenario) -> list[str]:
    """Return the names of the parameters that a study of a scenario may vary, including named ones of an [lti] plant."""
    return [*parameters_of(entry_of(scenario)), *scenario.belief.model.get("parameters", {})]
