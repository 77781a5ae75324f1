"""User-defined controllers: a `pcbench.Controller` with the functions of its module.

The module has `prepare(options, context)`, which returns the law's parameters. If the law has options, the module has a
pydantic class `Options`. `check(options, sizes)` and `linear(options, context)` are optional. If a module also has an observer
that uses `Options`, define a `ControllerSpec` instead. Without `linear`, jax linearises the law at rest about its set point of
tick 0. Loops that do not settle are then reported, unless the law uses inputs that are still on their way.
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


def entry(controller: Controller | ControllerSpec, module: ModuleType, where: str) -> ControllerSpec:
    """Return the entry of a module's object: itself, or a controller with the module's functions."""
    if isinstance(controller, ControllerSpec):
        law, linear = controller.controller, controller.linear
        if linear is None and isinstance(law, Controller):
            linear = partial(linearize_law, law, controller.prepare)
        return controller._replace(check=controller.check or accept_all, linear=linear)
    prepare = getattr(module, "prepare", None)
    if not callable(prepare):
        raise UserError(
            f"{where}: got a Controller in a module without a function prepare(options, context), expected one that "
            "returns the law's numbers; write it in the controller's file, or name a ControllerSpec that has it."
        )
    return ControllerSpec(
        controller=controller,
        options=getattr(module, "Options", NoOptions),
        prepare=prepare,
        summary="yours",
        check=getattr(module, "check", accept_all),
        linear=getattr(module, "linear", partial(linearize_law, controller, prepare)),
    )


def accept_all(options: BaseModel, sizes: Sizes) -> None:
    """Accept all options."""


def linearize_law(
    law: Controller, prepare: Callable[..., Params], options: BaseModel, context: ControllerContext
) -> Law | None:
    """Return a law linearised about its set point of tick 0 by jax.

    None if it uses inputs on their way, or violates the protocol; planning reports the latter (`controller_shape_checks`).
    """
    requests: list[Array] = []  # requests for inputs on their way
    try:
        with config.float64():
            params = jax.tree.map(jnp.asarray, prepare(options, context))
            law_at_rest = _slopes(law, params, context, requests)
    except Exception as error:  # any exception of user functions
        _LOG.info("a controller is not linearised: %s", describe_exception(error))
        return None
    return law_at_rest if not requests and law_at_rest.D.shape == context.model.B.T.shape else None


def _slopes(law: Controller, params: Params, context: ControllerContext, requests: list[Array]) -> Law:
    """Return the slopes of a law by its memory and by the state; requests for future inputs are recorded in `requests`."""
    n, m = context.model.B.shape
    set_point = jnp.asarray(law.target(params, jnp.asarray(0)), float)
    x_ref = jnp.zeros(n).at[: len(set_point)].set(set_point)
    memory, unravel = ravel_pytree(law.start(params, x_ref) if law.start else ())
    now = Now(jnp.asarray(0.0), jnp.asarray(0), jnp.asarray(context.dt), jnp.zeros(m), lambda age: jnp.zeros(m))

    def future_input(ticks_ahead: Array) -> Array:
        requests.append(ticks_ahead)
        return jnp.zeros(m)

    def tick(s: Array, x: Array) -> tuple[Array, Array]:
        command: Callable[..., PyTree] = law.command
        if law.start is None:
            return s, command(params, now, x, future_input)
        u, new_memory = command(params, now, x, future_input, unravel(s))
        return ravel_pytree(new_memory)[0], u

    (A, B), (C, D) = jax.jacfwd(tick, (0, 1))(memory.astype(float), x_ref)
    return Law(*(np.asarray(M, float) for M in (A, B, C, D)))


def absent(reference: str, code: Code) -> UserPlugin:
    """Return a placeholder for a controller, used when a result is read without its code."""
    placeholder = user_code.absent(reference)
    model = create_model("Options", __config__=ConfigDict(extra="allow"))
    return UserPlugin(ControllerSpec(placeholder, model, placeholder, ABSENT, accept_all), code)
