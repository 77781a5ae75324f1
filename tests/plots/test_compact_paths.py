"""Paths of figures in a page have few digits and relative coordinates, and the same points to 0.05 of a point."""

import re

import numpy as np

from pcbench.plots.labels import _compact


def points(path):
    """The corners of a path of straight lines, absolute or relative."""
    out, here = [], np.zeros(2)
    for command, x, y in re.findall(r"([MLl])\s*(-?[\d.]+)\s*(-?[\d.]+)", path):
        step = np.array([float(x), float(y)])
        here = here + step if command == "l" else step
        out.append(here)
    return np.array(out)


def test_compact_path_has_same_points():
    """Rounding does not add up over many points: each step is between rounded points."""
    rng = np.random.default_rng(7)
    corners = np.cumsum(rng.normal(scale=0.7, size=(400, 2)), axis=0)
    corners[::9] *= -1.0
    path = "\nL ".join(f"{x:.6f} {y:.6f}" for x, y in corners)
    short = points(_compact(f"M {path} \nz\n"))
    rounded = np.round(10 * corners) / 10
    kept = np.r_[True, np.any(rounded[1:] != rounded[:-1], axis=1)]
    np.testing.assert_allclose(short, rounded[kept], atol=1e-9)
    assert len(_compact(f"M {path}")) < 0.5 * len(path)


def test_compact_keeps_several_parts():
    assert _compact("M 1.26 -0.5 \nL 1.26 2.04 \nz\nM 0.04 3 \nL 0.04 3.01 \nL -0.5 3 \n") == "M1.3-.5l0 2.5zM0 3l-.5 0"
