"""The protocols: a plant and an observer are NamedTuples of pure functions plus a pytree of numbers.

Every function here is written for ONE run (a *lane*); `engine/interpreter` carries it over thousands. Arrays have the
shapes named below; n states, m inputs, q outputs, s unknowns beside the state. Time is counted in ticks of `dt` seconds.

Order of events at tick k: sense, deliver, estimate, control, flow. Values are right-continuous: the estimate of tick k is read
after the jump of tick k, and in a closed loop the command of tick k is computed from it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import jax
from jax import Array
from jax.typing import ArrayLike
from jaxtyping import Bool, Float, Int, PyTree, UInt32

Leaf = Any  # an array among an observer's or a plant's numbers: NumPy's when designed, jax's when traced
Room = Leaf  # zeros, whose number alone is the message: under jit a length is known where a value is not
Params = PyTree  # a pytree of arrays: a plant's or a controller's numbers
Gains = PyTree  # a pytree of arrays: an observer's numbers, traced, never captured in a closure
Memory = PyTree  # a pytree of arrays: an observer's state between ticks
Delay = Callable[[ArrayLike], ArrayLike]  # of a closed loop: t [s], an array -> tau [s]


TOGETHER = "pcbench_together"  # the name by which simulations know a function that `together` has made


def vmap_as_unit(f: Callable[..., PyTree]) -> Callable[..., PyTree]:
    """Mark a function to be vectorized over runs as a whole, by `jax.vmap`.

    Use it for functions that are large, or that have arrays of hundreds of entries. Other functions are vectorized entry by
    entry, which is faster for small arrays, but slow to compile for large ones.

    Args:
        f: a function of arrays, of one run.

    Returns:
        The same function, marked.
    """

    def whole(*args: PyTree) -> PyTree:
        return f(*args)

    whole.__name__ = TOGETHER  # a user's own function may be called `together`
    return jax.jit(whole)


class Now(NamedTuple):
    """What a function may know of the present.

    `u` and `past_u` are the input *applied* to the plant, held over [t_k, t_k+1). In `flow` and `step`, `u` is u_k,
    which equals `past_u(0)`. In `snapshot` and `jump` u_k is not yet decided: `u` is u_(k-1) and `past_u` needs age >= 1.
    Before t = 0 the input is 0; in a closed loop, what the commands of that time make it. A loop keeps the inputs that its
    schedule can ask for: beyond them `past_u` is NaN.
    """

    t: Float[Array, ""]  # [s]
    tick: Int[Array, ""]
    dt: Float[Array, ""]  # [s]
    u: Float[Array, " m"]
    past_u: Callable[[Array], Array]  # age [ticks] -> u[m] applied `age` ticks ago


class Arrival(NamedTuple):
    """What the network delivers to `jump`: one sampling instant; `mask` is False for channels that did not arrive."""

    value: Float[Array, " q"]  # measured; without meaning where `mask` is False
    mask: Bool[Array, " q"]
    age: Int[Array, " q"]  # ticks since the sample was taken, as the observer believes it
    index: Int[Array, " q"]  # type: ignore[assignment]  # which sample of its channel this is (0 is the first)
    snapshot: Float[Array, " noted"]  # what the observer noted at the tick at which it believes the sample was taken
    ticks_since_arrival: Int[
        Array, ""
    ]  # ticks since the last tick at which anything arrived (counted from 0 before the first)
    # of a recording that states it: variance of each value's noise over the variance that the design takes for its channel
    variance_ratio: Float[Array, " q"] | None = None


class Step(Protocol):
    """Move x by one tick, under the held now.u."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " n"]: ...


class Output(Protocol):
    """Return y, what is measured of x."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " q"]: ...


class PlantField(Protocol):
    """Return dx/dt under the held now.u; now.t is the time of a Runge-Kutta stage."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " n"]: ...


class Unknown(Protocol):
    """Return, at now.t, what observers are not told."""

    def __call__(self, params: Params, now: Now, x: Float[Array, " n"], /) -> Float[Array, " s"]: ...


class OwnErrors(Protocol):
    """Return errors of a user's own, of the state x and its estimate xhat: numbers, scored as the errors of states are."""

    def __call__(
        self, params: Params, now: Now, x: Float[Array, " n"], xhat: Float[Array, " n"], /
    ) -> Float[Array, " d"]: ...


class OfRun(Protocol):
    """Return the numbers of one run, given what it has drawn uniformly from [0, 1)."""

    def __call__(self, params: Params, uniform: Float[Array, " drawn"], /) -> Params: ...


class Plant(NamedTuple):
    """A plant as pure functions of its numbers `params`.

    `unknown` has no value that observers are given; they may estimate it in addition to the state: unknown inputs,
    parameters. A plant whose numbers drift differently in each run draws `drawn` numbers, from which `of_run` makes its params.
    `errors` are scored in addition to x - xhat; a plant has these or `unknown`.
    """

    step: Step
    output: Output
    field: PlantField | None = None
    unknown: Unknown | None = None
    drawn: int = 0
    of_run: OfRun | None = None
    errors: OwnErrors | None = None
    scored: int = 0  # how many they are


