"""Shortcuts for late samples in a Kalman filter, the long way: one function each, tick by tick, in the state itself.

Plant: x' = A x + B u + w, u held over a tick of h seconds, y_j = C[j] x + v_j; W [n, n] the intensity of w, R [q]
variances. Every function returns xhat [N+1, n] after the arrivals of tick k, and the covariance that it believes [N+1, n,
n] then. Samples that arrive together are used by the tick they were taken, then by channel.

Sources: Larsen, Andersen, Ravn, Poulsen 1998; Alexander 1991; Bar-Shalom 2002; Bar-Shalom, Chen, Mallick 2004. `larsen`
shares no recursion with any filter: errors are written out in all that is random (the start, the noise of each tick, of
each sample), and gains are regressions between them."""

import numpy as np

from .linear import by_arrival, discretise, held_response, joseph_update, powers, process_noise


class Plant:
    """What crosses a tick, and any number of them."""

    def __init__(self, model, u, W):
        self.C, self.u, self.n = model.C, u, len(model.A)
        self.F, self.G = discretise(model.A, model.B, model.h)
        self.Q = process_noise(model.A, W, model.h)
        self.powers = powers(self.F, len(u))
        self.response = self.powers @ self.G

    def state(self, x, a, b):
        """Return x of tick a at tick b."""
        return self.powers[b - a] @ x + held_response(self.response, self.u, a, b)

    def noise(self, ticks):
        """Return the covariance that so many ticks add."""
        total = np.zeros_like(self.Q)
        for _ in range(ticks):
            total = self.F @ total @ self.F.T + self.Q
        return total


def as_of_now(model, u, samples, xhat0, P0, R, W, shifted=False):
    """Late samples taken for those of now; `shifted`: compared with the estimate less what the model alone has moved since."""
    plant, inbox = Plant(model, u, W), by_arrival(samples)
    x, P, seen, g = np.array(xhat0, float), np.array(P0, float), [], [np.zeros(len(xhat0))]
    for k in range(len(u)):
        for s in inbox.get(k, []):
            moved = g[k] - g[s.taken] if shifted else 0.0
            x, P = joseph_update(x, P, plant.C[s.channel], s.value + plant.C[s.channel] @ (0 * x + moved), R[s.channel])
        seen.append((x, P))
        x, P = plant.F @ x + plant.G @ u[k], plant.F @ P @ plant.F.T + plant.Q
        g.append(plant.F @ g[k] + plant.G @ u[k])
    return tuple(map(np.array, zip(*seen, strict=True)))


def alexander(model, u, samples, times, xhat0, P0, R, W):
    """Covariance when a sample is taken (`times`: (taken, arrival) by channel), correction when it arrives."""
    plant, inbox = Plant(model, u, W), by_arrival(samples)
    x, P, seen, then, gains = np.array(xhat0, float), np.array(P0, float), [], {}, {}
    for k in range(len(u)):
        for j in range(len(R)):
            if k in [taken for taken, _ in times[j]]:
                c = plant.C[j]
                K = P @ c / (c @ P @ c + R[j])
                keep = np.eye(plant.n) - np.outer(K, c)
                P = keep @ P @ keep.T + R[j] * np.outer(K, K)
                gains = {key: keep @ each for key, each in gains.items()} | {(k, j): K}
                then[k, j] = x
        for s in inbox.get(k, []):
            key = s.taken, s.channel
            x = x + gains.pop(key) * (s.value - plant.C[s.channel] @ then[key])
        seen.append((x, P))
        x, P = plant.F @ x + plant.G @ u[k], plant.F @ P @ plant.F.T + plant.Q
        gains = {key: plant.F @ each for key, each in gains.items()}
    return tuple(map(np.array, zip(*seen, strict=True)))


