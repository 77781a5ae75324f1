"""A sampled linear plant in a loop with random networks on both sides, one run, whole histories kept; NumPy alone.

Tick k: samples are taken and arrive, the filter's estimate of now is read, every `every` ticks a command is decided and sent,
what has arrived of the commands is held, the plant moves. The filter is the Kalman filter of all that has arrived, in the order
in which it was taken, done again from tick 0 at every arrival; it knows the input that is held, not its noise.
Commands: decision j arrives d + J_j ticks later or never; held is the newest decision that has arrived, before the first 0.
"""

from typing import Any, NamedTuple

import numpy as np

from . import threefry

Array = np.ndarray


class Plant(NamedTuple):
    """One tick: x+ = Phi x + Gamma u + w, y = C x + v; all channels are one clock."""

    Phi: Array
    Gamma: Array
    C: Array
    noise: Array  # [q] standard deviations
    process: Array  # [n]
    x0: Array
    xhat0: Array
    P0: Array


class Network(NamedTuple):
    """Times in ticks; of the sensor `every` is its period."""

    every: int
    delay: int
    jitter: int = 0  # of the sampling instant; of the command's delay
    spread: int = 0  # of the sensor's delay
    loss: float = 0.0
    std: float = 0.0  # of commands
    stamp: tuple[int, float, int] = (
        0,
        0.0,
        0,
    )  # a sample's is later by an offset, a drift [ticks a tick], and a jitter


class Run(NamedTuple):
    x: Array  # [N+1, n]
    xhat: Array  # [N+1, n]
    u: Array  # [N+1, m] with its noise
    x_ref: Array  # [N+1, n]


class Feedback(NamedTuple):
    """U = offset + u_ref - K (x - x_ref), of the state `ahead` ticks on."""

    K: Array
    x_ref: Array  # [T, n]
    u_ref: Array  # [T, m]
    ahead: int = 0
    limit: float = np.inf

    def start(self, xhat: Array) -> Any:
        return None

    def __call__(self, plant: Plant, k: int, xhat: Array, sent: list[Array], kept: Any) -> tuple[Array, Any]:
        x = xhat
        for i in range(self.ahead):
            at = k + i - self.ahead
            x = plant.Phi @ x + plant.Gamma @ (sent[at] if at >= 0 else np.zeros_like(self.u_ref[0]))
        u = self.u_ref[k + self.ahead] - self.K @ (x - self.x_ref[k + self.ahead])
        return np.clip(u, -self.limit, self.limit), kept


class Pid(NamedTuple):
    """e = C (x_ref - xhat); backward differences; the derivative is of the output, filtered."""

    Kp: Array
    Ki: Array
    Kd: Array
    T: float
    filter: float
    x_ref: Array
    limit: float = np.inf

    def start(self, xhat: Array) -> Any:
        return None

    def __call__(self, plant: Plant, k: int, xhat: Array, sent: list[Array], kept: Any) -> tuple[Array, Any]:
        y = plant.C @ xhat
        total, last, slope = kept or (np.zeros(len(self.Kp)), y, np.zeros(len(y)))
        e = plant.C @ self.x_ref[k] - y
        slope = (self.filter * slope + (y - last)) / (self.filter + self.T)
        slope = slope if self.filter else (y - last) / self.T
        wanted = total + self.T * self.Ki @ e
        free = self.Kp @ e + wanted - self.Kd @ slope
        u = np.clip(free, -self.limit, self.limit)
        return u, (np.where(u == free, wanted, total), y, slope)


def lqr(Phi: Array, Gamma: Array, Q1: Array, Q2: Array, rounds: int = 20_000) -> Array:
    """The gain by iterating the Riccati difference equation."""
    S = Q1.copy()
    for _ in range(rounds):
        K = np.linalg.solve(Q2 + Gamma.T @ S @ Gamma, Gamma.T @ S @ Phi)
        new = Q1 + Phi.T @ S @ (Phi - Gamma @ K)
        if np.abs(new - S).max() < 1e-15 * np.abs(new).max():
            break
        S = (new + new.T) / 2
    return K