class Target(Protocol):
    """Return the set point of the first r states at a tick."""

    def __call__(self, params: Params, tick: Int[Array, ""], /) -> Float[Array, " r"]: ...


class Before(Protocol):
    """Return the command of a tick below 0, from the estimate at 0."""

    def __call__(self, params: Params, tick: Int[Array, ""], estimate: Array, /) -> Float[Array, " m"]: ...


class Command(Protocol):
    """Return the command of now; coming(i) is the input applied i ticks on, as far as it is decided."""

    def __call__(
        self, params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], /
    ) -> Float[Array, " m"]: ...


class StartLaw(Protocol):
    """Return what a law keeps from tick to tick, as it is before tick 0, from the estimate at 0."""

    def __call__(self, params: Params, estimate: Array, /) -> Memory: ...


class RememberingCommand(Protocol):
    """Return the command of now, and what the law keeps, from what it has kept."""

    def __call__(
        self, params: Params, now: Now, estimate: Array, coming: Callable[[Array], Array], kept: Memory, /
    ) -> tuple[Float[Array, " m"], Memory]: ...


class Controller(NamedTuple):
    """A control law as pure functions of its numbers `params`; m inputs, r states that are to follow a set point.

    A law that keeps something from tick to tick has `start`, and a `command` that takes and returns it.
    """

    target: Target
    before: Before
    command: Command | RememberingCommand
    start: StartLaw | None = None


class Init(Protocol):
    """Start a run from xhat(0)."""

    def __call__(self, gains: Gains, xhat0: Float[Array, " n"], /) -> Memory: ...


class Note(Protocol):
    """Return what the observer will need to know of the present when the sample taken now arrives."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Float[Array, " noted"]: ...


class Jump(Protocol):
    """Use what arrives."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, arrival: Arrival, /) -> Memory: ...


class Flow(Protocol):
    """Move by one tick, under the held now.u."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Memory: ...


class Estimate(Protocol):
    """Return xhat of the *present*: of the state, [n], or of the plant's unknowns too, [n + s]."""

    def __call__(self, gains: Gains, memory: Memory, /) -> Float[Array, " signals"]: ...


class OnSample(Protocol):
    """Take note in memory that the channels of `mask` are sampled now, before anything of it arrives."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, mask: Bool[Array, " q"], /) -> Memory: ...


class Covariance(Protocol):
    """Return the covariance that the observer believes its error to have now, of all that it estimates."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, /) -> Float[Array, "signals signals"]: ...


class InnovationStats(NamedTuple):
    """How far a sample is from what was expected of it: nu' S^-1 nu, S the covariance that the observer assumes for nu.

    With the next two it says too how likely the sample was, and whether samples repeat each other, with the last one which
    channels were judged; they may be left out. Taken one after the other the numbers of nu are independent, nu_j with the
    variance s_j.
    """

    nis_sum: Float[Array, ""]
    dof: Float[Array, ""]  # how many numbers of the sample count; 0: it is not to be judged
    log_det: PyTree = None  # log det S, of the numbers that count
    normalized_sum: PyTree = None  # sum of nu_j / sqrt(s_j) over them
    each: PyTree = None  # [q] nu_j / sqrt(s_j), NaN of a channel that does not count


class Innovation(Protocol):
    """Return how far what arrives is from what is expected of it, given all that arrived before, whatever was taken since."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, arrival: Arrival, /) -> InnovationStats: ...


class ObserverField(Protocol):
    """Return d memory/dt with y measured at now.t, a Runge-Kutta stage's."""

    def __call__(self, gains: Gains, memory: Memory, now: Now, y: Float[Array, " q"], /) -> Memory: ...


class InitRandom(Protocol):
    """Return the memory at the start of a run that has `words` of its own, from which the observer draws, and xhat(0)."""

    def __call__(
        self, gains: Gains, memory: Memory, words: UInt32[Array, "2"], xhat0: Float[Array, " n"], /
    ) -> Memory: ...


class Observer(NamedTuple):
    """An observer as pure functions of its `gains` and its `memory`."""

    init: Init
    snapshot: Note  # when a sample is taken
    jump: Jump  # when something arrives
    flow: Flow  # from tick to tick
    estimate: Estimate
    field: ObserverField | None = None  # where it runs on continuous measurement as well
    covariance: Covariance | None = None  # where it says how wrong it is; `now` is that of a jump
    on_sample: OnSample | None = None  # for observers that need to know at sampling time that a sample will come
    innovation: Innovation | None = None  # where it says what it expects of a sample
    init_random: InitRandom | None = None  # where it draws numbers itself
