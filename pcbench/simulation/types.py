"""Types of a run: the layout that fixes its program, the numbers of a grid point, its state, and the present of a tick."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import PyTree

from pcbench.protocols import Controller, Gains, Leaf, Memory, Now, Observer, Params, Plant
from pcbench.simulation import command_network, metrics

PerLane = Any  # a LaneArray if it differs between runs, else an Array; inside a function of one run, an Array
Memories = dict[str, Memory]  # by observer label, a pytree of PerLane
Snapshots = dict[str, PerLane]  # snapshots by observer label: [r]


class Layout(NamedTuple):
    """The static part of a program. Its numbers, and their shapes and structure, are in `GridPointParams`."""

    plant: Plant
    observers: tuple[tuple[str, Observer], ...]  # (label, functions)
    width: int  # runs per call
    ring: int  # packets the network can hold
    random_initial_state: bool  # x(0) = x0 + spread0 @ normal instead of x0
    watch: bool = True  # record settling time and divergence
    continuous: bool = False  # plant and observers form one field, and y is measured at each of its stages
    drifting: bool = False  # each run has its own plant parameters
    controller: Controller | None = None  # closed loop only, with one observer
    commands: int = 0  # rows in the ring of commands, closed loop only
    scattered: bool = False  # xhat(0) = xhat0 + scatter (2 uniform - 1) instead of xhat0
    pending: int = 0  # room for commands on the network to the plant; 0: an actuator delay
    by_definition: bool = (
        False  # simulate by `simulate_runs`, the definition of a run, instead of the equivalent engine
    )
    consistency: bool = False  # compare errors with the covariances that observers report


class GridPointParams(NamedTuple):
    """The numbers of one grid point, all traced: grid points of the same shapes share one program.

    N ticks, n states, s unknown inputs, m inputs, q outputs.
    """

    params: Params  # of the plant
    gains: dict[str, Gains]  # by observer label
    schedule: PyTree  # a Schedule for all runs; or ClockParams, from which each run draws its own
    inputs: Leaf  # [N+1, m] u held over [t_k, t_k+1); an InputWindow for a recording
    dt: Leaf  # [s]
    x0: Leaf  # [n] the initial state, or its mean
    xhat0: Leaf  # [n]
    spread0: Leaf  # [n, n] a square root of the initial covariance, if the initial state is random
    noise_std: Leaf  # [q]
    band: Leaf  # [n + s + d] settling band of |e|, with d user-defined errors
    bound: Leaf  # [n + s + d] divergence threshold of |e|
    windows: Leaf  # [W, 2] first tick and end of each window; the last is one tick, N-1
    # [n] std of the noise added to each state at every tick, or an [n, n] root; [0]: none
    process_std: Leaf = np.zeros(0)
    jumps: Leaf = np.zeros(0, int)  # [J] ticks of the tail at which the unknown input jumps
    control: PyTree = ()  # parameters of the controller
    line: command_network.DelayLine = command_network.NO_DELAY_LINE
    scatter: Leaf = np.zeros(0)  # [n] of xhat(0), if it is random
    network: PyTree = ()  # command_network.NetworkParams, if commands go over a network
    weights: PyTree = ()  # metrics.Weights, if the input and cost of a closed loop are summed
    outliers: PyTree = ()  # measurements.Outliers, if there are outliers
    rounding: PyTree = ()  # measurements.Rounding, if samples are quantized
    student_t_dof: PyTree = ()  # degrees of freedom of Student's t noise, if used
    trigger: PyTree = ()  # measurements.Trigger, if sensors decide which samples are sent
    # [q, q] lower root of the noise correlation between channels; [0, 0]: independent
    noise_root: Leaf = np.zeros((0, 0))


class InputWindow(NamedTuple):
    """The inputs of some consecutive ticks, for a recording that may be larger than memory."""

    rows: Leaf  # [K, m]
    first: Leaf  # tick of the first row


class Packet(NamedTuple):
    """The measurements of one sampling instant."""

    values: PerLane  # [q] measured values
    snapshots: Snapshots


class ArrivalInfo(NamedTuple):
    """The data of an arrival in addition to its values and snapshots; q outputs."""

    mask: PerLane  # [q] the channels that arrive
    age: PerLane  # [q] assumed age [ticks]
    number: PerLane  # [q] sample number
    ticks_since_arrival: PerLane


class State(NamedTuple):
    """The state of a block of runs between ticks."""

    x: PerLane  # [n]
    plant_draws: PyTree  # random numbers of the run's plant, [plant.drawn]; (): none
    memories: PyTree  # Memories; packed between events if each run has its own schedule
    # packets on the network, in rings; `engine.common_schedule` and `random_schedules` use different forms
    flight: PyTree
    streams: dict[str, metrics.ErrorSums]
    watches: dict[str, metrics.SettlingState]
    commands: PyTree = ()  # [R, m] of a closed loop; command_network.Commands over a network
    tracking: PyTree = ()  # metrics.ErrorSums of set point minus state, in a closed loop
    law: PyTree = ()  # the controller's memory
    effort: PyTree = ()  # metrics.ControlCost of a closed loop


class RunSums(NamedTuple):
    """Sums of a block of runs, by observer label; every array ends in runs [L]. n: signals that the observer estimates."""

    streams: dict[str, metrics.ErrorSums]  # [W, n, L]
    watches: dict[str, metrics.SettlingState]  # [n, L]
    final: dict[str, Array]  # [n, L] error at tick N-1
    tracking: PyTree = ()  # ErrorSums [W, r, L] of a closed loop
    effort: PyTree = ()  # ControlCost [W, L] of a closed loop
    consistency: PyTree = ()  # by observer label, innovation_stats.Squares of observers with a covariance
    actual: PyTree = ()  # [n + s, L] true value of the estimated signals at tick N-1
    sent: PyTree = ()  # [L] share of the samples that were sent, if sensors decide


def present(p: GridPointParams, k: Array, decided: bool, commands: PyTree = ()) -> Now:
    """Return the present at tick k. Plant and flow receive u_k (`decided`); snapshot and jump do not.

    In a closed loop the inputs follow from the `commands` [R, m].
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
        return command_network.delayed_command(p.line, commands, k - age, k if decided else k - 1)

    return Now(k * p.dt, k, p.dt, past_u(jnp.asarray(0 if decided else 1)), past_u)


def params_of(layout: Layout, p: GridPointParams, uniform: PyTree) -> PyTree:
    """Return the plant's parameters in the run with the random numbers `uniform`."""
    return layout.plant.of_run(p.params, uniform) if layout.drifting and layout.plant.of_run else p.params


def truth(layout: Layout, params: Params, now: Now, x: Array) -> Array:
    """Return the true values of all estimated signals: state and unknown inputs, [n + s]."""
    return jnp.append(x, layout.plant.unknown(params, now, x)) if layout.plant.unknown else x
