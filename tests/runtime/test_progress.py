"""Progress: one bar draws what any long work says, and work is the same whoever listens."""

import io

import pytest
from rich import progress as rich
from rich.console import Console

import pcbench
from pcbench.cli.interrupts import stoppable
from pcbench.cli.render.progress import Rate, Remaining, bar, draw_progress
from pcbench.dataset import run_missing
from pcbench.gains import tune
from pcbench.runtime.progress import SILENT, Progress

SMALL = {"name": "small", "scenarios": ["cart/nominal"], "observers": ["pccebo"], "seeds": 3}


def listener():
    """A Progress and the list of what it has heard."""
    heard = []
    kinds = ("begin", "step", "note")
    return Progress(*(lambda *said, kind=kind: heard.append((kind, *said)) for kind in kinds)), heard


@pytest.mark.ci
def test_a_study_says_how_many_runs_there_are_and_steps_over_all_of_them():
    progress, heard = listener()
    pcbench.run(SMALL, progress=progress)
    assert heard[:2] == [("begin", "runs", 3), ("note", "compiling program 1 of 1")]
    assert sum(said[1] for said in heard if said[0] == "step") == 3
    assert heard[-1] == ("note", "statistics")


@pytest.mark.nightly
def test_a_tuning_steps_once_a_point():
    progress, heard = listener()
    found = tune.tune(
        "cart/gaussian",
        "pccebo",
        budget=2,
        optimizer="search",
        training_seeds=(0, 4),
        validation_seeds=(4, 8),
        progress=progress,
    )
    assert heard[0] == ("begin", "points", 2)
    assert [said for said in heard if said[0] == "step"] == [("step", 1)] * len(found.points)
    assert heard[-1] == ("note", "validation on other seeds")


def lines(clock=None):
    return rich.Progress(console=Console(file=io.StringIO()), disable=True, get_time=clock)


def test_more_of_the_same_work_lengthens_its_line_and_other_work_has_its_own():
    bars = lines()
    progress = draw_progress(bars, "designing gains")
    for many in (10, 5):
        progress.begin("runs", many)
        progress.note("simulating")
        progress.step(many)
    assert [(t.description, t.completed, t.total) for t in bars.tasks] == [("simulating", 15, 15)]
    progress.begin("checking", 4)
    progress.step(1)
    assert [(t.description, t.completed, t.total) for t in bars.tasks][1:] == [("checking", 1, 4)]


def test_a_rate_is_shown_of_runs_only():
    seconds = iter(range(1000))
    bars = lines(lambda: float(next(seconds)))
    progress = draw_progress(bars)
    for what in ("runs", "checking"):
        progress.begin(what, 100)
        progress.step(20)
        progress.step(20)
    assert bars.tasks[1].speed > 0
    rates = [Rate().render(task).plain for task in bars.tasks]
    assert rates[0].endswith(" runs/s")
    assert rates[1] == ""


def test_the_remaining_time_is_not_estimated_while_programs_compile():
    seconds = iter(range(1000))
    bars = lines(lambda: float(next(seconds)))
    progress = draw_progress(bars)
    progress.begin("runs", 100)
    shown = []
    for note in ("compiling program 1 of 2", "compiling program 2 of 2", "simulating"):
        progress.note(note)
        for _ in range(3):
            progress.step(5)
        shown.append(Remaining().render(bars.tasks[0]).plain)
    assert shown[:2] == ["", ""]
    assert shown[2].count(":") == 2


def test_notes_count_the_programs_of_a_study():
    says = run_missing._activity
    assert says(0, 2) == "compiling program 1 of 2"
    assert says(1, 2) == "compiling program 2 of 2"
    assert says(2, 2) == "simulating"


def test_nothing_is_drawn_where_it_is_to_be_quiet_or_there_is_no_terminal():
    for quiet in (True, False):  # pytest's standard error is no terminal
        with bar(quiet, "designing gains") as progress:
            assert progress is SILENT


def test_what_can_be_stopped_hears_the_same():
    progress, heard = listener()
    stoppable(progress).begin("runs", 3)
    assert heard == [("begin", "runs", 3)]