def samples(sensor: Network, N: int, q: int, root: int, seed: int) -> list[tuple[int, int, int]]:
    """(taken, arrives, number); arrives -1: lost."""
    out, i = [], 0
    while i * sensor.every <= N + sensor.jitter:
        _, instant, late = threefry.uniform(root, seed, "jitter", 0, i, 3)
        taken = i * sensor.every + (int(instant * (2 * sensor.jitter + 1)) - sensor.jitter if i else 0)
        lost = threefry.uniform(root, seed, "loss", 0, i, 1)[0] < sensor.loss
        arrives = taken + sensor.delay + int(late * (sensor.spread + 1))
        if taken <= N:
            out.append((taken, -1 if lost else arrives, i))
        i += 1
    return out


def stamped(sensor: Network, taken: int, root: int, seed: int) -> int:
    """The tick that the stamp of a sample says."""
    offset, drift, jitter = sensor.stamp
    drawn = int(threefry.uniform(root, seed, "stamp", 0, taken, 1)[0] * (2 * jitter + 1)) - jitter
    return max(taken + offset + round(drift * taken) + drawn, 0)


def arrivals(network: Network, N: int, root: int, seed: int) -> dict[int, int]:
    """By decision, the tick at which its command arrives; lost ones have none."""
    out = {}
    for j in range(N // network.every + 1):
        late = threefry.uniform(root, seed, "command_jitter", 0, j, 1)[0]
        if threefry.uniform(root, seed, "command_loss", 0, j, 1)[0] >= network.loss:
            out[j] = j * network.every + network.delay + int(late * (network.jitter + 1))
    return out


def filtered(plant: Plant, known: list[Array], arrived: dict[int, Array], now: int) -> tuple[Array, Array]:
    """The filter at tick `now` from the samples by the tick they were taken at."""
    x, P, Q = plant.xhat0, plant.P0, np.diag(plant.process**2)
    for k in range(now + 1):
        if k in arrived:
            S = plant.C @ P @ plant.C.T + np.diag(plant.noise**2)
            K = P @ plant.C.T @ np.linalg.inv(S)
            x, P = x + K @ (arrived[k] - plant.C @ x), P - K @ S @ K.T
        if k < now:
            x, P = plant.Phi @ x + plant.Gamma @ known[k], plant.Phi @ P @ plant.Phi.T + Q
    return x, P


def simulate(plant: Plant, sensor: Network, actuator: Network, law: Any, N: int, root: int, seed: int) -> Run:
    """One run over ticks 0 .. N."""
    (n, m), q = plant.Gamma.shape, len(plant.C)
    taken = {t: (a, i) for t, a, i in samples(sensor, N, q, root, seed)}
    comes = arrivals(actuator, N, root, seed)
    x, xhat, kept = plant.x0, plant.xhat0, None
    measured: dict[int, tuple[int, Array]] = {}  # by the tick that it says it was taken
    sent: list[Array] = []
    known: list[Array] = []
    xs, hats, us = [], [], []
    for k in range(N + 1):
        if k in taken:
            arrives, i = taken[k]
            v = np.array([threefry.normal(root, seed, "measurement", j, i) for j in range(q)])
            measured[stamped(sensor, k, root, seed)] = arrives, plant.C @ x + plant.noise * v
        if any(arrives == k for arrives, _ in measured.values()):
            there = {t: y for t, (arrives, y) in measured.items() if 0 <= arrives <= k}
            xhat, _ = filtered(plant, known, there, k)
        if k % actuator.every == 0:
            command, kept = law(plant, k, xhat, sent, kept)
        sent.append(command)
        here = [j for j, tick in comes.items() if tick <= k]
        held, noise = np.zeros(m), np.zeros(m)
        if here:
            j = max(here)
            held = sent[j * actuator.every]
            noise = actuator.std * np.array([threefry.normal(root, seed, "command", c, j) for c in range(m)])
        known.append(held)
        xs.append(x)
        hats.append(xhat)
        us.append(held + noise)
        w = np.zeros(n)
        if plant.process.any():
            w = plant.process * [threefry.normal(root, seed, "process", c, k) for c in range(n)]
        x = plant.Phi @ x + plant.Gamma @ us[-1] + w
        xhat = plant.Phi @ xhat + plant.Gamma @ held
    return Run(np.array(xs), np.array(hats), np.array(us), np.array(law.x_ref[: N + 1]))
