"""The extended Kalman filter of the helicopter, which goes back to the time of a late sample and comes forward again.

State z = (x, B), B at rest:  z' = f(z, u),  y = C z(s) + v,  f as the plant's, B part of the state.
At an arrival: from the posterior of the sample before, mean and P go tick by tick to this sample's tick s,
        P <- F P F' + Q,   F = I + h df/dz at the mean before the step and the tick's input;   mean <- one RK4 step
then the update in Joseph form at s, then the mean alone goes on to now. Between arrivals the mean flows, by RK4.
B is clipped to [0, 2] after every update and every tick (the latter changes nothing: the model leaves B at rest).
Before t = 0 the world is constant, so a sample from there is one of tick 0. Source: the project's page on the helicopter.
"""

from typing import NamedTuple

import numpy as np

from .helicopter import MGL, ML2, Array, H, K, Observer, inertia, model, rk4

C = np.eye(2, 6)


class Noise(NamedTuple):
    """R [rad^2] of a sample, densities qv of the rates and qB of the viscosities, diagonal P0 [6]."""

    R: float = 1e-8
    qv: float = 1e-4
    qB: float = 1e-5
    P0: tuple[float, ...] = (0.25, 0.25, 0.25, 0.25, 0.64, 0.64)


class Memory(NamedTuple):
    """now [runs, 6]; after, P [runs, 6, 6] the posterior of the last sample, at tick `at`; inputs[k] [runs, 2] of tick k."""

    now: Array
    after: Array
    P: Array
    at: int
    inputs: list[Array]


def jacobian(z: Array, u: Array) -> Array:
    """Return df/dz [runs, 6, 6] at z [runs, 6], u [runs, 2]."""
    th, _, p, q, Bth, Bps = z.T  # p, q: the rates of pitch and yaw
    s, c, cos2 = np.sin(th), np.cos(th), np.cos(2 * th)
    M1, M2 = inertia(th).T
    yaw_torque = u @ K[1] - Bps * q + 2 * ML2 * s * c * p * q
    F = np.zeros((len(z), 6, 6))
    F[:, 0, 2] = F[:, 1, 3] = 1
    F[:, 2, 0] = (MGL * s - ML2 * cos2 * q**2) / M1
    F[:, 2, 2], F[:, 2, 3], F[:, 2, 4] = -Bth / M1, -2 * ML2 * s * c * q / M1, -p / M1
    F[:, 3, 0] = 2 * ML2 * (cos2 * p * q / M2 + s * c * yaw_torque / M2**2)  # dM2/dth = -2 ml2 sin th cos th
    F[:, 3, 2], F[:, 3, 3], F[:, 3, 5] = 2 * ML2 * s * c * q / M2, (2 * ML2 * s * c * p - Bps) / M2, -q / M2
    return F


def clipped(z: Array) -> Array:
    """Return z [runs, 6] with viscosities in [0, 2]."""
    return np.hstack([z[:, :4], np.clip(z[:, 4:], 0, 2)])


def step(z: Array, u: Array) -> Array:
    """Return the mean one tick later."""
    return clipped(rk4(lambda t, z: model(z, u), 0.0, z))


def update(z: Array, P: Array, y: Array, R: float) -> tuple[Array, Array]:
    """Return mean and P after the sample y [runs, 2], in Joseph form."""
    PC = P[:, :, :2]
    L = PC @ np.linalg.inv(P[:, :2, :2] + R * np.eye(2))
    I_LC = np.eye(6) - L @ C
    z = z + (L @ (y - z[:, :2])[..., None])[..., 0]
    return clipped(z), I_LC @ P @ I_LC.swapaxes(1, 2) + R * L @ L.swapaxes(1, 2)


def ekf(noise: Noise = Noise()) -> Observer:  # noqa: B008
    """Return the filter."""
    Q = H * np.diag([0, 0, noise.qv, noise.qv, noise.qB, noise.qB])

    def start(z0: Array) -> Memory:
        return Memory(z0, z0, np.tile(np.diag(noise.P0), (len(z0), 1, 1)), 0, [])

    def jump(memory: Memory, s: int, y: Array) -> Memory:
        _, z, P, at, inputs = memory
        s = max(s, 0)
        for k in range(at, s):
            F = np.eye(6) + H * jacobian(z, inputs[k])
            P = F @ P @ F.swapaxes(1, 2) + Q
            z = step(z, inputs[k])
        z, P = update(z, P, y, noise.R)
        now = z
        for k in range(s, len(inputs)):
            now = step(now, inputs[k])
        return Memory(now, z, P, s, inputs)

    def flow(memory: Memory, u: Array) -> Memory:
        memory.inputs.append(u)
        return memory._replace(now=step(memory.now, u))

    return Observer(start, jump, flow, lambda memory: memory.now)
