"""From a study to arrays ready to run: every grid point with its gains, schedule and Kalman bound.

All grid points with the same plant and duration share one compiled program. The ring and the arrival slots have room for the
largest of them.
"""

from pcbench.planning.build import (
    alone,
    bound,
    draft,
    drafts,
    plan,
    samples_of,
    schedule_of,
    width,
    with_computing_time,
)
from pcbench.planning.design_context import context_of
from pcbench.planning.memo import run_design

__all__ = [
    "alone",
    "bound",
    "context_of",
    "draft",
    "drafts",
    "plan",
    "run_design",
    "samples_of",
    "schedule_of",
    "width",
    "with_computing_time",
]
