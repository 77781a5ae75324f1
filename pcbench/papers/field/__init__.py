"""Standard examples of the field: numbers that a reader can check, each with its source and a mark.

[V]: computed by a program that shares no code with pcbench. [S]: seen in a public source. A number whose source could not be
read is not a claim but an entry of `unobtained`. To add a claim, add one line to the `rows` of its example.
"""

from collections.abc import Callable

from pcbench.papers.claim import FINDING, Claim
from pcbench.papers.field import (
    batch_reactor,
    camera_target,
    coordinated_turn,
    digester,
    falling_body,
    flexible_joint,
    growth,
    intermittent,
    learned_filters,
    quadruple_tank,
    sampled_observers,
    two_state,
    unobtained,
)
from pcbench.runtime import config

EXAMPLES: dict[str, Callable[[], list[Claim]]] = {  # in seconds
    "batch reactor": batch_reactor.rows,
    "intermittent observations": intermittent.rows,
    "two-state plant": two_state.rows,
    "quadruple tank": quadruple_tank.rows,
    "flexible joint": flexible_joint.rows,
    "observers": sampled_observers.rows,
}
RUNS: dict[str, Callable[[], list[Claim]]] = {  # in minutes: simulated runs
    "growth model": growth.rows,
    "falling body": falling_body.rows,
    "coordinated turn": coordinated_turn.rows,
    "digester": digester.rows,
    "learned filter": learned_filters.rows,
    "target and camera": camera_target.rows,
}


def claims() -> list[Claim]:
    """Return the claims for `pcbench reproduce field`."""
    with config.float64():
        return [*claims_of(EXAMPLES), *claims_of(RUNS), *unobtained.rows()]


def claims_of(examples: dict[str, Callable[[], list[Claim]]]) -> list[Claim]:
    """Return the claims of some examples, each with the name of its example."""
    return [
        row if row.verdict == FINDING else row._replace(claim=f"{name}: {row.claim}")
        for name, rows in examples.items()
        for row in rows()
    ]
