"""The high-gain observer of the helicopter in three forms: with S whole, with S in two blocks, as a predictor.

z = [pitch, yaw, rates, viscosities], C = [I2 0], D^-1 = diag(1, 1, Th, Th, Th^2, Th^2):                      (6), (50)
        z'  = A(z) z + phi(u, z) - Th D^-1 S^-1 C' g,     g = al + c,   c = C z(s) - al(s) - y
        al' = -Th C S^-1 C' g,                            al(0) = 0, never reset
        S'  = Th (-S - A' S - S A + C' C),                S(0) = 1e-3 I
s is the sampling tick; a tick before 0 reads the initial values. A holds the rates, A[2, 4] = a1 = -th'/M1 and
A[3, 5] = a2 = -ps'/M2(th). One RK4 step a tick of the joint field (z, al, S), S inverted at every stage, c and u held.
Source: Hernandez-Gonzalez et al., Aerospace 2024, 11(3), 206; brackets count its equations, minus signs restored.

Since (C z - al)' = z2, g = C z - w with w' = z2 and w(t_k) = y_k + int z2 from the sample on: `predictor` is that form.
S splits into two 3x3 blocks (th, th', Bth), (ps, ps', Bps): `blocks` is that form, each inverted by its cofactors.

`robust` (not in the paper): speeds in a1, a2 and phi clipped to +-5 rad/s, viscosities clipped to [0, 2] in A z and
after each tick, and + Th rho, rho = 0.1, in S55' and S66'.

Misprints, each an option; where the sign itself is lost in the text, one reading of what is left:
`index`       a1 = -ps'/M1, as printed: the yaw's speed drives the pitch's friction
`products`    + ml2 sin th cos th ps'^2 in phi, the sign which is left of f1, against Euler-Lagrange
`history`     c = C z(s) + al(s) - y
`innovation`  c = -(C z(s) - al(s) - y)
`output`      al' = +Th C S^-1 C' g
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .helicopter import ML2, Array, Observer, inertia, rk4, torque

C = np.eye(2, 6)
MISPRINTS = ("index", "products", "history", "innovation", "output")


class Tuning(NamedTuple):
    """Th [1/s] of the gain, S(0) = S0 I, the option `robust` with its rho, and a misprint's name or ''."""

    Th: float = 4.0
    S0: float = 1e-3
    robust: bool = False
    rho: float = 0.1
    misprint: str = ""


class Memory(NamedTuple):
    """m [runs, .] the joint state, c [runs, 2] of the last sample, notes[k] [runs, 2] what a sample of tick k will need."""

    m: Array
    c: Array
    notes: list[Array]


class Form(NamedTuple):
    """S packed in a row: S(0) = S0 first [size]; push(S, g) = S^-1 C' g [runs, 6]; rate(S, a, tuning) = S' [runs, size]."""

    first: Array
    push: Callable[[Array, Array], Array]
    rate: Callable[[Array, Array, Tuning], Array]


def speeds(z: Array, tuning: Tuning) -> Array:
    """Return the rates [runs, 2] in rad/s which A and phi see."""
    return np.clip(z[:, 2:4], -5, 5) if tuning.robust else z[:, 2:4]


def slopes(z: Array, tuning: Tuning) -> Array:
    """Return a1, a2 [runs, 2]: minus rate over inertia, the entries of A which multiply the viscosities."""
    rates = speeds(z, tuning)
    return -(rates[:, [1, 1]] if tuning.misprint == "index" else rates) / inertia(z[:, 0])


def phi(u: Array, z: Array, tuning: Tuning) -> Array:
    """Return the accelerations without friction [runs, 2] in rad/s^2."""
    rates = speeds(z, tuning)
    out = torque(z[:, 0], rates, u)
    if tuning.misprint == "products":
        out[:, 0] += 2 * ML2 * np.sin(z[:, 0]) * np.cos(z[:, 0]) * rates[:, 1] ** 2
    return out / inertia(z[:, 0])


def drift(z: Array, u: Array, a: Array, tuning: Tuning) -> Array:
    """Return A(z) z + phi(u, z) [runs, 6], given a = (a1, a2)."""
    B = np.clip(z[:, 4:], 0, 2) if tuning.robust else z[:, 4:]
    return np.hstack([z[:, 2:4], a * B + phi(u, z, tuning), np.zeros_like(B)])


def kept(m: Array, tuning: Tuning) -> Array:
    """Return m [runs, .] with its viscosities clipped, if `robust`, and a lost run (|z| > 1e6) set to nan."""
    if tuning.robust:
        m[:, 4:6] = np.clip(m[:, 4:6], 0, 2)
    m[~(np.abs(m[:, :6]).max(axis=1) <= 1e6)] = np.nan
    return m


def solve(S: Array) -> Array:
    """Return S^-1 C' [runs, 6, 2]; nan where S [runs, 6, 6] is singular."""
    try:
        return np.linalg.solve(S, C.T)
    except np.linalg.LinAlgError:
        if len(S) == 1:
            return np.full((1, 6, 2), np.nan)
        return np.concatenate([solve(S[i : i + 1]) for i in range(len(S))])


def whole_push(S: Array, g: Array) -> Array:
    """Return S^-1 C' g [runs, 6] with S [runs, 36]."""
    return (solve(S.reshape(-1, 6, 6)) @ g[:, :, None])[..., 0]


