"""Exported observers, compiled once each: what they print of their run, and how far they are from the simulation."""

from functools import cache

import numpy as np
import pytest

from pcbench.export import files

REFUSED = {"particle": "erf_inv", "oosm-lag": "lu", "kf-event": "silence"}  # and what cannot be written
HOMES = {
    **dict.fromkeys(("pco", "pi-pco"), "cart/variable"),
    **dict.fromkeys(("chain", "equal-delay", "no-delay"), "csth/10s-noise"),
    **dict.fromkeys(("smo", "pio"), "arm/sampled"),
    "high-gain": "helicopter/constant",  # a closed loop
    "high-gain-predictor": "flexible-joint/sampled",
    "mhe-bounded": "reactor",
}
WILD = {  # late, lost and out-of-sequence samples
    "name": "wild",
    "scenario": {
        "base": "cart/white",
        "duration": 4.0,
        "steady_start": 2.0,
        "sampling_jitter": 0.05,
        "delay_jitter": 0.6,
        "loss": 0.2,
    },
}
REGULAR = ("kfbo", "cascade-predictor", "model-only", *HOMES)  # samples of one age, or at home elsewhere


@cache
def of(name, wild=False):
    """An exported observer, of its home or of the wild cart."""
    return files.export_observer(dict(WILD) if wild else HOMES.get(name, "cart/white"), name)


def program_output(found, single=False, arguments=()):
    """What the compiled program prints; a test is skipped where nothing compiles."""
    printed = files.run_compiled(found, single, arguments)
    if printed is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    return printed


def off(found, printed):
    """The largest difference from the simulation at any tick, as a part of the signal's largest value (of 1, if less)."""
    each = files.parse_replay(printed)
    assert len(each) == len(found.scale)
    return max(line.most / max(scale, 1.0) for line, scale in zip(each.values(), found.scale, strict=True))


def estimates(found, single=False):
    """What the program estimates, [N+1, s]."""
    return np.array(
        [[float(x) for x in row.split()] for row in program_output(found, single, ("estimates",)).splitlines()]
    )
