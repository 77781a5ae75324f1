"""Standard observers of the field, written out the long way: loops over ticks and samples, as in `reference.linear`.

Order of a tick, times and samples are those of `reference.linear`.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from reference.linear import Array, Model, Sample, by_arrival, discretise, pccebo, whole_vectors


def eso_gain(omega: float, T: float) -> Array:
    """Return the gain [3] of the discrete extended state observer of a double integrator (Miklosovic, Radke, Gao 2006)."""
    beta = np.exp(-omega * T)
    return np.array([1 - beta**3, 3 * (1 - beta) ** 2 * (1 + beta) / (2 * T), (1 - beta) ** 3 / T**2])


def with_disturbance(model: Model) -> Model:
    """Return the model with a constant disturbance of its one input as the last state."""
    n = len(model.A)
    A = np.zeros((n + 1, n + 1))
    A[:n, :n], A[:n, n:] = model.A, model.B
    return Model(A, np.vstack([model.B, [[0.0]]]), np.hstack([model.C, [[0.0]]]), model.h)


def eso(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] of the extended state observer with L [n+1, 1], d(0) = 0."""
    z = pccebo(with_disturbance(model), u, samples, np.append(xhat0, 0.0), L)
    return z[:, : len(model.A)]


def communication_disturbance(model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array) -> Array:
    """Return xhat [N+1, n] of the communication disturbance observer with L [n+1, 1]: z + P dh.

    z is an observer of the plant and of the disturbance -dh of its input, which takes every value when it arrives. P dh is
    summed up from all dh before each tick.
    """
    whole, n = with_disturbance(model), len(model.A)
    F, G = discretise(whole.A, whole.B, model.h)
    Ad, Bd = discretise(model.A, model.B, model.h)
    response = [Bd[:, 0]]
    z, inbox, dh, xhat = np.append(xhat0, 0.0), by_arrival(samples), [], []
    for k in range(len(u)):
        for _, y in whole_vectors(inbox.get(k, []), 1):
            z = z + L[:, 0] * (y[0] - model.C[0] @ z[:n])
        caused = sum((response[k - 1 - i] * dh[i] for i in range(k)), np.zeros(n))
        xhat.append(z[:n] + caused)
        dh.append(-z[n])
        response.append(Ad @ response[-1])
        z = F @ z + G @ u[k]
    return np.array(xhat)


