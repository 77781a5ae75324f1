"""Every command line that the README and the guide show is run, page by page in one folder, on few seeds."""

import shlex

import pytest
from commands import call
from documents import PAGES, TEXTS, blocks, commands

FEW = ["--seeds", "4"]
CHEAP = {  # what would take minutes in a command of this name: fewer runs, or a part of it
    "run": FEW,
    "suffices": ["--seeds", "16", "--max-seeds", "64", "--within", "0.5"],
    "tune": ["--budget", "3", "--train", "1000:1016", "--judge", "2000:2016"],
}
ELSEWHERE = (  # another machine, seeds without end, or what a test of its own runs, in minutes
    *("tcp://", "elsewhere/", "--until-se", "verify by-runs"),
    *("reproduce all", "run all", "run fair", "score cart"),
    *("simulated.toml", "joint.toml", "bench.toml", "joint-tuned"),
)
FILES = {  # what a page says to save, by the page and what is in it
    "motor.toml": ("your_own_plant.md", '"motor"'),
    "pushed.toml": ("unknown_inputs.md", '"pushed"'),
    "noise-map.toml": ("axes_and_schedules.md", "noise-map"),
    "slower-camera.toml": ("first_study.md", "slower-camera"),
}


def saved(folder):
    """The files of the pages, and a result to look at."""
    for name, (page, said) in FILES.items():
        (folder / name).write_text(next(b for b in blocks("toml", page) if said in b))
    (folder / "mine.py").write_text(blocks("python", "your_own_observer.md")[0])
    (folder / "pendulum.py").write_text(blocks("python", "a_loop_of_your_own.md")[0])
    (folder / "filter.py").write_text(blocks("python", "code_and_guests.md")[0])
    assert call("new", "plant", "swing", cwd=folder).returncode == 0
    assert call("new", "controller", "brake", cwd=folder).returncode == 0
    assert call("run", "quick", *FEW, "--quiet", cwd=folder).returncode == 0


def smaller(words):
    """A command line on few seeds."""
    if words[0] == "tune" or (words[0] == "suffices" and "--below" in words):
        return [*words, *CHEAP[words[0]]]
    if words[0] != "run":
        return words
    if "--seeds" in words:
        at = words.index("--seeds")
        return [*words[: at + 1], "8" if "--first-seed" not in words else "4", *words[at + 2 :]]
    return [*(word if word != "8" else "2" for word in words), *FEW]


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in TEXTS if commands(name)])
def test_every_command_runs(name, tmp_path):
    saved(tmp_path)
    (tmp_path / "new").mkdir()
    for line in commands(name):
        if any(word in line for word in ELSEWHERE):
            continue
        words = smaller(shlex.split(line)[1:])
        done = call(*words, cwd=tmp_path / "new" if words[0] == "new" else tmp_path)  # there is one of that name
        assert done.returncode == 0, (line, done.stdout[-300:], done.stderr[-600:])


def test_what_a_page_says_to_save_is_there():
    for name, (page, said) in FILES.items():
        assert f"`{name}`" in PAGES[page]
        assert said in "".join(blocks("toml", page))
