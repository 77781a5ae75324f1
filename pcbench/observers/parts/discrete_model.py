"""One tick of a model with what is unknown beside the state, z = (x, p), and its slope by z; n states, s unknowns, N = n + s.

A linear model moves by its exact map; a field by one Runge-Kutta step, whose slope is taken as I + h J; a plant that is given
by its step moves by that, and its slope is the Jacobian (jax). The unknowns p stand still.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from pcbench.dynamics import linear
from pcbench.dynamics.integrate import rk4
from pcbench.protocols import Now, Room
from pcbench.synthesis.certificate import DesignContext


def affine(Phi: Array, Gamma: Array, now: Now, z: Array) -> Array:
    """Move a linear model by one tick."""
    return Phi @ z + Gamma @ now.u


def constant(Phi: Array, now: Now, z: Array) -> Array:
    """Return the slope of a linear model."""
    return Phi


def rate(model: Any, room: Room, now: Now, z: Array) -> Array:
    """Return dz/dt: the model's field with the unknowns p, room [s], which stand still."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([model(now, z[:n], z[n:]), jnp.zeros(room.shape[0])])


def step(model: Any, room: Room, now: Now, z: Array) -> Array:
    """Move a model by one Runge-Kutta step."""
    return rk4(lambda t, z: rate(model, room, now._replace(t=t), z), now.t, z, now.dt)


def slope(model: Any, room: Room, now: Now, z: Array) -> Array:
    """Return I + h J."""
    return jnp.eye(z.shape[0]) + now.dt * jax.jacfwd(lambda z: rate(model, room, now, z))(z)


def moved(successor: Any, room: Room, now: Now, z: Array) -> Array:
    """Move a plant that is given by its step, with the unknowns p, room [s], which stand still."""
    n = z.shape[0] - room.shape[0]
    return jnp.concatenate([successor(now, z[:n], z[n:]), z[n:]])


def moved_slope(successor: Any, room: Room, now: Now, z: Array) -> Array:
    """Return the Jacobian of that."""
    return jax.jacfwd(lambda z: moved(successor, room, now, z))(z)


def pushed(A: Array, B: Array, E: Array, known: Any, now: Now, x: Array, p: Array) -> Array:
    """Return dx/dt of a linear model pushed by f = known(x) + p."""
    return A @ x + B @ now.u + E @ (known(x) + p)


def motion_of(setting: DesignContext) -> tuple[Any, Any]:
    """Return how a tick moves z, and its slope: exactly where the model is linear."""
    model, room = setting.model, np.zeros(len(setting.unknown_std))
    if setting.successor is not None:
        after = setting.successor
        return jax.tree_util.Partial(moved, after, room), jax.tree_util.Partial(moved_slope, after, room)
    if setting.field is None and (model.E is None or model.known is None):
        whole = linear.with_unknown_input(model) if model.E is not None else model
        Phi, Gamma = linear.one_tick(whole, setting.dt)
        return jax.tree_util.Partial(affine, Phi, Gamma), jax.tree_util.Partial(constant, Phi)
    field = setting.field or jax.tree_util.Partial(pushed, model.A, model.B, model.E, model.known)
    return jax.tree_util.Partial(step, field, room), jax.tree_util.Partial(slope, field, room)
