"""A driven Duffing oscillator with two wells, as a user writes a plant."""

from typing import Any, NamedTuple

import jax.numpy as jnp

import pcbench


class Numbers(NamedTuple):
    delta: float = 0.3  # 1/s
    alpha: float = -1.0  # 1/s^2
    beta: float = 1.0  # 1/(m^2 s^2)


def field(p, now, x):
    return jnp.stack([x[1], -p.delta * x[1] - p.alpha * x[0] - p.beta * x[0] ** 3 + now.u[0]])


def output(p, now, x):
    return x[:1]


duffing: Any = pcbench.make_plant(
    field=field,
    output=output,
    states=["position [m]", "velocity [m/s]"],
    numbers=Numbers(),
    operating_point=([0.0, 0.0], [0.0]),
    positive=["beta"],
    summary="driven Duffing oscillator, 2 states",
)
