"""An observer run against data that can be changed: a recorded run of one lane, without noise.

What the network brings may be shifted, packet by packet (values and notes), and so may the ages and the inputs: what an
estimate depends on is then seen by comparing two runs bit for bit.
"""

import jax.numpy as jnp
import numpy as np

from pcbench.checking.fixtures import Trial
from pcbench.simulation import trajectory
from pcbench.simulation.simulate_runs import Shift
from pcbench.simulation.trajectory import Recording
from pcbench.simulation.types import GridPointParams, Layout


def none(p: GridPointParams) -> Shift:
    """Return the shift that changes nothing: of N + 2 packets, one a tick at most and a spare one."""
    many = p.schedule.sense.shape[0] + 1
    return Shift(jnp.zeros((many, p.noise_std.shape[0])), jnp.zeros(many))


def replay(t: Trial, p: GridPointParams, shift: Shift) -> Recording:
    """Record a run of the trial's observer on the numbers `p`, its packets shifted; room for all packets at once."""
    quiet = p._replace(noise_std=np.zeros_like(p.noise_std))
    layout = Layout(t.plant, ((t.label, t.observer),), 1, len(shift.notes), False)
    return trajectory.compiled()(layout, quiet, np.asarray(0), np.asarray(0), shift)
