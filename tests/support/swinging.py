"""A nonlinear plant for estimators: a swing with an unknown stiffness p, seen by two sensors, neither of them linear.

x1' = x2,   x2' = -p sin(x1) - 0.4 x2 (1 + x2^2) + u,   y = (sin(x1) + 0.3 x2, x2 + 0.2 x1^2)
"""

from functools import cache

import driven
import jax
import jax.numpy as jnp
import numpy as np
from reference import nonlinear as reference

from pcbench.dynamics import linear
from pcbench.synthesis.certificate import DesignContext

H, TICKS = 0.05, 60
P0, START, SIZE, RANGE = np.diag([0.3, 0.5]) ** 2, np.array([0.7, -0.4]), 0.8, (1.0, 5.0)
R, PROCESS, P_START = np.array([0.04, 0.09]), (0.02, 0.05), 2.5
LINEAR = linear.Model(
    np.array([[0.0, 1.0], [-2.0, -0.4]]), np.array([[0.0], [1.0]]), np.array([[1.0, 0.3], [0.0, 1.0]])
)


def field(now, x, p):
    return jnp.stack([x[1], -p[0] * jnp.sin(x[0]) - 0.4 * x[1] * (1 + x[1] ** 2) + now.u[0]])


def sensor(now, x, p):
    return jnp.stack([jnp.sin(x[0]) + 0.3 * x[1], x[1] + 0.2 * x[0] ** 2])


def rate(z, u):
    """The same for the reference, the stiffness last."""
    return np.array([z[1], -z[2] * np.sin(z[0]) - 0.4 * z[1] * (1 + z[1] ** 2) + u[0], 0 * z[2]])


def output(z):
    return np.array([np.sin(z[0]) + 0.3 * z[1], z[1] + 0.2 * z[0] ** 2])


def design_context(**changes):
    """What a designer is told."""
    known = DesignContext(
        "swinging", LINEAR, H, TICKS, (7, 7), (5, 5), tuple(np.sqrt(R)), P0, 0.0, oosm_lag=3, flight=4, latest=20,
        process_std=PROCESS, unknown_std=(SIZE,), unknown0=(P_START,), unknown_range=(RANGE,),
        field=jax.tree_util.Partial(field), sensor=jax.tree_util.Partial(sensor),
    )  # fmt: skip
    return known._replace(**changes)


def model():
    Q = np.diag([*np.square(PROCESS), SIZE**2 * H])
    none = np.full(2, np.inf)
    return reference.Model(rate, output, H, Q, R, np.append(-none, RANGE[0]), np.append(none, RANGE[1]))


def inputs():
    return np.random.default_rng(5).normal(size=(TICKS + 1, 1)) * 2


@cache
def samples():
    """Late, lost and out of sequence: both channels together, or one of them."""
    rng, out = np.random.default_rng(6), []
    for taken in range(0, TICKS, 7):
        arrival = taken + int(rng.integers(0, 19))
        channels = ((0, 1), (0,), (1,))[int(rng.integers(0, 3))]
        values = tuple(
            output(np.array([0.5 * np.cos(taken), 0.3, 0]))[list(channels)] + 0.2 * rng.normal(size=len(channels))
        )
        if arrival <= TICKS and rng.random() > 0.1:
            out.append(reference.Sample(arrival, taken, channels, values))
    return tuple(out)


def traffic():
    found = driven.Traffic(np.zeros((TICKS + 1, 2), bool), np.full((TICKS + 1, driven.SLOTS), -1),
                           np.zeros((TICKS + 1, driven.SLOTS, 2), bool), np.zeros((TICKS + 1, driven.SLOTS, 2)))  # fmt: skip
    for s in sorted(samples(), key=lambda s: s.taken):
        slot = found.when[s.arrival].tolist().index(-1)
        found.when[s.arrival, slot] = s.taken
        for j, y in zip(s.channels, s.values, strict=True):
            found.mask[s.arrival, slot, j], found.value[s.arrival, slot, j] = True, y
    return found


def run_observer(name, *, known=None, **options):
    """xhat [N+1, 3], P [N+1, 3, 3], squares [N+1, 2] of an observer."""
    return driven.whole(name, design_context(**(known or {})), options, traffic(), inputs(), START)


def prior():
    return np.append(START, P_START), np.diag([*np.diag(P0), SIZE**2])
