"""Protocols of plants, observers and controllers: NamedTuples of pure functions, with a pytree of arrays.

Every function is written for one run; `engine/interpreter` vectorizes it over thousands. Array shapes use n states, m inputs,
q outputs and s unknown inputs or parameters. Time is counted in ticks of `dt` seconds.

Order of events at tick k: sense, deliver, estimate, control, flow. Values are right-continuous: the estimate of tick k is read
after the jump of tick k, and in a closed loop the command of tick k is computed from it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int, PyTree, UInt32

Leaf = Any  # an array in a pytree of parameters: of NumPy in a design, of jax when traced
Room = Leaf  # zeros; only their shape matters, because a shape is static under jit and a value is not
Params = PyTree  # a pytree of arrays: parameters of a plant or a controller
Gains = PyTree  # a pytree of arrays: parameters of an observer, traced, never captured in a closure
Memory = PyTree  # a pytree of arrays: an observer's state between ticks
Delay = Callable[[ArrayLike], ArrayLike]  # of a closed loop: t [s], an array -> tau [s]


UNIT_NAME = "pcbench_together"  # the name by which simulations recognise a function that `vmap_as_unit` returned


def vmap_as_unit(f: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Mark a function to be vectorized over runs as a unit, by `jax.vmap`.

    Use it for functions that are large, or that have arrays of hundreds of entries. Other functions are vectorized entry by
    entry, which is faster for small arrays, but slow to compile for large ones.

    Args:
        f: a function of arrays, of one run.

    Returns:
        The function, compiled as a unit.
    """

    def wrapper(*args: PyTree) -> PyTree:
        return f(*args)

    wrapper.__name__ = UNIT_NAME  # unlike the name of any user's function
    return jax.jit(wrapper)


class Now(NamedTuple):
    """The present time and the inputs applied until now, as functions of plants and observers receive them.

    `u` and `past_u` are the input *applied* to the plant, held over [t_k, t_k+1). In `flow` and `step`, `u` is u_k,
    which equals `past_u(0)`. In `snapshot` and `jump` u_k is not yet decided: `u` is u_(k-1) and `past_u` needs age >= 1.
    Before t = 0 the input is 0. In a closed loop it follows from the commands of that time. A loop stores the inputs that
    its schedule needs. `past_u` of an older one is NaN.
    """

    t: Float[Array, ""]  # time [s]
    tick: Int[Array, ""]  # index of the tick
    dt: Float[Array, ""]  # duration of a tick [s]
    u: Float[Array, " m"]  # input held over the tick
    past_u: Callable[[Array], Array]  # age [ticks] -> the input applied `age` ticks ago


class Arrival(NamedTuple):
    """A measurement that arrives at `jump`, with all channels that were sampled at the same time."""

    value: Float[Array, " q"]  # measured values; a value is meaningless if its `mask` is False
    mask: Bool[Array, " q"]  # whether the channel has arrived
    age: Int[Array, " q"]  # ticks since the sample was taken, according to its timestamp
    index: Int[Array, " q"]  # type: ignore[assignment]  # index of the sample in its channel (0 is the first)
    snapshot: Float[Array, " snapshot"]  # result of `snapshot` at the tick at which the timestamp puts the sample
    # ticks since the last tick at which a measurement arrived (from tick 0 before the first)
    ticks_since_arrival: Int[Array, ""]
    # noise variance of each value divided by the variance assumed in the design; None unless a recording contains variances
    variance_ratio: Float[Array, " q"] | None = None
    # whether the channel was sampled at the same time and its sensor did not send the sample; None unless sensors decide
    silent: Bool[Array, " q"] | None = None


class Step(Protocol):
    """Return x one tick later, under the held now.u."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " n"]: ...


class Output(Protocol):
    """Return the measured outputs y of x."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " q"]: ...


class PlantField(Protocol):
    """Return dx/dt under the held now.u; now.t is the time of a Runge-Kutta stage."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " n"]: ...


class Unknown(Protocol):
    """Return the unknown inputs or parameters at now.t. Observers do not get them."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " s"]: ...


class OwnErrors(Protocol):
    """Return user-defined errors of the state x and its estimate xhat; their metrics are those of the states' errors."""

    def __call__(
        self, params: Params, now: Now, x: Float[Array, " n"], xhat: Float[Array, " n"], /
    ) -> Float[Array, " d"]: ...


class OfRun(Protocol):
    """Return the parameters of one run, from its uniform random numbers in [0, 1)."""

    def __call__(self, params: Params, uniform: Float[Array, " drawn"], /) -> Params: ...


class Plant(NamedTuple):
    """A plant as pure functions of its numbers `params`.

    Observers do not get the unknown inputs or parameters `unknown`, but may estimate them in addition to the state. A plant
    has either `unknown` or `errors`.
    """

    step: Step  # the state one tick later
    output: Output  # the measured outputs
    field: PlantField | None = None  # the time derivative of the state
    unknown: Unknown | None = None  # the unknown inputs or parameters
    drawn: int = 0  # random numbers per run, if parameters drift differently in each run
    of_run: OfRun | None = None  # the numbers of a run, from its random numbers
    errors: OwnErrors | None = None  # errors that are scored in addition to x - xhat
    scored: int = 0  # number of these errors


class Target(Protocol):
    """Return the set point of the first r states at a tick."""

    def __call__(self, params: Params, tick: Int[Array, ""], /) -> Float[Array, " r"]: ...