def cascade(
    model: Model,
    u: Array,
    samples: list[Sample],
    xhat0: Array,
    K: Array,
    d: Array,
    move: Callable[[Array, Array], Array] | None = None,
) -> Array:
    """Return xhat [N+1, n] of cascade predictors with K [n, q] and links of d [m] ticks, one after the other.

    Nothing is kept but lists of every link's states by tick; before tick 0 they are xhat(0). A nonlinear plant moves by
    `move`, (x, u) -> x one tick later.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    move = move or (lambda x, u: Ad @ x + Bd @ u)
    inbox, delay, m = by_arrival(samples), int(sum(d)), len(d)
    links = [[np.asarray(xhat0, float)] for _ in range(m)]
    y = model.C @ xhat0
    for k in range(len(u) - 1):
        for _, value in whole_vectors(inbox.get(k, []), len(model.C)):
            y = value
        outputs = [y, *(model.C @ states[k] for states in links[:-1])]
        past = [states[max(k - int(ticks), 0)] for states, ticks in zip(links, d, strict=True)]
        for j in range(m):
            behind = int(sum(d[j + 1 :]))
            step = move(links[j][k], u[k - behind]) + K @ (outputs[j] - model.C @ past[j])
            links[j].append(step if k >= behind else links[j][k])
        if k >= delay:
            y = y + model.C @ (move(past[0], u[k - delay]) - past[0])
    return np.array(links[-1])


def twist(b: float, h: float, f: float) -> tuple[float, float]:
    """Return what the implicit super-twisting step adds to position and rate, found by bisection of its equation."""
    k1, k2, size = 1.5 * np.sqrt(f), 1.1 * f, abs(b)
    if size <= h * h * k2:
        return b, b / h
    low, high = 0.0, size
    for _ in range(200):
        middle = (low + high) / 2
        if middle + h * k1 * np.sqrt(middle) + h * h * k2 < size:
            low = middle
        else:
            high = middle
    return np.sign(b) * (size - low), np.sign(b) * h * k2


def super_twisting(
    step: Callable[[int, Array], Array],
    C: Array,
    O: Array,
    h: float,
    ticks: int,
    samples: list[Sample],
    xhat0: Array,
    f: float,
    period: float,
) -> Array:
    """Return xhat [ticks+1, 2] of the super-twisting observer; (y, y') = O x, h seconds a tick.

    step(k, x) moves the model from tick k to k + 1. Every arrival is used at its own time; the model then goes from there to
    the present, tick by tick. Samples arrive in order.
    """
    inbox = by_arrival(samples)
    at, x_at = 0, np.asarray(xhat0, float)  # of the newest sample
    xhat, now = np.zeros((ticks + 1, 2)), x_at
    for k in range(ticks + 1):
        for taken, y in whole_vectors(inbox.get(k, []), 1):
            for i in range(at, taken):
                x_at = step(i, x_at)
            since = (taken - at) * h if taken > at else period
            x_at = x_at + np.linalg.solve(O, np.array(twist(float((y - C @ x_at)[0]), since, f)))
            at, now = taken, x_at
            for i in range(taken, k):
                now = step(i, now)
        xhat[k] = now
        now = step(k, now) if k < ticks else now
    return xhat


def finite_time(
    model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array, K: Array, te: int, N: int
) -> Array:
    """Return xhat [ticks+1, n] of two current estimators L [2, n, q] combined over N samples by K [2, n, n].

    The estimators' states are whole, with their response to the input, and F^N is multiplied out.
    """
    Ad, Bd = discretise(model.A, model.B, model.h)
    F = [(np.eye(len(Ad)) - L[i] @ model.C) @ np.linalg.matrix_power(Ad, te) for i in range(2)]
    z = [np.asarray(xhat0, float)] * 2
    at, inbox, past = 0, by_arrival(samples), []
    xhat, now = np.zeros((len(u), len(Ad))), z[0]
    lag = [np.linalg.matrix_power(F[i], N) for i in range(2)]
    for k in range(len(u)):
        for taken, y in whole_vectors(inbox.get(k, []), len(model.C)):
            for j in range(at, taken):
                z = [Ad @ each + Bd @ u[j] for each in z]
            z = [each + L[i] @ (y - model.C @ each) for i, each in enumerate(z)]
            past.append(z)
            at, now = taken, z[0]
            if len(past) > N:
                then = past[-1 - N]
                now = K[0] @ z[0] + K[1] @ z[1] - (K[0] @ lag[0] - K[1] @ lag[1]) @ (then[0] - then[1]) / 2
            for j in range(taken, k):
                now = Ad @ now + Bd @ u[j]
        xhat[k] = now
        now = Ad @ now + Bd @ u[k]
    return xhat


class Bounds(NamedTuple):
    """What an interval observer takes for granted; V has the coordinates of the radius in its columns."""

    V: Array  # [n, n]
    start: Array  # [n] radius at tick 0
    w: Array  # [n] largest process noise of each state per tick
    v: Array  # [q] largest noise of a sample


def interval(
    model: Model, u: Array, samples: list[Sample], xhat0: Array, L: Array, known: Bounds
) -> tuple[Array, Array]:
    """Return the ends [N+1, n] of the intervals of a current estimator with L [n, q].

    At every tick, every term is multiplied out from the newest sample on. Samples arrive in order, with all channels.
    """
    Ad, _ = discretise(model.A, model.B, model.h)
    xhat, inbox, back = pccebo(model, u, samples, xhat0, L), by_arrival(samples), np.linalg.inv(known.V)
    keep = np.eye(len(Ad)) - L @ model.C
    at, radius, used, half = 0, known.start, False, np.zeros_like(xhat)

    def later(ticks: int) -> Array:
        flow = np.linalg.matrix_power(Ad, ticks)
        total = np.abs(back @ flow @ (keep if used else np.eye(len(Ad))) @ known.V) @ radius
        if used:
            total = total + np.abs(back @ flow @ L) @ known.v
        for i in range(ticks):
            total = total + np.abs(back @ np.linalg.matrix_power(Ad, i)) @ known.w
        return total

    for k in range(len(u)):
        for taken, _ in whole_vectors(inbox.get(k, []), len(model.C)):
            radius = later(taken - at)
            at, used = taken, True
        half[k] = np.abs(known.V) @ later(k - at)
    return xhat - half, xhat + half
