"""Small linear loops given by functions, whose state's own moments are read: x' = A x + B (u + v), v white, nothing late."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.linalg import expm

from pcbench.moments.programs import compute
from pcbench.moments.propagate import COVARIANCE
from pcbench.moments.realisations import Realisation
from pcbench.protocols import Controller, Observer, Plant
from pcbench.runtime import config
from pcbench.simulation import command_network
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import GridPointParams, Layout


class Loop(NamedTuple):
    """The memory that `jump` makes of samples is what `law` sees; what the law keeps ends with the inputs that are held."""

    A: Any
    B: Any
    C: Any
    noise: Any  # [q] of a sample
    tick: float
    ticks: int
    jump: Any  # (gains, memory, now, arrival) -> memory
    memory: int
    law: Any  # (params, tick, memory, kept) -> kept
    kept: int
    flow: Any = lambda gains, memory, now: memory
    x0: Any = 0.0  # of every state


class Case(NamedTuple):
    """Of a loop, in ticks."""

    period: list
    params: Any
    chance: float = 1.0  # that a sample arrives
    gains: Any = ()


def noise_of_a_tick(A, R1, h):
    """The covariance that an intensity R1 adds over h seconds, by Van Loan."""
    n = len(A)
    whole = expm(h * np.block([[-A, R1], [np.zeros((n, n)), A.T]]))
    return whole[n:, n:].T @ whole[:n, n:]


def moments(loop, cases):
    """Return for each case the covariance of (x, memory) at ticks 0 .. N, [N+1, n + memory, n + memory], from x(0) = x0."""
    (n, m), q = loop.B.shape, len(loop.C)
    whole = expm(loop.tick * np.block([[loop.A, loop.B], [np.zeros((m, n + m))]]))
    params = whole[:n, :n], whole[:n, n:], loop.C
    plant = Plant(
        step=lambda p, now, x: p[0] @ x + p[1] @ now.u,
        output=lambda p, now, x: p[2] @ x,
        unknown=lambda p, now, x: jnp.zeros(loop.memory),
    )
    observer = Observer(
        init=lambda gains, xhat0: jnp.zeros(loop.memory),
        snapshot=lambda gains, memory, now: jnp.zeros(0),
        jump=loop.jump,
        flow=loop.flow,
        estimate=lambda gains, memory: jnp.concatenate([jnp.zeros(n), memory]),  # so that an error is x itself
    )

    def command(p, now, estimate, coming, kept):
        kept = loop.law(p, now.tick, estimate[n:], kept)
        return kept[-m:], kept

    law = Controller(
        target=lambda p, tick: jnp.zeros(n),
        before=lambda p, tick, estimate: jnp.zeros(m),
        command=command,
        start=lambda p, estimate: jnp.zeros(loop.kept),
    )
    N, nothing, many = loop.ticks, np.zeros(n), n + loop.memory
    ones = []
    for case in cases:
        p = GridPointParams(
            params, {"o": case.gains}, common_times.periodic(case.period, [0] * q, N),
            np.full((1, m), np.nan), np.asarray(loop.tick),
            nothing + loop.x0, nothing, np.zeros((n, n)), np.array(loop.noise), np.ones(many), np.full(many, 1e9),
            np.array([[0, N // 2], [N // 2, N - 1], [N - 1, N]]), control=case.params,
            process_std=np.linalg.cholesky(noise_of_a_tick(loop.A, loop.B @ loop.B.T, loop.tick)),
            line=command_network.constant_delay_line(0, 4, N + 4),
        )  # fmt: skip
        layout = Layout(plant, (("o", observer),), 1, 1, False, watch=False, controller=law, commands=4)
        ones.append(Realisation(layout, p, (), case.chance))
    with config.float64():
        found = compute(ones, COVARIANCE)
    assert (found.sums.deviation <= 1e-9 * np.maximum(found.sums.size, 1e-9)).all()
    return [found.rows.covariance[..., i] for i in range(len(cases))]


def integral(values, tick, piece):
    """Of values at ticks 0 .. N, over pieces of `piece` ticks (4 at least, a multiple) that are smooth: Boole's rule."""
    weights = np.array([7, 32, 12, 32, 7]) * 2 / 45 * tick
    assert piece % 4 == 0
    return sum((weights * values[k : k + 5]).sum() for k in range(0, len(values) - 1, 4))
