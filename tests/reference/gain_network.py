"""A filter whose gain is the output of a gated recurrent unit, one run and one tick at a time."""

import numpy as np


def sigmoid(a):
    return 1.0 / (1.0 + np.exp(-a))


class Reference:
    """Estimates from samples that are `delay` ticks late; `weights`: W, U, b, O, o."""

    def __init__(self, model, output, x0, weights, scale, delay):
        self.model, self.output, self.scale, self.delay = model, output, scale, delay
        self.W, self.U, self.b, self.O, self.o = weights
        self.x, self.last, self.s = np.array(x0), np.zeros(len(x0)), np.zeros(self.U.shape[1])
        self.predicted = []  # output of each tick's prior

    def estimates(self, y, period):
        """Return x of every tick, where y [N, q] has a sample at ticks 0, period, ..."""
        out = []
        for k in range(len(y)):
            if k:
                self.x = self.model(self.x)
            self.predicted.append(self.output(self.x))
            taken = k - self.delay
            if taken >= 0 and taken % period == 0:
                self.use(y[taken] - self.predicted[taken])
            out.append(self.x)
        return np.array(out)

    def use(self, e):
        """Correct by an innovation [q]."""
        inputs = np.concatenate([e, self.last]) / self.scale
        W, U, b = (np.split(a, 3) for a in (self.W, self.U, self.b))
        z = sigmoid(W[0] @ inputs + b[0] + U[0] @ self.s)
        r = sigmoid(W[1] @ inputs + b[1] + U[1] @ self.s)
        m = np.tanh(W[2] @ inputs + b[2] + r * (U[2] @ self.s))
        self.s = (1 - z) * self.s + z * m
        K = (self.O @ self.s + self.o).reshape(len(self.x), len(e))
        self.last = K @ e
        self.x = self.x + self.last
