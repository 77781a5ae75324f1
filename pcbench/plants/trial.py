"""Whether a user's equations can be used: shapes, finite values and finite slopes at the operating point."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from pcbench.errors import UserError, raised, shown
from pcbench.plants import nonlinear
from pcbench.plants.nonlinear import Equations
from pcbench.protocols import Now
from pcbench.runtime import config

WHERE = "pcbench.make_plant"


def tried(e: Equations, numbers: Any) -> tuple[float, ...]:
    """The output at the operating point; raise UserError where a function or its slope is not as it must be."""
    n = len(e.x0)
    with config.float64():
        given, x = nonlinear.own(e, numbers), jnp.array(e.x0)
        u, dt = jnp.array(e.u0), jnp.asarray(e.tick or 0.0)
        now = Now(jnp.asarray(0.0), jnp.asarray(0), dt, u, lambda age: u)
        moves = "field" if e.field is not None else "step"
        found = {}
        for name in (moves, "output"):
            try:
                found[name] = np.asarray(jnp.asarray(getattr(e, name)(given, now, x)))
            except UserError:
                raise
            except Exception as error:
                raise UserError(
                    f"{WHERE}: {name} cannot be computed at the operating point: {raised(error)}; mend that line."
                ) from None
        if found[moves].shape != (n,):
            raise UserError(
                f"{WHERE}: {moves}: got an array of shape {found[moves].shape}, expected ({n},), a number for each state."
            )
        if found["output"].ndim != 1 or not found["output"].size:
            raise UserError(
                f"{WHERE}: output: got an array of shape {found['output'].shape}, expected (q,), a number for each output."
            )
        for name, value in found.items():
            _require_finite(name, value, e)
        y0 = tuple(map(float, found["output"]))
        try:
            linear = nonlinear.nominal(e._replace(y0=y0), numbers)
        except Exception as error:
            raise UserError(
                f"{WHERE}: the slope of {moves} or output cannot be taken: {raised(error)}; write it in jax.numpy."
            ) from None
    for name, matrices in ((moves, (linear.A, linear.B, linear.E)), ("output", (linear.C, linear.D))):
        for matrix in matrices:
            if matrix is not None:
                _require_finite(f"the slope of {name}", matrix, e)
    return y0


def _require_finite(name: str, value: Any, e: Equations) -> None:
    if not np.isfinite(value).all():
        raise UserError(
            f"{WHERE}: {name}: got {shown(np.asarray(value).tolist())} at the operating point x = {shown(list(e.x0))}, "
            f"u = {shown(list(e.u0))}, expected finite numbers; take another point, or mend the function."
        )
