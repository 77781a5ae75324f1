"""A guest: an observer whose estimates were made elsewhere, one run at a time. Its runs are scored, never simulated here."""

import jax.numpy as jnp
from pydantic import BaseModel, ConfigDict

from pcbench.observers import ObserverSpec
from pcbench.protocols import Observer
from pcbench.synthesis.certificate import Design, DesignContext, no_certificate

ONE_AT_A_TIME = "guest: one run at a time"
REFERENCE = "pcbench.external.entry:GUEST"  # by which a study names it


class Options(BaseModel):
    """A guest has no options here: whoever made its estimates had them."""

    model_config = ConfigDict(extra="forbid")


def design(setting: DesignContext, options: Options) -> Design:
    """Return no gains: a guest has none here."""
    return Design((), no_certificate(ONE_AT_A_TIME))


GUEST = ObserverSpec(
    observer=Observer(
        init=lambda gains, xhat0: xhat0,
        snapshot=lambda gains, memory, now: jnp.zeros(0),
        jump=lambda gains, memory, now, arrival: memory,
        flow=lambda gains, memory, now: memory,
        estimate=lambda gains, memory: memory,
    ),
    options=Options,
    design=design,
    knows_schedule=False,
    summary=ONE_AT_A_TIME,
    takes="any schedule",
    elsewhere=True,
)
