"""The protocols: a plant and an observer are NamedTuples of pure functions plus a pytree of numbers.

Every function here is written for ONE run (a *lane*); `simulation/lanes/entrywise` carries it over thousands. Arrays have the
shapes named below; n states, m inputs, q outputs, r numbers in a note. Time is counted in ticks of `dt` seconds.

Order of events at tick k: sense, deliver, estimate, control, flow. Values are
right-continuous: the estimate of tick k is read after the jump of tick k, and in a closed loop the command of tick k is made
of it.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

from jax import Array

Leaf = Any  # an array among an observer's or a plant's numbers: NumPy's when designed, jax's when traced
Gains = Any  # a pytree of arrays: an observer's numbers, traced, never captured in a closure
Memory = Any  # a pytree of arrays: an observer's state between ticks
Delay = Callable[[Any], Any]  # of a closed loop: t [s], an array -> tau [s]


class Now(NamedTuple):
    """What a function may know of the present.

    `u` and `past_u` are the input *applied* to the plant, held over [t_k, t_k+1). In `flow` and `step`, `u` is u_k,
    which equals `past_u(0)`. In `note` and `jump` u_k is not yet decided: `u` is u_(k-1) and `past_u` needs age >= 1.
    Before t = 0 the input is 0; in a closed loop it is what the commands of that time make it. A loop keeps the inputs that
    its schedule can ask for: beyond them `past_u` is NaN.
    """

    t: Array  # [s], scalar
    tick: Array  # integer scalar
    dt: Array  # [s], scalar
    u: Array  # [m]
    past_u: Callable[[Array], Array]  # age [ticks] -> u[m] applied `age` ticks ago


class Arrival(NamedTuple):
    """What the network delivers to `jump`: one sampling instant; channels that did not arrive are not fresh."""

    value: Array  # [q] measured values; meaningful where fresh
    fresh: Array  # [q] bool
    age: Array  # [q] ticks since the sample was taken
    index: Array  # type: ignore[assignment]  # [q] which sample of its channel this is (0 is the first)
    note: Array  # [r] what the observer noted when the sample was taken
    since: Array  # ticks since the last tick at which anything arrived (counted from 0 before the first)


class Plant(NamedTuple):
    """A plant as pure functions of its numbers `params`.

    `unknown` is what observers are not told and may estimate beside the state: unknown inputs, parameters. A plant whose
    numbers drift in each run differently draws `drawn` of them, uniform in [0, 1), and `of_run` makes its params of them.
    """

    step: Callable[[Any, Now, Array], Array]  # x[n] -> x[n] one tick later, under the held now.u
    output: Callable[[Any, Now, Array], Array]  # x[n] -> y[q]
    field: Callable[[Any, Now, Array], Array] | None = None  # x[n] -> dx/dt[n]; now.t is the stage's time
    unknown: Callable[[Any, Now, Array], Array] | None = None  # x[n] -> [s] at now.t
    drawn: int = 0
    of_run: Callable[[Any, Array], Any] | None = None  # uniform[drawn] -> params


class Controller(NamedTuple):
    """A control law as pure functions of its numbers `params`; m inputs, r outputs that are to follow a set point."""

    target: Callable[[Any, Array], Array]  # tick -> set point [r], of the first r states
    before: Callable[[Any, Array, Array], Array]  # (tick below 0, estimate at 0) -> command [m] of the time before 0
    command: Callable[[Any, Now, Array, Callable[[Array], Array]], Array]
    # (now, estimate, coming) -> command [m] of now; coming(i): the input applied i ticks on, as far as it is decided


class Observer(NamedTuple):
    """An observer as pure functions of its `gains` and its `memory`."""

    init: Callable[[Gains, Array], Memory]  # xhat0[n] -> memory
    note: Callable[[Gains, Memory, Now], Array]  # -> [r], when a sample is taken
    jump: Callable[[Gains, Memory, Now, Arrival], Memory]  # when something arrives
    flow: Callable[[Gains, Memory, Now], Memory]  # one tick later
    estimate: Callable[
        [Gains, Memory], Array
    ]  # -> xhat[n], the *current* estimate; or [n + s], the plant's unknowns too
    field: Callable[[Gains, Memory, Now, Array], Memory] | None = None  # d memory / dt with y held
