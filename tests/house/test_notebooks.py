"""Notebooks run from top to bottom and are kept without outputs: a question, its answer, a picture that shows it."""

import json
import os
from pathlib import Path

import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "notebooks").glob("*.ipynb"))
IN_CI = ("01_first_look", "11_your_own", "12_a_loop_of_your_own", "14_a_recording")  # 15 takes minutes; its page runs


@pytest.mark.usefixtures("as_users_have_it")  # they compute for longer than they compile
@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=pytest.mark.ci if p.stem in IN_CI else pytest.mark.nightly) for p in NOTEBOOKS],
    ids=lambda p: p.stem,
)
def test_notebook_runs_and_draws(path, tmp_path):
    import nbformat  # seconds of every collection
    from nbclient import NotebookClient

    notebook = nbformat.read(path, as_version=4)
    assert all(not cell.get("outputs") and not cell.get("execution_count") for cell in notebook.cells), "outputs kept"
    os.environ.setdefault("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    where = {"metadata": {"path": str(tmp_path)}}  # what it writes
    NotebookClient(notebook, timeout=900, kernel_name="python3", resources=where).execute()
    pictures = [o for cell in notebook.cells for o in cell.get("outputs", []) if "image/png" in o.get("data", {})]
    assert 1 <= len(pictures) <= 2, "what shows the answer"


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)
def test_it_asks_a_question_and_answers_it_by_what_it_computes(path):
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(path.read_text())["cells"]]
    title, answer = cells[0][1].split("\n\n")[:2]
    assert title.startswith("# ")
    assert title.endswith("?")
    assert answer.endswith(".")
    code = "\n".join(source for kind, source in cells if kind == "code")
    assert "\nassert " in code, "the answer is checked"
    assert "OBSERVERS" not in code, "an observer of one's own comes in by name"


def test_there_is_a_first_look():
    assert NOTEBOOKS[0].stem == "01_first_look"
