"""Mean and covariance of a linear recursion z+ = F z + f + G w, w ~ N(0, I), by the covariance itself; NumPy alone."""

import numpy as np

Array = np.ndarray


class Moments:
    """Mean and covariance of z, moved step by step."""

    def __init__(self, mean: Array, covariance: Array):
        self.mean, self.covariance = np.array(mean, float), np.array(covariance, float)

    def move(self, F: Array, f: Array | float = 0.0, G: Array | None = None) -> None:
        self.mean = F @ self.mean + f
        self.covariance = F @ self.covariance @ F.T
        if G is not None:
            self.covariance = self.covariance + G @ G.T

    def square(self, H: Array, h: Array | float = 0.0) -> Array:
        """E (H z + h)^2, by row of H."""
        return (H @ self.mean + h) ** 2 + np.diag(H @ self.covariance @ H.T)
