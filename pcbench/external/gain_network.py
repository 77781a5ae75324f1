"""A filter whose gain is learned: an external estimator after KalmanNet, trained on runs of its own.

    prior(k) = f(x(k-1), u),    e = y - h(prior at the tick of the sample),    x(k) = prior(k) + K e

The gain K [n, q] is the output of a gated recurrent unit. Its inputs are e and the last correction K e, divided by `scale`. The
network uses f and h, which may be wrong, but no covariance. It is trained on simulated runs with the true states: the loss
is the mean square error over all ticks. Training draws from seeds of its own, so no run of a study is ever trained on.

    z, r = sigmoid(W_z i + U_z s + b_z), sigmoid(W_r i + U_r s + b_r),    m = tanh(W_m i + r U_m s + b_m)
    s+   = (1 - z) s + z m,    K = O s+ + o

Before training K is o = h'(x0)+ / 2 (pseudo-inverse) nearly, so that a plant that does not diverge by itself is followed.
Source: Revach et al., KalmanNet, arXiv 2107.10043; its abstract and the settings of its public program were read. Size,
inputs and training are ours, and smaller. It has no covariance and no guarantee.
"""

import json
from collections.abc import Callable
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jax import Array
from jaxtyping import Float
from numpy.typing import NDArray

from pcbench.errors import UserError
from pcbench.runtime import config

if TYPE_CHECKING:
    from pcbench.external.entry import ChannelArrival

Function = Callable[[Array], Array]
LONGEST = 200  # largest number of ticks of a training run


class System(NamedTuple):
    """The training system; n states, q outputs. A sample is taken at ticks 0, period, 2 period, ..."""

    truth: Function  # x(k) [n] to x(k+1), without noise
    model: Function  # the filter's model of the same
    output: Function  # x [n] to y [q]
    x0: NDArray[np.float64]  # [n] estimate at tick 0
    spread: NDArray[np.float64]  # [n, n] root of the covariance of x(0)
    process: NDArray[np.float64]  # [n, n] root of the covariance of a tick's process noise
    noise: Callable[[Array, int], Array]  # key, ticks -> [ticks, q] measurement noise
    scale: NDArray[np.float64]  # [q + n] scale of e and the last correction
    ticks: int = 100
    period: int = 1  # [ticks]
    delay: int = 0  # [ticks]


class Network(NamedTuple):
    """The weights; H units."""

    W: Float[Array, "3H q+n"]
    U: Float[Array, "3H H"]
    b: Float[Array, " 3H"]
    O: Float[Array, "n*q H"]
    o: Float[Array, " n*q"]


class Memory(NamedTuple):
    """The memory of the filter between ticks."""

    x: Float[Array, " n"]
    last_correction: Float[Array, " n"]  # K e
    units: Float[Array, " H"]
    outputs: Float[Array, "d+1 q"]  # h of the priors of now and of the last d ticks, d the delay


class Training(NamedTuple):
    """How a network is trained: Adam, each step on new runs, the rate falls to 0 as a cosine."""

    units: int = 16
    steps: int = 800
    runs: int = 64  # per step
    rate: float = 1e-2
    seed: int = 0


TRAINING = Training()


def draw(system: System, key: Array) -> tuple[Float[Array, "N n"], Float[Array, "N q"]]:
    """Return states and measurements of one run at ticks 0 .. N-1."""
    start, process, noise = jax.random.split(key, 3)
    n = len(system.x0)
    w = jax.random.normal(process, (system.ticks, n)) @ jnp.asarray(system.process.T)
    x0 = jnp.asarray(system.x0) + jnp.asarray(system.spread) @ jax.random.normal(start, (n,))
    _, x = jax.lax.scan(lambda x, w: (system.truth(x) + w, x), x0, w)
    return x, jax.vmap(system.output)(x) + system.noise(noise, system.ticks)


