"""From a study to numbers ready to run: every cell with its gains, its schedule and its bound.

All cells of a plant and horizon share one compiled program: the ring and the arrival slots are sized for the largest.
"""

from pcbench.planning.build import alone, bound, draft, drafts, plan, samples_of, schedule_of, slowed, width
from pcbench.planning.design_context import setting
from pcbench.planning.memo import run_design

__all__ = [
    "alone",
    "bound",
    "draft",
    "drafts",
    "plan",
    "run_design",
    "samples_of",
    "schedule_of",
    "setting",
    "slowed",
    "width",
]