def larsen(model, u, samples, xhat0, P0, R, W):
    """The best gain for the innovation against the estimate of the sample's own time, as it was then; P is the true one."""
    plant, inbox, n = Plant(model, u, W), by_arrival(samples), len(xhat0)
    random = n * len(u) + len(samples)  # the start, the noise of each tick but the last, of each sample
    own = {(s.taken, s.channel): n * len(u) + i for i, s in enumerate(samples)}
    S = np.zeros((random, random))
    for k in range(len(u)):
        S[n * k : n * (k + 1), n * k : n * (k + 1)] = plant.Q if k else P0
    for s in samples:
        S[own[s.taken, s.channel], own[s.taken, s.channel]] = R[s.channel]
    x, e, seen, then = np.array(xhat0, float), np.eye(n, random), [], {}
    for k in range(len(u)):
        then[k] = x, e
        for s in inbox.get(k, []):
            x_then, e_then = then[s.taken]
            nu = plant.C[s.channel] @ e_then
            nu[own[s.taken, s.channel]] = 1.0
            K = e @ S @ nu / (nu @ S @ nu)
            miss, K_then = s.value - plant.C[s.channel] @ x_then, e_then @ S @ nu / (nu @ S @ nu)
            x, e = x + K * miss, e - np.outer(K, nu)
            then[s.taken] = x_then + K_then * miss, e_then - np.outer(K_then, nu)  # for channels of the same time
        seen.append((x, e @ S @ e.T))
        x, e = plant.F @ x + plant.G @ u[k], plant.F @ e
        if k + 1 < len(u):
            e[:, n * (k + 1) : n * (k + 2)] += np.eye(n)
    return tuple(map(np.array, zip(*seen, strict=True)))


def retrodicted(model, u, samples, xhat0, P0, R, W, steps=1, zero=False, several=False):
    """Out-of-sequence samples by retrodiction from the newest; `steps` past estimates are kept, older samples are lost.

    `zero`: algorithm B. `several`: all updates after the sample's time count as one, else the last one alone is known.
    """
    plant, inbox = Plant(model, u, W), by_arrival(samples)
    at, x, P = 0, np.array(xhat0, float), np.array(P0, float)
    past, ahead, info, seen = [], (x, P), [], []
    last = P, np.zeros(len(x)), np.zeros_like(P)
    for k in range(len(u)):
        for taken in sorted({s.taken for s in inbox.get(k, [])}):
            group = [s for s in inbox[k] if s.taken == taken]
            H, y = plant.C[[s.channel for s in group]], np.array([s.value for s in group])
            Rv = np.diag([R[s.channel] for s in group])
            if taken >= at:
                if taken > at:
                    past = [*past, (at, x, P)][-steps:]
                    E = plant.powers[taken - at]
                    x, P = plant.state(x, at, taken), E @ P @ E.T + plant.noise(taken - at)
                    ahead, info, at = (x, P), [], taken
                info += list(zip(H, y, np.diag(Rv), strict=True))
                Hs, ys, Rs = (np.array(part) for part in zip(*info, strict=True))
                Si = np.linalg.inv(Hs @ ahead[1] @ Hs.T + np.diag(Rs))
                last = ahead[1], Hs.T @ Si @ (ys - Hs @ ahead[0]), Hs.T @ Si @ Hs
                K = P @ H.T @ np.linalg.inv(H @ P @ H.T + Rv)
                x, P = x + K @ (y - H @ x), P - K @ H @ P
                continue
            before = [one for one in past if one[0] <= taken]
            if not before:
                continue
            Pa, nu, U = last
            if several:
                a, xa, Pb = before[-1]
                E = plant.powers[at - a]
                Pa, xa = E @ Pb @ E.T + plant.noise(at - a), plant.state(xa, a, at)
                nu, U = np.linalg.solve(Pa, x - xa), np.linalg.solve(Pa, np.linalg.solve(Pa, Pa - P).T)
            F, Q = np.linalg.inv(plant.powers[at - taken]), plant.noise(at - taken)
            xv = Q - Pa @ U @ Q
            there = F @ (P + (Q if zero else Q - Q @ U @ Q) - xv - xv.T) @ F.T
            back = F @ (x - (0 if zero else Q @ nu) - held_response(plant.response, u, taken, at))
            across = (P - xv) @ F.T @ H.T
            S = np.linalg.inv(H @ there @ H.T + Rv)
            x, P = x + across @ S @ (y - H @ back), P - across @ S @ across.T
        E = plant.powers[k - at]
        seen.append((plant.state(x, at, k), E @ P @ E.T + plant.noise(k - at)))
    return tuple(map(np.array, zip(*seen, strict=True)))
