"""The built-in scenarios as data: one file per plant, one dict for all. SI units; no jax."""

from pcbench.scenarios.arm import ARM
from pcbench.scenarios.camera_target import CAMERA_TARGET
from pcbench.scenarios.cart import CART
from pcbench.scenarios.coordinated_turn import COORDINATED_TURN
from pcbench.scenarios.csth import CSTH
from pcbench.scenarios.digester import DIGESTER
from pcbench.scenarios.double_well import DOUBLE_WELL
from pcbench.scenarios.falling_body import FALLING_BODY
from pcbench.scenarios.flexible_joint import FLEXIBLE_JOINT
from pcbench.scenarios.growth import GROWTH
from pcbench.scenarios.helicopter import HELICOPTER
from pcbench.scenarios.intermittent import INTERMITTENT
from pcbench.scenarios.ncs_reactor import NCS_REACTOR
from pcbench.scenarios.ncs_two_state import NCS_TWO_STATE
from pcbench.scenarios.quadruple_tank import QUADRUPLE_TANK
from pcbench.scenarios.reactor import REACTOR
from pcbench.scenarios.scenario import INTERVAL, NOTHING, Belief, Loop, Sampling, Scenario, Scoring, Truth

__all__ = ["INTERVAL", "NOTHING", "SCENARIOS", "Belief", "Loop", "Sampling", "Scenario", "Scoring", "Truth"]

_EVERY = (
    *(*CART, *CSTH, *ARM, *HELICOPTER, *REACTOR),
    *(
        *NCS_TWO_STATE,
        *NCS_REACTOR,
        *GROWTH,
        *INTERMITTENT,
        *QUADRUPLE_TANK,
        *FLEXIBLE_JOINT,
        *FALLING_BODY,
        *COORDINATED_TURN,
        *DOUBLE_WELL,
        *DIGESTER,
        *CAMERA_TARGET,
    ),
)
SCENARIOS: dict[str, Scenario] = {s.name: s for s in _EVERY}
