"""Axes of figures: errors are drawn on logarithmic axes with ticks at any range, and points stand at their axis' values."""

import numpy as np
import pytest

import pcbench
from pcbench import plots
from pcbench.plots import layout


@pytest.mark.parametrize("high", [1.01, 1.2, 2.0, 2.9, 3.1, 40.0, 1e5, 1e12])
def test_logarithmic_axis_has_ticks_at_any_range(high):
    with layout.sheet(plots.Paper(), "") as (_, (ax,)):
        layout.set_range(ax, "y", [0.5, 0.5 * high], log=True)
        low, top = ax.get_ylim()
        ticks = [t for t in ax.get_yticks() if low <= t <= top]
        assert 2 <= len(ticks) <= 8
        assert len({layout.number(t) for t in ticks}) == len(ticks)


def test_points_of_a_numeric_axis_stand_at_its_values():
    """No observer is moved to the side: a delay of 0 is not drawn at a negative one."""
    study = {"name": "d", "scenarios": ["cart/white"], "observers": ["pccebo", "kfbo", "kf"], "seeds": 3}
    result = pcbench.run(study | {"axes": {"delay": [0.0, 0.2]}})
    (ax,) = plots.curves(result, "delay").axes
    for line in ax.get_lines():
        places = line.get_transform().transform(line.get_xydata())
        np.testing.assert_allclose(places, ax.transData.transform(line.get_xydata()), atol=1e-9)
    assert ax.get_yscale() == "log"
    (ax,) = plots.distributions(result).axes
    assert ax.get_xscale() == "log"
