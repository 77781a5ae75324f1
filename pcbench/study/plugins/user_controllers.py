"""Controllers of a user's own: a `pcbench.Controller` with the functions of its module, as an entry beside pcbench's.

The module has `prepare(options, context)`, which returns the law's numbers, and where it takes options a pydantic `Options`;
`check(options, sizes)` and `linear(options, context)` may be there. Where a module holds an observer too, whose `Options` they
would be, the law is a `ControllerSpec`. Without `linear` the law is linearised by jax, at rest about
its set point of tick 0: so a loop that does not settle is named, unless the law looks at the inputs that are on their way.
"""

import logging
from collections.abc import Callable
from functools import partial
from types import ModuleType

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.flatten_util import ravel_pytree
from jaxtyping import PyTree
from pydantic import BaseModel, ConfigDict, create_model

from pcbench.controllers import ControllerSpec
from pcbench.controllers.parts.common import ControllerContext, Sizes
from pcbench.errors import UserError, describe_exception
from pcbench.protocols import Controller, Now, Params
from pcbench.runtime import config
from pcbench.study.plugins import user_code
from pcbench.study.plugins.user_code import Code, UserPlugin
from pcbench.study.plugins.user_observers import ABSENT, NoOptions
from pcbench.synthesis.lqr import Law

_LOG = logging.getLogger(__name__)


def entry(found: Controller | ControllerSpec, module: ModuleType, where: str) -> ControllerSpec:
    """Return the entry of what a module holds: itself, or a controller with the module's functions."""
    if isinstance(found, ControllerSpec):
        law, linear = found.controller, found.linear
        if linear is None and isinstance(law, Controller):
            linear = partial(linearize_law, law, found.prepare)
        return found._replace(check=found.check or anything, linear=linear)
    prepare = getattr(module, "prepare", None)
    if not callable(prepare):
        raise UserError(
            f"{where}: got a Controller in a module without a function prepare(options, context), expected one that "
            "returns the law's numbers; write it in the controller's file, or name a ControllerSpec that has it."
        )
    return ControllerSpec(
        controller=found,
        options=getattr(module, "Options", NoOptions),
        prepare=prepare,
        summary="yours",
        check=getattr(module, "check", anything),
        linear=getattr(module, "linear", partial(linearize_law, found, prepare)),
    )


def anything(options: BaseModel, sizes: Sizes) -> None:
    """Take all options as fitting."""


def linearize_law(
    law: Controller, prepare: Callable[..., Params], options: BaseModel, told: ControllerContext
) -> Law | None:
    """Return a law about its set point of tick 0, by jax.

    None where it looks at what is on its way, or does not keep to the protocol: planning says how (`law_conformance`).
    """
    asked: list[Array] = []  # for what is on its way
    try:
        with config.float64():
            params = jax.tree.map(jnp.asarray, prepare(options, told))
            law_at_rest = _slopes(law, params, told, asked)
    except Exception as error:  # whatever the user's functions raise
        _LOG.info("a controller is not linearised: %s", describe_exception(error))
        return None
    return law_at_rest if not asked and law_at_rest.D.shape == told.model.B.T.shape else None


def _slopes(law: Controller, params: Params, told: ControllerContext, asked: list[Array]) -> Law:
    """The slopes of a law by what it keeps and by the state; what it asks for of the future is noted."""
    n, m = told.model.B.shape
    aim = jnp.asarray(law.target(params, jnp.asarray(0)), float)
    rest = jnp.zeros(n).at[: len(aim)].set(aim)
    kept, back = ravel_pytree(law.start(params, rest) if law.start else ())
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(told.dt), jnp.zeros(m), lambda age: jnp.zeros(m))

    def coming(ahead: Array) -> Array:
        asked.append(ahead)
        return jnp.zeros(m)

    def tick(s: Array, x: Array) -> tuple[Array, Array]:
        decide: Callable[..., PyTree] = law.command
        if law.start is None:
            return s, decide(params, now, x, coming)
        u, after = decide(params, now, x, coming, back(s))
        return ravel_pytree(after)[0], u

    (A, B), (C, D) = jax.jacfwd(tick, (0, 1))(kept.astype(float), rest)
    return Law(*(np.asarray(each, float) for each in (A, B, C, D)))


def absent(reference: str, code: Code) -> UserPlugin:
    """Return what stands for a controller where its code is not asked for: a result is read so."""
    nothing = user_code.absent(reference)
    model = create_model("Options", __config__=ConfigDict(extra="allow"))
    return UserPlugin(ControllerSpec(nothing, model, nothing, ABSENT, anything), code)
