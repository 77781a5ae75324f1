"""The guide claims only what runs: its Python and its commands are executed as they stand."""

import re
import subprocess
import sys

import pytest
from documents import PAGES, blocks

import pcbench
from pcbench.planning import plan
from pcbench.study import parse

PAGE = "delayed_camera.md"
LOOP = PAGES[PAGE]


@pytest.fixture
def pendulum(tmp_path, monkeypatch):
    """A working folder with the page's file."""
    (tmp_path / "pendulum.py").write_text(blocks("python", PAGE)[0])
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.ci
def test_the_pendulums_file_is_a_study(pendulum):
    (cell,) = parse.grid_of("pendulum.py:delayed_camera", {}, []).cells
    assert list(cell.options) == ["kf", "ekf", "pccebo", "shortcut"]
    (p,) = plan(parse.grid_of("pendulum.py:delayed_camera", {"observers": ["shortcut"]}, []).study)
    assert p.certificates["shortcut"].status == "uncertified"
    assert not parse.stability_warnings(parse.grid_of("pendulum.py:delayed_camera", {}, []))


@pytest.mark.nightly
def test_for_small_angles_it_is_the_linear_plant_that_the_page_writes_down(pendulum):
    (pendulum / "same.py").write_text(blocks("python", PAGE)[1])
    done = subprocess.run([sys.executable, "same.py"], capture_output=True, text=True, check=True)
    apart = float(re.search(r"largest relative difference: (\S+)", done.stdout)[1])
    assert apart < 1e-9


@pytest.mark.nightly
def test_the_pendulums_observers_are_as_the_page_says(pendulum):
    """The two filters are one; the shortcut is off by less than pccebo and costs more."""
    result = pcbench.run("pendulum.py:delayed_camera", seeds=128)
    wide = result.stats[result.stats.signal == "position"].set_index(["metric", "observer"])["mean"]
    said = {cells[0].strip("` "): cells[1:] for cells in rows(LOOP) if cells[0].startswith("`")}
    for observer, (rms, _, cost) in said.items():
        for metric, printed in (("steady_rmse", rms), ("lq_cost", cost)):
            digits = len(printed.split("±")[0].strip().partition(".")[2])
            assert f"{wide[metric, observer]:.{digits}f}" == printed.split("±")[0].strip()
    assert wide["steady_rmse", "shortcut"] < wide["steady_rmse", "pccebo"]
    assert wide["lq_cost", "shortcut"] > wide["lq_cost", "pccebo"] > wide["lq_cost", "kf"]
    alike = result.pairs.query("metric == 'steady_rmse' and signal == 'position' and p_holm > 0.05")
    assert {tuple(sorted(pair)) for pair in alike[["observer_a", "observer_b"]].to_numpy()} == {("ekf", "kf")}


def rows(page):
    return [
        [cell.strip() for cell in line.strip("|").split("|")] for line in page.splitlines() if line.startswith("| `")
    ]