def whole_rate(S: Array, a: Array, tuning: Tuning) -> Array:
    """Return S' [runs, 36]."""
    S = S.reshape(-1, 6, 6)
    A = np.zeros_like(S)
    A[:, 0, 2] = A[:, 1, 3] = 1
    A[:, 2, 4], A[:, 3, 5] = a.T
    AS, source = A.swapaxes(1, 2) @ S, C.T @ C
    if tuning.robust:
        source = source + tuning.rho * np.diag([0, 0, 0, 0, 1, 1])
    return tuning.Th * (source - S - AS - AS.swapaxes(1, 2)).reshape(-1, 36)


def block_push(S: Array, g: Array) -> Array:
    """Return S^-1 C' g [runs, 6]: the first column of each block's inverse, times its g; S [runs, 18]."""
    S = S.reshape(-1, 2, 3, 3)
    p, q, r, s, t, v = (S[..., i, j] for i, j in [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)])
    cofactors = np.stack([s * v - t * t, r * t - q * v, q * t - r * s], axis=1)  # [runs, 3, 2]: pitch, yaw by turns
    determinant = p * cofactors[:, 0] + q * cofactors[:, 1] + r * cofactors[:, 2]
    return (cofactors * (g / determinant)[:, None]).reshape(-1, 6)


def block_rate(S: Array, a: Array, tuning: Tuning) -> Array:
    """Return S' [runs, 18], row by row: (A' S)_1 = 0, (A' S)_2 = S_1, (A' S)_3 = a S_2."""
    S = S.reshape(-1, 2, 3, 3)
    AS = np.zeros_like(S)
    AS[..., 1, :], AS[..., 2, :] = S[..., 0, :], a[..., None] * S[..., 1, :]
    rate = -S - AS - AS.swapaxes(-1, -2)
    rate[..., 0, 0] += 1
    rate[..., 2, 2] += tuning.rho if tuning.robust else 0.0
    return tuning.Th * rate.reshape(-1, 18)


WHOLE = Form(np.eye(6).ravel(), whole_push, whole_rate)
BLOCKS = Form(np.tile(np.eye(3).ravel(), 2), block_push, block_rate)


def high_gain(tuning: Tuning = Tuning(), form: Form = WHOLE) -> Observer:  # noqa: B008
    """Return the observer as the paper states it: m = (z, al, S)."""
    Th, _, _, _, misprint = tuning
    if misprint not in ("", *MISPRINTS):
        raise ValueError(f"misprint {misprint!r}: want '' or one of {MISPRINTS}")
    weights = Th * np.repeat(Th ** np.arange(3), 2)
    sign, side = 1 if misprint == "history" else -1, 1 if misprint == "output" else -1

    def field(m: Array, u: Array, c: Array) -> Array:
        z, al, S = m[:, :6], m[:, 6:8], m[:, 8:]
        a, push = slopes(z, tuning), form.push(S, al + c)
        z_rate = drift(z, u, a, tuning) - weights * push
        return np.hstack([z_rate, side * Th * push[:, :2], form.rate(S, a, tuning)])

    def note(m: Array) -> Array:
        return m[:, :2] + sign * m[:, 6:8]

    def start(z0: Array) -> Memory:
        zero = np.zeros((len(z0), 2))
        m = np.hstack([z0, zero, np.tile(tuning.S0 * form.first, (len(z0), 1))])
        return Memory(m, zero, [note(m)])

    def jump(memory: Memory, s: int, y: Array) -> Memory:
        c = memory.notes[max(s, 0)] - y
        return memory._replace(c=-c if misprint == "innovation" else c)

    return flowing(start, jump, field, note, tuning)


def blocks(tuning: Tuning = Tuning()) -> Observer:  # noqa: B008
    """Return the observer with S in two 3x3 blocks: m = (z, al, S of pitch, S of yaw)."""
    return high_gain(tuning, BLOCKS)


def predictor(tuning: Tuning = Tuning()) -> Observer:  # noqa: B008
    """Return the form with the output predictor: m = (z, w, I, S), w' = I' = z2, w(t_k) = y_k + I(t_k) - I(s), I(0) = 0."""
    if tuning.misprint not in ("", "index", "products"):
        raise ValueError(f"misprint {tuning.misprint!r}: it concerns al, which this form has not")
    weights = tuning.Th * np.repeat(tuning.Th ** np.arange(3), 2)

    def field(m: Array, u: Array, c: Array) -> Array:
        z, w, S = m[:, :6], m[:, 6:8], m[:, 10:]
        a = slopes(z, tuning)
        z_rate = drift(z, u, a, tuning) - weights * whole_push(S, z[:, :2] - w)
        return np.hstack([z_rate, z[:, 2:4], z[:, 2:4], whole_rate(S, a, tuning)])

    def note(m: Array) -> Array:
        return m[:, 8:10]

    def start(z0: Array) -> Memory:
        zero = np.zeros((len(z0), 2))
        m = np.hstack([z0, z0[:, :2], zero, np.tile(tuning.S0 * np.eye(6).ravel(), (len(z0), 1))])
        return Memory(m, zero, [note(m)])

    def jump(memory: Memory, s: int, y: Array) -> Memory:
        m = memory.m.copy()
        m[:, 6:8] = y + note(m) - memory.notes[max(s, 0)]
        return memory._replace(m=m)

    return flowing(start, jump, field, note, tuning)


def flowing(start: Callable, jump: Callable, field: Callable, note: Callable, tuning: Tuning) -> Observer:
    """Return the observer which flows by one RK4 step of field(m, u, c) a tick and notes note(m) at every tick."""

    def flow(memory: Memory, u: Array) -> Memory:
        m = kept(rk4(lambda t, m: field(m, u, memory.c), 0.0, memory.m), tuning)
        memory.notes.append(note(m))
        return memory._replace(m=m)

    return Observer(start, jump, flow, lambda memory: memory.m[:, :6])
