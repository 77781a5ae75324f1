"""Which output of a plant shows a state as it is, and hence in which unit it is measured."""

import numpy as np

from pcbench.plants import entry_of, numbers_of, states_of
from pcbench.scenarios import Scenario

UNIT = 1e-12  # a row of C shows a state as it is when it differs from a unit vector by less


def shows(scenario: Scenario) -> dict[str, int]:
    """Return the number of the output that shows a state as it is, by state."""
    C = np.asarray(entry_of(scenario).nominal(numbers_of(scenario)).C)
    each = np.eye(C.shape[1])
    states = [name for name, _ in states_of(scenario)]
    return {states[j]: i for i in range(len(C)) for j in range(C.shape[1]) if np.abs(C[i] - each[j]).max() < UNIT}


def units(scenario: Scenario) -> list[str]:
    """Return the unit of every output; empty where it shows no single state."""
    found, known = shows(scenario), dict(states_of(scenario))
    named = {output: known[state] for state, output in found.items()}
    return [named.get(i, "") for i in range(len(scenario.sampling.noise_std))]