class Before(Protocol):
    """Return the command of a tick below 0, from the estimate at 0."""

    def __call__(self, params: Params, tick: Int[Array, ""], estimate: Array, /) -> Float[Array, " m"]: ...


class Command(Protocol):
    """Return the present command; coming(i) is the input applied i ticks later, if it has been decided."""

    def __call__(
        self, params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], /
    ) -> Float[Array, " m"]: ...


class StartLaw(Protocol):
    """Return the memory of a law before tick 0, from the estimate at 0."""

    def __call__(self, params: Params, estimate: Array, /) -> Memory: ...


class RememberingCommand(Protocol):
    """Return the present command and the new memory of the law."""

    def __call__(
        self, params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], memory: Memory, /
    ) -> tuple[Float[Array, " m"], Memory]: ...


class Controller(NamedTuple):
    """A control law as pure functions of its numbers `params`; m inputs, r states that are to follow a set point.

    A law with a memory, such as an integral, has `start`, and a `command` that takes and returns the memory.
    """

    target: Target  # the set point at a tick
    before: Before  # the command of a tick before 0
    command: Command | RememberingCommand  # the command of the present tick
    start: StartLaw | None = None  # the memory before tick 0


class Init(Protocol):
    """Return the memory at the start of a run from xhat(0)."""

    def __call__(self, gains: Gains, xhat0: Float[Array, " n"], /) -> Memory: ...


class Snapshot(Protocol):
    """Return the snapshot of the present tick that `jump` needs when the sample taken now arrives."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Float[Array, " snapshot"]: ...


class Jump(Protocol):
    """Return the memory after an arrival."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, arrival: Arrival, /) -> Memory: ...


class Flow(Protocol):
    """Return the memory one tick later, under the held now.u."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Memory: ...


class Estimate(Protocol):
    """Return xhat of the *present*: of the state, [n], or of the plant's unknowns too, [n + s]."""

    def __call__(self, gains: Gains, memory: Memory, /) -> Float[Array, " signals"]: ...


class OnSample(Protocol):
    """Return the memory after the channels of `mask` are sampled, before the sample arrives."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, mask: Bool[Array, " q"], /) -> Memory: ...


class Covariance(Protocol):
    """Return the assumed covariance of the present error of all estimated signals."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Float[Array, "signals signals"]: ...


class Bounds(Protocol):
    """Return the least and the greatest possible value of all estimated signals at present."""

    def __call__(
        self, gains: Gains, memory: Memory, /
    ) -> tuple[Float[Array, " signals"], Float[Array, " signals"]]: ...


class DelayEstimate(Protocol):
    """Return the estimated mean delay of the first channel's samples and its standard deviation [s]."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Float[Array, "2"]: ...


class InnovationStats(NamedTuple):
    """Statistics of an innovation nu (measurement minus prediction), relative to its assumed covariance S.

    `log_det` is needed for the likelihood, `normalized_sum` for the whiteness test, `normalized` for the NIS of each channel,
    and `sigma` for the figures of a replay.
    If the components of nu are decorrelated one after the other, nu_j has the variance s_j.
    """

    nis_sum: Float[Array, ""]  # nu' S^-1 nu
    dof: Float[Array, ""]  # number of components that count; 0: the measurement is not judged
    log_det: PyTree = None  # log det S, of the components that count
    normalized_sum: PyTree = None  # sum of nu_j / sqrt(s_j) over the components that count
    normalized: PyTree = None  # nu_j / sqrt(s_j) of each channel [q]; NaN if the channel does not count
    sigma: PyTree = None  # sqrt(s_j) of each channel [q], in its unit; NaN if the channel does not count


class Innovation(Protocol):
    """Return the statistics of a measurement relative to its prediction, given all measurements that arrived before."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, arrival: Arrival, /) -> InnovationStats: ...


class ObserverField(Protocol):
    """Return d memory/dt with the measurement y at now.t, the time of a Runge-Kutta stage."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, y: Float[Array, " q"], /) -> Memory: ...


class InitRandom(Protocol):
    """Return the memory at the start of a run from xhat(0), with the run's random `words` for the observer's random numbers."""

    def __call__(
        self, gains: Gains, memory: Memory, words: UInt32[Array, "2"], xhat0: Float[Array, " n"], /
    ) -> Memory: ...


class Observer(NamedTuple):
    """An observer as pure functions of its `gains` and its `memory`."""

    init: Init  # the memory at the start of a run
    snapshot: Snapshot  # called when a sample is taken: what `jump` needs of that tick
    jump: Jump  # called when a measurement arrives
    flow: Flow  # called at each tick: moves the memory to the next tick
    estimate: Estimate  # the estimate of the present state
    field: ObserverField | None = None  # time derivative of the memory, for continuous measurement
    covariance: Covariance | None = None  # assumed covariance of the error; `now` is that of a jump
    on_sample: OnSample | None = None  # called when a sample is taken, before it arrives
    innovation: Innovation | None = None  # statistics of a measurement relative to its prediction
    init_random: InitRandom | None = None  # the memory at the start of a run, for an observer that draws random numbers
    delay: DelayEstimate | None = None  # of an observer that estimates the delay of samples
    bounds: Bounds | None = None  # the interval that contains the present state, of an interval observer
    uses_silence: bool = False  # whether `jump` is called also where no channel has arrived, only `silent` ones
