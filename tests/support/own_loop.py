"""A plant, a law and a scenario of a user's own, in one file: a pendulum that hangs, damped, and is turned by its pivot."""

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, Field

import pcbench


class Numbers(NamedTuple):
    length: float = 0.5  # m
    friction: float = 0.4  # 1/s


def field(p, now, x):
    return jnp.stack([x[1], -9.81 / p.length * jnp.sin(x[0]) - p.friction * x[1] + now.u[0]])


pendulum = pcbench.make_plant(
    field=field,
    output=lambda p, now, x: x[:1],
    states=["angle [rad]", "rate [rad/s]"],
    numbers=Numbers(),
    operating_point=([0.0, 0.0], [0.0]),
    positive=["length"],
)


class Params(NamedTuple):
    kp: Any
    ki: Any  # over a tick
    m: Any  # zeros [m]


class Options(BaseModel):
    kp: float = Field(2.0, description="of the angle")
    ki: float = Field(0.5, ge=0, description="of its integral")


def prepare(options, told):
    return Params(np.array(options.kp), np.array(options.ki * told.dt), np.zeros(told.model.B.shape[1]))


def command(params, now, estimate, coming, kept):
    kept = kept + params.ki * estimate[:1]
    return -params.kp * estimate[:1] - kept, kept


law = pcbench.Controller(
    target=lambda params, tick: jnp.zeros(2),
    before=lambda params, tick, estimate: params.m,
    command=command,
    start=lambda params, estimate: params.m,
)

late = {
    "plant": pendulum,
    "x0": [0.2, 0.0],
    "prior_std": np.full(2, 0.1),
    "sampling_period": 0.05,
    "delay": 0.1,
    "noise_std": (1e-3,),
    "dt": 0.01,
    "duration": 0.5,
    "controller": law,
    "observers": ["kf"],
}
