"""Notebooks run from top to bottom and are kept without outputs."""

import os
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
FIRST, *LATER = NOTEBOOKS


@pytest.mark.parametrize(
    "path", [FIRST, *(pytest.param(p, marks=pytest.mark.slow) for p in LATER)], ids=lambda p: p.stem
)
@pytest.mark.slow
def test_notebook_runs_and_draws(path):
    import nbformat  # seconds of every collection
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in notebook.cells), "outputs kept"
    os.environ.setdefault("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    NotebookClient(notebook, timeout=900, kernel_name="python3").execute()
    pictures = [o for cell in notebook.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
    assert len(pictures) >= 2


def test_there_is_a_first_look():
    assert NOTEBOOKS[0].stem == "01_first_look"
