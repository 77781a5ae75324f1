"""An observer in a closed loop: what it says is what the plant is driven by."""

import numpy as np

from pcbench.checking.loading import Candidate
from pcbench.checking.noise_free_runs import errors, in_parts, planned, quiet, recorded, short
from pcbench.checking.study import claims_it, require_none
from pcbench.errors import UserError
from pcbench.scenarios import Scenario
from pcbench.study.grid import cell_of
from pcbench.study.plugins.user_code import Code, Own


def closed_loop(candidate: Candidate, scenario: Scenario) -> str:
    """In a scenario's loop, true start, no noise: no error where it claims so, else one that stays within the bound."""
    label, mine = candidate.label, Own(candidate.entry, Code("", candidate.label, (), ""))
    cell = cell_of(scenario)._replace(options={label: candidate.options}, own={label: mine})
    (p,) = planned(quiet(short(cell)))
    out, where = recorded(p, noise=False), f"closed loop: got, in {scenario.name} under {scenario.loop.controller},"
    if claims_it(cell, label):
        require_none(in_parts(p, out)[label], where, cell)
        return f"no error in {scenario.name} under {scenario.loop.controller}"
    e = errors(p, out)[label]
    bad = np.flatnonzero(~(e <= p.problem.bound[: e.shape[1]]).all(1))
    if bad.size:
        raise UserError(
            f"{where} an error beyond the scenario's divergence threshold at tick {bad[0]}, expected one that stays within "
            "it (true model, true start, no noise); give it other gains, or a --scenario whose loop is slower."
        )
    return f"its error in {scenario.name} under {scenario.loop.controller} stays within the bound"
