"""Finished tunings in the cache: found by the same call of the same code, and by no other."""

import pytest

import pcbench
from pcbench.dataset.seed_ranges import seed_range
from pcbench.gains import history, tune

LOAD = history.copy_from_cache  # before the tests are kept from it
SHORT = {"base": "cart/white", "name": "short", "duration": 1.0, "steady_start": 0.5}
STUDY = {"name": "kept", "scenario": SHORT, "observers": ["kf"]}
CALL = {"budget": 2, "training_seeds": (0, 4), "validation_seeds": (100, 104), "only": ["q"]}


JUDGED = history.Judgement(
    what="validation", seeds=seed_range(100, 4), start=2.0, start_se=0.1, tuned=1.0, tuned_se=0.1,
    difference=-1.0, difference_se=0.1, diverged=(0, 0),
)  # fmt: skip


@pytest.fixture
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def evaluations(monkeypatch, cache):
    """How often an objective was evaluated, with a cache of its own."""
    monkeypatch.setenv("PCBENCH_CACHE", str(cache))
    monkeypatch.setattr(history, "copy_from_cache", LOAD)
    asked = []

    def evaluator(*_):
        return lambda at: asked.append(at) or (float(sum(at**2)), 2 * at)

    monkeypatch.setattr(tune.objective_eval, "evaluator", evaluator)
    monkeypatch.setattr(tune, "judge", lambda *_: [JUDGED])
    monkeypatch.setattr(tune, "rejection_reason", lambda _: "")
    return asked


def once(study=STUDY, **changes):
    return pcbench.tune(study, "kf", **CALL | changes)


def test_the_same_call_evaluates_nothing_and_returns_the_same(evaluations, cache, tmp_path):
    first = once()
    count = len(evaluations)
    assert count == len(first.points) > 0
    assert once() == first
    assert once(out=tmp_path / "out") == first
    assert len(evaluations) == count
    kept = next((cache / "gains").glob("tuning-*"))
    assert {path.name: path.read_bytes() for path in (tmp_path / "out").iterdir()} == {
        path.name: path.read_bytes() for path in kept.iterdir()
    }


OTHERS = {
    "budget": ({}, {"budget": 3}),
    "training seeds": ({}, {"training_seeds": (1, 5)}),
    "validation seeds": ({}, {"validation_seeds": (200, 204)}),
    "objective": ({}, {"objective": "mae"}),
    "scenario": ({"scenario": SHORT | {"duration": 1.2}}, {}),
    "options": ({"options": {"kf": {"q": 2.0}}}, {}),
    "root seed": ({"root_seed": 1}, {}),
}


@pytest.mark.parametrize("name", OTHERS)
def test_another_call_is_evaluated(evaluations, name):
    study, changes = OTHERS[name]
    once()
    count = len(evaluations)
    once(STUDY | study, **changes)
    assert len(evaluations) > count


def test_other_code_or_another_library_is_evaluated(evaluations, monkeypatch):
    once()
    count = len(evaluations)
    monkeypatch.setattr(history, "_versions", lambda: "other")
    once()
    assert len(evaluations) == 2 * count


@pytest.mark.parametrize("name", [history.HISTORY, history.TUNED])
def test_a_damaged_entry_is_no_entry(evaluations, cache, name):
    found = once().best
    count = len(evaluations)
    (kept,) = (cache / "gains").glob("tuning-*")
    (kept / name).write_bytes(b"damaged")
    assert once().best == found
    assert len(evaluations) == 2 * count
    assert once().best == found
    assert len(evaluations) == 2 * count


def test_a_folder_with_another_tuning_is_refused(evaluations, tmp_path):
    once()
    once(training_seeds=(2, 6), out=tmp_path)
    with pytest.raises(history.AnotherTuning):
        once(out=tmp_path)
