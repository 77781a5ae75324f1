"""The README claims only what runs: its two commands, its Python, its study and its table; and it is short."""

import re
import subprocess
import tomllib

import pytest
from commands import start
from documents import README, ROOT, blocks, code_blocks

import pcbench
from pcbench.cli.commands import ALL
from pcbench.observers import OBSERVERS
from pcbench.plants import PLANTS
from pcbench.scenarios import SCENARIOS
from pcbench.statistics import number_format
from pcbench.study import parse

RANKED = "scenario == 'cart/white' and signal == 'position' and metric == 'steady_rmse'"
LONGEST = 150  # lines: one screen, and what leads on


def test_there_are_two_shell_commands_and_ci_runs_exactly_those():
    commands = blocks("sh", "README.md")
    assert len(commands) == 2
    assert all(len(c.strip().splitlines()) == 1 for c in commands)
    assert commands[0].strip().endswith("pcbench run quick")
    assert commands[1].strip().endswith("pytest")
    assert "readme_command" in (ROOT / ".ci" / "run").read_text()


def test_it_is_short():
    assert len(README.splitlines()) <= LONGEST


def test_its_study_is_the_one_it_says(tmp_path):
    (text,) = blocks("toml", "README.md")
    found = parse.grid_of(tomllib.loads(text), {}, [])
    assert [cell.values["delay"] for cell in found.cells] == [0.2, 0.4, 0.6]
    assert {cell.scenario.sampling.sampling_period for cell in found.cells} == {(0.4,)}
    assert {cell.scenario.sampling.noise_std for cell in found.cells} == {SCENARIOS["cart/white"].sampling.noise_std}


@pytest.mark.nightly
def test_its_study_runs(tmp_path):
    (text,) = blocks("toml", "README.md")
    (tmp_path / "camera.toml").write_text(text)
    assert len(pcbench.run(str(tmp_path / "camera.toml"), seeds=2).stats.cell.unique()) == 3


@pytest.mark.slow
def test_its_python_runs(tmp_path):
    (example,) = blocks("python", "README.md")
    assert len(example.splitlines()) <= 20
    assert {b.title for b in code_blocks("README.md") if b.language == "python"} == {"pendulum.py"}
    (tmp_path / "pendulum.py").write_text(example)
    done = start("pendulum.py", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "delay.png").stat().st_size > 10_000
    assert "ci_high" in done.stdout
    assert "p_holm" in done.stdout


def test_the_table_shown_is_the_one_that_comes_out():
    result = pcbench.run("quick")
    stats = result.stats.query("scenario == 'cart/white' and signal == 'position'").set_index(["observer", "metric"])
    (shown,) = [b for b in blocks("text", "README.md") if b.startswith("cart/white: error")]
    rows = shown.split("─\n")[1].splitlines()
    assert len(rows) == 4
    for line in rows:
        observer = line.split()[0]
        for metric in ("steady_rmse", "rms_efficiency"):
            assert f" {number_format.interval(stats.loc[(observer, metric)])}" in line, (observer, metric)
        best = number_format.difference(result.pairs.query(RANKED), observer, "kf") if observer != "kf" else ""
        assert best in line
        assert observer == "kf" or best.startswith("+")


def test_every_observer_is_named_and_what_there_is_is_counted():
    for name in OBSERVERS:
        assert f"`{name}`" in README
    assert f"{ {39: 'thirty-nine'}[len(OBSERVERS)] } observers" in README
    assert f"{ {17: 'seventeen'}[len(PLANTS) - 1] } plants" in README, "in addition to any linear one"
    assert f"{ {36: 'thirty-six'}[len(SCENARIOS)] } scenarios" in README
    assert set(re.findall(r"`pcbench ((?:external )?[\w-]+)", README)) <= set(ALL)


def test_the_top_level_is_as_promised():
    allowed = {"pyproject.toml", "pcbench", "benchmarks", "notebooks", "tests", "README.md", "LICENSE", "CHANGELOG.md",
               "CITATION.cff", "CONTRIBUTING.md", "REPRODUCTION.md", "SECURITY.md"}  # fmt: skip
    tracked = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True, check=False).stdout
    top = {line.split("/")[0] for line in tracked.splitlines()}
    assert {name for name in top if not name.startswith(".")} <= allowed