def begin(system: System, network: Network) -> Memory:
    """Return the memory at tick 0, before its samples."""
    x = jnp.asarray(system.x0)
    outputs = jnp.broadcast_to(system.output(x), (system.delay + 1, len(system.output(x))))
    return Memory(x, jnp.zeros_like(x), jnp.zeros(network.U.shape[1]), outputs)


def correct(system: System, network: Network, memory: Memory, y: Float[Array, " q"], mask: Array) -> Memory:
    """Return the memory after a sample that was taken `delay` ticks ago, if `mask` is true."""
    outputs = jnp.concatenate([system.output(memory.x)[None], memory.outputs[:-1]])
    e = y - outputs[-1]
    W_i = network.W @ (jnp.concatenate([e, memory.last_correction]) / system.scale) + network.b
    U_s, H = network.U @ memory.units, len(memory.units)
    z, r = jax.nn.sigmoid(W_i[:H] + U_s[:H]), jax.nn.sigmoid(W_i[H : 2 * H] + U_s[H : 2 * H])
    units = (1 - z) * memory.units + z * jnp.tanh(W_i[2 * H :] + r * U_s[2 * H :])
    last = (network.O @ units + network.o).reshape(len(memory.x), len(y)) @ e
    new = Memory(memory.x + last, last, units, outputs)
    return jax.tree.map(lambda a, b: jnp.where(mask, a, b), new, memory._replace(outputs=outputs))


def estimates(system: System, network: Network, y: Float[Array, "N q"]) -> Float[Array, "N n"]:
    """Return the estimates of one run from the measurements at all ticks, of which the sampled ones are used."""

    def tick(memory: Memory, k: Array) -> tuple[Memory, Array]:
        sampling_tick = k - system.delay
        mask = (sampling_tick >= 0) & (sampling_tick % system.period == 0)
        memory = correct(system, network, memory, y[sampling_tick], mask)
        return memory._replace(x=system.model(memory.x)), memory.x

    return jax.lax.scan(tick, begin(system, network), jnp.arange(len(y)))[1]


def train(system: System, training: Training = TRAINING) -> Network:
    """Return the network trained by Adam from the seed `training.seed`."""
    H, n = training.units, len(system.x0)
    slope = np.asarray(jax.jacfwd(system.output)(jnp.asarray(system.x0)))  # [q, n]
    first, second, third, run_key = jax.random.split(jax.random.key(training.seed), 4)
    network = Network(
        W=jax.random.normal(first, (3 * H, len(slope) + n)) / np.sqrt(len(slope) + n),
        U=jax.random.normal(second, (3 * H, H)) / np.sqrt(H),
        b=jnp.zeros(3 * H),
        O=0.01 * jax.random.normal(third, (slope.size, H)) / np.sqrt(H),
        o=jnp.asarray(0.5 * np.linalg.pinv(slope).ravel()),
    )
    rate = optax.cosine_decay_schedule(training.rate, training.steps)
    adam = optax.chain(optax.clip_by_global_norm(1.0), optax.adam(rate))

    def loss(network: Network, x: Array, y: Array) -> Array:
        return jnp.mean(((jax.vmap(partial(estimates, system, network))(y) - x) / system.scale[None, None, -n:]) ** 2)

    def step(state: tuple[Network, Any], key: Array) -> tuple[tuple[Network, Any], None]:
        network, moments = state
        x, y = jax.vmap(partial(draw, system))(jax.random.split(key, training.runs))
        change, moments = adam.update(jax.grad(loss)(network, x, y), moments)
        return (optax.apply_updates(network, change), moments), None

    keys = jax.random.split(run_key, training.steps)
    return jax.jit(partial(jax.lax.scan, step))((network, adam.init(network)), keys)[0][0]


