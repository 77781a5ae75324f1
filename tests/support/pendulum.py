"""A pendulum on a cart, upright: nonlinear, unstable, four states; pushed along the rail, seen late by a camera.

(M + m) p'' + m l (th'' cos th - th'^2 sin th) = u - b p'          p: position, th: angle from upright
l th'' + p'' cos th - g sin th = 0
"""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

import pcbench

STATES = ["position [m]", "angle [rad]", "speed [m/s]", "rate [rad/s]"]


class Numbers(NamedTuple):
    M: float = 1.0  # kg, cart
    m: float = 0.2  # kg, bob
    l: float = 0.6  # m
    b: float = 0.4  # N s/m
    g: float = 9.81  # m/s^2
    push: float = 0.0  # N


def field(p, now, x):
    _, th, v, w = x
    s, c, force = jnp.sin(th), jnp.cos(th), now.u[0] + p.push - p.b * v
    a = (force + p.m * (p.l * w**2 * s - p.g * s * c)) / (p.M + p.m * s**2)
    return jnp.stack([v, w, a, (p.g * s - a * c) / p.l])


def output(p, now, x):
    return x[:2]


def matrices(p=None):
    """The linearisation by hand, upright and at rest."""
    M, m, l, b, g, _ = p or Numbers()
    A = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [0, -m * g / M, -b / M, 0], [0, (M + m) * g / (M * l), b / (M * l), 0]])
    B = np.array([[0.0], [0.0], [1 / M], [-1 / (M * l)]])
    return A, B, np.eye(2, 4)


def pendulum(**changes):
    given = {"field": field, "output": output, "states": STATES, "numbers": Numbers(),
             "operating_point": ([0.0] * 4, [0.0]), "positive": ["M", "m", "l"]}  # fmt: skip
    return pcbench.make_plant(**given | changes)


def scipys(x0, u, dt, ticks, p=None):
    """The same by SciPy, under the held inputs u [N, 1]: x at every tick."""
    from scipy.integrate import solve_ivp

    M, m, l, b, g, _ = p or Numbers()

    def rate(t, x, force):
        s, c = np.sin(x[1]), np.cos(x[1])
        mass = np.array([[M + m, m * l * c], [c, l]])
        p2, th2 = np.linalg.solve(mass, [force - b * x[2] + m * l * x[3] ** 2 * s, g * s])
        return [x[2], x[3], p2, th2]

    out = [np.array(x0, float)]
    for k in range(ticks):
        out.append(solve_ivp(rate, (0, dt), out[-1], args=(u[k, 0],), rtol=1e-12, atol=1e-13).y[:, -1])
    return np.array(out)
