"""Which engine computes a study: chosen by its size, written into the dataset, and kept from then on."""

import numpy as np
import pandas as pd
import pytest

import pcbench
from pcbench.dataset import compare, ownership, store
from pcbench.errors import UserError
from pcbench.study import cells, read

STUDY = {"name": "engines", "scenarios": ["cart/white"], "observers": ["dkf"], "seeds": 4}
pytestmark = pytest.mark.usefixtures("in_a_hurry")


def claimed(folder, **changes):
    return ownership.claim(store.target(str(folder)), read.grid_of(STUDY | changes, {}, []))


def test_products_are_for_studies_of_many_runs(tmp_path):
    few, many = cells.MANY // 2 - 1, cells.MANY // 2
    two = {"axes": {"delay": [0.1, 0.2]}}
    assert claimed(tmp_path, seeds=few, **two).study.engine == "steps"
    found = claimed(tmp_path, seeds=many, **two)
    assert found.study.engine == "products"
    assert {cell.engine for cell in found.cells} == {"products"}
    assert claimed(tmp_path, seeds=many, engine="steps", **two).study.engine == "steps"


def test_a_dataset_keeps_its_engine_and_rows_differ_by_rounding(tmp_path, monkeypatch):
    """More seeds do not change the engine; another one is refused by name; both give the same numbers."""
    for engine in ("steps", "products"):
        pcbench.run(STUDY | {"engine": engine}, out=tmp_path / engine)
        rows = pd.read_parquet(tmp_path / engine / "runs")
        assert len(rows)
    monkeypatch.setattr(cells, "MANY", 1)
    assert pcbench.run(STUDY, out=tmp_path / "steps").cost.runs == 0
    grown = pcbench.run(STUDY | {"seeds": 6}, out=tmp_path / "steps")
    assert (grown.cost.runs, grown.study.engine) == (2, "steps")
    with pytest.raises(UserError, match="engine: 'steps' there, 'products' here"):
        pcbench.run(STUDY | {"engine": "products"}, out=tmp_path / "steps")
    assert pcbench.opened(tmp_path / "products").study.engine == "products"
    a, b = (pd.read_parquet(tmp_path / e / "runs").sort_values(["seed", "signal"]) for e in ("steps", "products"))
    a = a[a.seed < 4]
    for name in ("rmse", "peak", "settling_time"):
        np.testing.assert_allclose(a[name], b[name], rtol=1e-11)
    assert compare.compare(tmp_path / "products", tmp_path / "steps").largest < 1e-11


def test_an_engine_that_is_none_is_refused():
    with pytest.raises(UserError, match="engine: got 'plain', expected 'steps' or 'products'"):
        read.grid_of(STUDY | {"engine": "plain"}, {}, [])


def test_an_engine_that_is_none_in_a_dataset_is_refused(tmp_path):
    pcbench.run(STUDY, out=tmp_path / "out")
    path = tmp_path / "out" / "study.toml"
    path.write_text(path.read_text().replace('engine = "steps"', "engine = 5"))
    for read_again in (lambda: pcbench.run(STUDY, out=tmp_path / "out"), lambda: pcbench.opened(tmp_path / "out")):
        with pytest.raises(UserError, match="engine: got 5, expected 'steps' or 'products'"):
            read_again()
