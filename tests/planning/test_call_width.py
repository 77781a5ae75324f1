"""How many runs a call has: as many in every call for observers whose last bits depend on it."""

from types import SimpleNamespace

import pytest

import pcbench
from pcbench.engine import runner
from pcbench.planning import build
from pcbench.study import parse


def widths(observer):
    """Runs per call for studies of several sizes, and if the size is not known."""
    (cell,) = parse.grid_of("cart/white", {"observers": observer.split(",")}, []).cells
    return {build.width(cell, runs) for runs in (1, 16, 128, 1000, None)}


def test_width_is_fixed_for_sums_over_points_only():
    assert widths("ukf") == widths("particle") == widths("particle,ukf") == {64}
    assert len(widths("kf")) > 1


@pytest.mark.slow
@pytest.mark.usefixtures("as_users_have_it")
@pytest.mark.parametrize(
    "observer",
    [
        *("ukf", "ekf", "kf", "particle"),
        *(pytest.param(o, marks=pytest.mark.nightly) for o in ("ekf-iterated", "ekf-delay", "kf-cloning", "oosm-lag")),
    ],
)
def test_a_run_has_the_same_bits_among_16_and_128_others(observer):
    options = {"particle": {"particles": 8}} if observer == "particle" else {}
    few, many = (
        pcbench.run("cart/white", observers=[observer], seeds=n, options=options)
        .runs.set_index(["seed", "signal"])
        .sort_index()
        for n in (16, 128)
    )
    assert few.equals(many.loc[few.index])


@pytest.mark.parametrize(
    ("flags", "bits"), [("fpu avx2 avx512f avx512dq", "512"), ("fpu avx avx2", "256"), (None, "256")]
)
def test_vectors_are_as_wide_as_those_of_the_processor(monkeypatch, flags, bits):
    def read_text(path):
        if flags is None:
            raise FileNotFoundError(path)
        return f"processor : 0\nflags : {flags}\n"

    monkeypatch.setattr(runner, "Path", lambda path: SimpleNamespace(read_text=lambda: read_text(path)))
    assert runner.vector_width() == bits
