"""What a run is made of: the layout that fixes its program, the numbers of its cell, its state, and the present of a tick."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.protocols import Controller, Gains, Leaf, Memory, Now, Observer, Params, Plant
from pcbench.simulation import command_network, metrics

PerLane = (
    Any  # a LaneArray where it differs between lanes, an Array where it does not; inside a one-lane function, an Array
)
Memories = dict[str, Memory]  # by observer label, a pytree of PerLane
Notes = dict[str, PerLane]  # by observer label: [r]


class Layout(NamedTuple):
    """What is compiled into the program, with the shapes and the structure of a `GridPointParams`, whose numbers are traced."""

    plant: Plant
    observers: tuple[tuple[str, Observer], ...]  # (label, functions)
    width: int  # lanes
    ring: int  # packets the network can hold
    random_initial_state: bool  # x(0) = x0 + spread0 @ normal instead of x0
    watch: bool = True  # settling time and divergence, besides the streams
    continuous: bool = False  # plant and observers are one field, and y is measured at each of its stages
    drifting: bool = False  # the plant's numbers are of each run's own
    controller: Controller | None = None  # of a closed loop, which has one observer
    commands: int = 0  # rows of the closed loop's ring of commands
    scattered: bool = False  # xhat(0) = xhat0 + scatter (2 uniform - 1) instead of xhat0
    pending: int = 0  # commands that a network on the way to the plant has room for; 0: there is an actuator line
    defined: bool = False  # the program is `simulate_runs` itself, not the engine that is equal to it
    consistency: bool = False  # errors are compared with the covariances that observers believe them to have


class GridPointParams(NamedTuple):
    """The numbers of one cell, all traced: another cell of these shapes runs the same program.

    N ticks, n states, s unknowns beside them, m inputs, q outputs.
    """

    params: Params  # the plant's
    gains: dict[str, Gains]  # by observer label
    schedule: PyTree  # a Schedule, the same for every run; or ClockParams: then each run draws its own
    inputs: Leaf  # [N+1, m] u held over [t_k, t_k+1); of a recording, InputWindow
    dt: Leaf  # [s]
    x0: Leaf  # [n] the start, or its mean
    xhat0: Leaf  # [n]
    spread0: Leaf  # [n, n] a square root of the start's covariance, where it is random
    noise_std: Leaf  # [q]
    band: Leaf  # [n + s + d], d errors of a user's own: settling band of |e|
    bound: Leaf  # [n + s + d] beyond it a run has diverged
    windows: Leaf  # [W, 2] first tick and end of each window; the last is one tick, N-1
    process_std: Leaf = np.zeros(0)  # [n] of the noise added to each state at every tick, or [n, n] a root; [0]: none
    jumps: Leaf = np.zeros(0, int)  # [J] ticks of the tail at which the unknown input jumps
    control: PyTree = ()  # the controller's numbers
    line: command_network.Line = command_network.NONE
    scatter: Leaf = np.zeros(0)  # [n] of xhat(0), where it is random
    network: PyTree = ()  # command_network.Numbers, where commands are sent over one
    weights: PyTree = ()  # metrics.Weights of a closed loop whose input and cost are summed
    outliers: PyTree = ()  # measurements.Outliers, where some samples are
    rounding: PyTree = ()  # measurements.Rounding, where samples are rounded
    tail: PyTree = ()  # degrees of freedom of the noise of samples, where that is Student's t
    trigger: PyTree = ()  # measurements.Trigger, where not every sample is sent
    noise_root: Leaf = np.zeros((0, 0))  # [q, q] lower root of its correlation between channels; [0, 0]: independent


class InputWindow(NamedTuple):
    """The inputs of some ticks in a row, in place of all: of a log, which may be longer than memory."""

    rows: Leaf  # [K, m]
    first: Leaf  # the tick of the first of them


class Packet(NamedTuple):
    """What travels together: one sampling instant."""

    values: PerLane  # [q] what was measured
    notes: Notes


class ArrivalInfo(NamedTuple):
    """What an arrival has besides its values and notes; q outputs."""

    mask: PerLane  # [q]
    age: PerLane  # [q] ticks, as assumed
    number: PerLane  # [q]
    ticks_since_arrival: PerLane


class State(NamedTuple):
    """What a block of lanes carries from tick to tick."""

    x: PerLane  # [n]
    drawn: PyTree  # numbers the run has drawn for its plant, [plant.drawn]; (): none
    memories: PyTree  # Memories; between events on schedules of their own, packed
    flight: PyTree  # packets on the network, in rings: `engine.common_schedule` and `random_schedules` have their own
    streams: dict[str, metrics.ErrorSums]
    watches: dict[str, metrics.SettlingState]
    commands: PyTree = ()  # [R, m] of a closed loop; command_network.Commands where they are sent over a network
    tracking: PyTree = ()  # metrics.ErrorSums of the set point less the state, in a closed loop
    law: PyTree = ()  # what the controller keeps
    effort: PyTree = ()  # metrics.ControlCost of a closed loop


class RunSums(NamedTuple):
    """What a block of lanes leaves, by observer label; every array ends in lanes [L]. n: what the observer estimates."""

    streams: dict[str, metrics.ErrorSums]  # [W, n, L]
    watches: dict[str, metrics.SettlingState]  # [n, L]
    final: dict[str, Array]  # [n, L] the error at tick N-1
    tracking: PyTree = ()  # ErrorSums [W, r, L] of a closed loop
    effort: PyTree = ()  # ControlCost [W, L] of a closed loop
    consistency: PyTree = ()  # by observer label, innovation_stats.Squares of those that have a covariance
    actual: PyTree = ()  # [n + s, L] what observers estimate, as it is at tick N-1
    sent: PyTree = ()  # [L] share of the samples that were sent, where not every one is


def present(p: GridPointParams, k: Array, decided: bool, commands: PyTree = ()) -> Now:
    """The present at tick k; u_k is known (`decided`) to the plant and to flow, not to snapshot and jump.

    In a closed loop the inputs are those that the `commands` [R, m] become.
    """

    def past_u(age: Array) -> Array:
        if isinstance(commands, command_network.Commands):
            newest = k if decided else k - 1
            return command_network.input_at(commands, k - age, newest)
        if isinstance(p.inputs, InputWindow):
            place = jnp.clip(k - age - p.inputs.first, 0, len(p.inputs.rows) - 1)
            return jnp.where(age <= k, p.inputs.rows[place], 0.0)
        if isinstance(commands, tuple):
            return jnp.where(k >= age, p.inputs[jnp.maximum(k - age, 0)], 0.0)
        return command_network.read(p.line, commands, k - age, k if decided else k - 1)

    return Now(k * p.dt, k, p.dt, past_u(jnp.asarray(0 if decided else 1)), past_u)


def params_of(layout: Layout, p: GridPointParams, drawn: PyTree) -> PyTree:
    """Return the plant's numbers in the run that has `drawn` its own."""
    return layout.plant.of_run(p.params, drawn) if layout.drifting and layout.plant.of_run else p.params


def truth(layout: Layout, params: Params, now: Now, x: Array) -> Array:
    """Return what observers estimate, as it is: the state, and what the plant has of unknowns, [n + s]."""
    return jnp.append(x, layout.plant.unknown(params, now, x)) if layout.plant.unknown else x
