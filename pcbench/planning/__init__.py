"""From a study to numbers ready to run: every cell with its gains, its schedule and its bound.

All cells of a plant and horizon share one compiled program: the ring and the arrival slots are sized for the largest.
"""

from pcbench.planning.arrays import alone, draft, drafts, plan, samples_of, schedule_of, width
from pcbench.planning.design_setting import setting
from pcbench.planning.designing import designed
from pcbench.planning.least_error import bound

__all__ = ["alone", "bound", "designed", "draft", "drafts", "plan", "samples_of", "schedule_of", "setting", "width"]