class LearnedFilter:
    """The learned filter as an external estimator of linear plants, trained once for all runs of a grid point.

    pcbench external run FOLDER pcbench.external.gain_network:LearnedFilter --name learned
    """

    def __init__(self, cell: dict[str, Any], xhat0: NDArray[np.float64]) -> None:
        """Train on the grid point, or load the trained network; raise UserError if channels differ in clock or delay."""
        with config.float64():
            spec = json.dumps(_training_spec(cell))
            self.system, self.network = _train_once(spec)
            self.gamma, self.first = np.array(cell["model"]["Gamma"]), True
            self.memory = begin(self.system._replace(x0=xhat0), self.network)
            self.correct = _jit_correct(spec)

    def step(self, t: float, u: NDArray[np.float64], arrivals: list["ChannelArrival"]) -> NDArray[np.float64]:
        """Return the estimate [n] at t [s]; `u` [m] was held since the previous tick."""
        with config.float64():
            memory = self.memory
            if not self.first:
                memory = memory._replace(x=self.system.model(memory.x) + self.gamma @ u)
            self.first = False
            if arrivals and not arrivals[0].mask.all():
                raise UserError(f"t = {t:.9g} s: got a sample of some outputs only, expected all at a time; use kf.")
            y = arrivals[0].value if arrivals else np.zeros(memory.outputs.shape[1])
            self.memory = self.correct(self.network, memory, y, np.asarray(bool(arrivals)))
            return np.asarray(self.memory.x)


@lru_cache
def _train_once(spec: str) -> tuple[System, Network]:
    system = _system(json.loads(spec))
    return system, train(system)


@lru_cache
def _jit_correct(spec: str) -> Callable[..., Memory]:
    return jax.jit(partial(correct, _train_once(spec)[0]))


def _training_spec(cell: dict[str, Any]) -> dict[str, Any]:
    """Return the training data of a grid point; raise UserError if it is not linear with one clock."""
    period, delay = set(cell["period"]), set(cell["delay"])
    where = f"{cell['scenario']}, grid point {cell['cell']}"
    if cell["model"]["E"] is not None or cell["unknown_std"]:
        raise UserError(
            f"{where}: got unknown inputs, expected a linear plant whose states alone are estimated; use kf."
        )
    if len(period) + len(delay) > 2 or len(cell["intervals"]) != 1 or cell["latest"] != max(delay):
        raise UserError(
            f"{where}: got varying samples or several clocks, expected one constant period and delay; use kf."
        )
    if max(*period, *delay) > LONGEST // 10:
        raise UserError(
            f"{where}: got {max(*period, *delay)} ticks as period or delay, expected at most {LONGEST // 10}, as training "
            "computes every tick; write a larger tick."
        )
    names = ("model", "R", "Q", "P0", "ticks")
    return {name: cell[name] for name in names} | {"period": max(period), "delay": max(delay)}


def _system(spec: dict[str, Any]) -> System:
    """Return the linear system of a grid point around x(0) = 0: its estimation error depends on no input."""
    Phi, C = (jnp.asarray(spec["model"][name]) for name in ("Phi", "C"))
    R, Q, P0 = (np.asarray(spec[name]) for name in ("R", "Q", "P0"))
    q, n = C.shape
    Phi_period = np.linalg.matrix_power(np.asarray(Phi), spec["period"])
    # std of the states' errors between samples
    size = np.sqrt(np.diag(Phi_period @ P0 @ Phi_period.T + spec["period"] * Q))
    e = np.sqrt(np.diag(C @ np.diag(size**2) @ C.T + R))
    root = jnp.sqrt(jnp.diag(jnp.asarray(R)))
    return System(
        truth=lambda x: Phi @ x,
        model=lambda x: Phi @ x,
        output=lambda x: C @ x,
        x0=np.zeros(n),
        spread=_root(P0),
        process=_root(Q),
        noise=lambda key, ticks: root[None] * jax.random.normal(key, (ticks, q)),
        scale=np.concatenate([e, np.where(size > 0, size, 1.0)]),
        ticks=min(spec["ticks"], LONGEST),
        period=spec["period"],
        delay=spec["delay"],
    )


def _root(P: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a square root of a covariance that may be singular."""
    values, vectors = np.linalg.eigh(P)
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))
