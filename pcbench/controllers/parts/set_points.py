"""Set points of states over time, and the corresponding states and inputs of the plant.

A set point gives some states a value r(t). The other states and the input are those at which the plant rests, in the
least-squares sense:

    x_ref of a chosen state = r,    (x_ref elsewhere, u_ref) = argmin |(Phi - I) x_ref + Gamma u_ref|, of least norm

Directions in which the plant moves by less than the rounding error of Phi count as directions without motion. So a position,
which cannot rest at a velocity of 0.5, does not get a reference of 1e14.
"""

from collections.abc import Mapping
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, Strict, model_validator

from pcbench.dynamics.linear import Matrix

Number = Annotated[float, Strict()]
Positive = Annotated[float, Strict(), Field(gt=0)]
ROUNDING = 16 * float(np.finfo(np.float64).eps)  # of an entry of Phi, as a part of its norm


class SetPoint(BaseModel):
    """The set point of one state: either a step, a sine, or a table."""

    model_config = ConfigDict(extra="forbid", allow_inf_nan=False)
    step: Number | None = Field(None, description="value from the time `at` on, 0 before")
    at: Number = Field(0.0, description="time of the step [s]")
    sine: Number | None = Field(None, description="amplitude of a sine about `offset`")
    frequency: Positive = Field(1.0, description="frequency of the sine [Hz]")
    offset: Number = Field(0.0, description="mean of the sine")
    table: list[tuple[Number, Number]] | None = Field(
        None, min_length=1, description="[[t [s], value], ...], each value held until the next time; 0 before the first"
    )

    @model_validator(mode="after")
    def _require_one_kind(self) -> "SetPoint":
        kinds = [kind for kind in ("step", "sine", "table") if getattr(self, kind) is not None]
        if len(kinds) != 1:
            raise ValueError(f"one of step, sine, table, not {' and '.join(kinds) or 'none'}")
        extra_keys = {"step": {"at"}, "sine": {"frequency", "offset"}, "table": set()}[kinds[0]]
        for key in self.model_fields_set - extra_keys - set(kinds):
            raise ValueError(f"no {key} with {kinds[0]}")
        times = [t for t, _ in self.table or ()]
        if sorted(set(times)) != times:
            raise ValueError("times that grow from row to row")
        return self

    def at_times(self, t: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return r(t), for t [T] in seconds."""
        if self.step is not None:
            return np.where(t >= self.at - 1e-9, self.step, 0.0)
        if self.sine is not None:
            return self.offset + self.sine * np.sin(2 * np.pi * self.frequency * t)
        times, values = np.array(self.table, float).T
        return np.append(0.0, values)[np.searchsorted(times - 1e-9, t, side="right")]


def _step(value: object) -> object:
    """Return a number as a step of that size at t = 0; anything else unchanged."""
    return {"step": value} if isinstance(value, int | float) and not isinstance(value, bool) else value


SetPoints = dict[str, Annotated[SetPoint, BeforeValidator(_step)]]  # by state


class Reference(NamedTuple):
    """Reference state and input, one row per tick from tick 0 on."""

    x: NDArray[np.float64]  # [T, n]
    u: NDArray[np.float64]  # [T, m]


def equilibrium_map(Phi: Matrix, Gamma: Matrix, indices: list[int]) -> Matrix:
    """Return the map [n + m, r] from the set points of the states `indices` to x_ref and u_ref."""
    n, m = Gamma.shape
    system, free = np.hstack([Phi - np.eye(n), Gamma]), [i for i in range(n + m) if i not in indices]
    out = np.zeros((n + m, len(indices)))
    out[indices, range(len(indices))] = 1.0
    size = float(np.linalg.norm(system[:, free], 2))
    rounding = ROUNDING * (n + m) * max(float(np.linalg.norm(Phi, 2)), 1.0)  # of Phi - I
    if size > rounding:
        out[free] = np.linalg.lstsq(system[:, free], -system[:, indices], rcond=rounding / size)[0]
    return out


def reference(
    set_points: Mapping[str, SetPoint], states: tuple[str, ...], tick: tuple[Matrix, Matrix], dt: float, rows: int
) -> Reference:
    """Return x_ref and u_ref for set points by state, at `rows` ticks of dt seconds from tick 0 on; zeros without any."""
    t, (Phi, Gamma) = dt * np.arange(rows, dtype=float), tick
    n, m = Gamma.shape
    if not set_points:
        return Reference(np.zeros((rows, n)), np.zeros((rows, m)))
    r = np.stack([point.at_times(t) for point in set_points.values()], 1)
    joint = r @ equilibrium_map(Phi, Gamma, [states.index(name) for name in set_points]).T
    return Reference(joint[:, :n], joint[:, n:])
