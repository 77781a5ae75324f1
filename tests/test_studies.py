"""A study in its folder: stopped and gone on with, grown, refused when changed, cut as you like, merged, verified."""

import shutil

import numpy as np
import pandas as pd
import pytest
from commands import call

import pcbench
from pcbench.dataset import blocks, executors, inspection, ledger, merging, store
from pcbench.errors import UserError

STUDY = {
    "name": "small",
    "scenarios": ["cart/slow"],
    "observers": ["pccebo", "kfbo"],
    "seeds": 40,
    "axes": {"noise_std": [0.1, 0.5]},
}
KEY = ["scenario", "observer", "cell", "seed", "signal"]


def tables(out):
    """Every table of a folder by name, as bytes."""
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*.parquet"))}


def rows(out):
    """The runs of a folder in one order."""
    return pd.read_parquet(out / "runs").sort_values(KEY, ignore_index=True)


def same(a, b):
    """The same runs and the same closing tables, however cut."""
    pd.testing.assert_frame_equal(rows(a), rows(b), check_exact=True)
    for name in ("stats.parquet", "pairs.parquet"):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The study as an undisturbed run leaves it, in blocks of 16 seeds."""
    out = tmp_path_factory.mktemp("whole") / "out"
    pcbench.run(STUDY, out=out, block=16)
    return out


@pytest.fixture
def copy(whole, tmp_path):
    return shutil.copytree(whole, tmp_path / "copy")


def counted(monkeypatch):
    """Count the tasks that are done from now on."""
    done, before = [], blocks.compute
    monkeypatch.setattr(blocks, "compute", lambda *a: done.append(a[1]) or before(*a))
    return done


def test_a_finished_study_is_not_done_again(copy, monkeypatch):
    before, done = tables(copy), counted(monkeypatch)
    result = pcbench.run(STUDY, out=copy)
    assert not done
    assert tables(copy) == before
    assert len(result.runs) == 2 * 2 * 40 * 2


@pytest.mark.parametrize("keep", [0, 1, 5, 11])
def test_what_is_missing_is_done_and_nothing_else(copy, keep, monkeypatch):
    want, done = tables(copy), counted(monkeypatch)
    files = sorted((copy / "runs").rglob("*.parquet"))
    for path in np.random.default_rng(keep).permutation(np.array(files, object))[keep:]:
        path.unlink()
    (copy / "stats.parquet").unlink()
    stamps = {p: p.stat().st_mtime_ns for p in (copy / "runs").rglob("*.parquet")}
    pcbench.run(STUDY, out=copy, block=16)
    assert tables(copy) == want
    assert all(p.stat().st_mtime_ns == t for p, t in stamps.items()), "what stood was not touched"
    assert sum(task.runs for task in done) == sum(len(pd.read_parquet(p)) // 2 for p in files if p not in stamps)


def test_a_damaged_block_is_named_and_done_again(copy):
    want, said = tables(copy), []
    path = sorted((copy / "runs").rglob("*.parquet"))[3]
    path.write_bytes(path.read_bytes()[:-20])
    pcbench.run(STUDY, out=copy, block=16, say=said.append)
    assert len(said) == 1
    assert path.name in said[0]
    assert tables(copy) == want


def test_rows_that_two_blocks_hold_are_kept_once(copy):
    """Another process with blocks of another size was at work in the folder."""
    said = []
    pcbench.run(STUDY, out=copy.parent / "other", block=8)
    for path in list((copy.parent / "other" / "runs").rglob("*.parquet"))[:7]:
        shutil.copy(path, copy / path.relative_to(copy.parent / "other"))
    pcbench.run(STUDY, out=copy, say=said.append)
    assert len(said) == 5, "of 7, two have the name of a block that stands"
    same(copy, copy.parent / "other")


@pytest.mark.parametrize("size", [8, 2048])
def test_blocks_of_any_size_hold_the_same(whole, tmp_path, size):
    pcbench.run(STUDY, out=tmp_path / "out", block=size)
    same(whole, tmp_path / "out")


@pytest.mark.parametrize("count", [1, 2, 5])
def test_any_number_of_calls_at_a_time_leaves_the_same_bytes(whole, tmp_path, count):
    pcbench.run(STUDY, out=tmp_path / "out", block=16, devices=count)
    assert tables(tmp_path / "out") == tables(whole)


def test_tasks_done_twice_and_in_any_order_leave_each_row_once(whole, tmp_path, monkeypatch):
    here = executors.here

    def twice_and_backwards(*args):
        from contextlib import contextmanager

        @contextmanager
        def made():
            with here(*args) as execute:
                yield lambda work, tasks: execute(work, [t for t in list(tasks)[::-1] for _ in range(2)])

        return made()

    monkeypatch.setattr(executors, "here", twice_and_backwards)
    pcbench.run(STUDY, out=tmp_path / "out", block=16)
    assert tables(tmp_path / "out") == tables(whole)


def test_more_seeds_extend_a_study(copy, tmp_path):
    pcbench.run(STUDY, out=copy, seeds=61)
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=61)
    same(copy, tmp_path / "at-once")


GROWN = [
    {"axes": {"noise_std": [0.1, 0.5, 1.0]}},
    pytest.param({"axes": {"noise_std": [0.1, 0.5], "drift": [0.0, 1.0]}}, marks=pytest.mark.slow),
    {"axes": {"noise_std": [0.05, 0.1, 0.5], "delay": [1.0, 2.0]}, "seeds": 44},
]


@pytest.mark.parametrize("change", GROWN, ids=str)
def test_more_cells_extend_a_study_and_old_ones_keep_their_numbers(copy, tmp_path, change):
    before = rows(copy)
    pcbench.run(STUDY | change, out=copy)
    pcbench.run(STUDY | change, out=tmp_path / "at-once")
    a, b = rows(copy), rows(tmp_path / "at-once")
    kept = a[(a.cell < 2) & (a.seed < 40)].reset_index(drop=True)
    pd.testing.assert_frame_equal(kept, before, check_exact=True)
    by = ["noise_std", "drift", "delay", "observer", "seed", "signal"]
    a, b = (f.sort_values(by, ignore_index=True).drop(columns="cell") for f in (a, b))
    pd.testing.assert_frame_equal(a, b, check_exact=True)


@pytest.mark.slow
def test_another_observer_extends_a_study(copy, tmp_path):
    more = STUDY | {"observers": ["pccebo", "kfbo", "open-loop"]}
    pcbench.run(more, out=copy)
    pcbench.run(more, out=tmp_path / "at-once")
    same(copy, tmp_path / "at-once")


CHANGED = {
    "a cell less": ({"axes": {"noise_std": [0.1]}}, r"axes.noise_std: \[0.1, 0.5\] there, \[0.1\] here"),
    "a seed less": ({"seeds": 39}, r"seeds: 0 .. 39 there, 0 .. 38 here"),
    "other seeds": ({"first_seed": 1}, r"seeds: 0 .. 39 there, 1 .. 40 here"),
    "root seed": ({"root_seed": 1}, "root_seed: 0 there, 1 here"),
    "name": ({"name": "other"}, "name: 'small' there, 'other' here"),
    "an observer less": ({"observers": ["kfbo"]}, "observers: pccebo there, not here"),
    "an option": ({"options": {"kfbo": {"R": 0.7}}}, r"options of cart/slow.kfbo.R: 0.3 there, 0.7 here"),
    "a choice": ({"options": {"scenario": {"random_start": True}}}, r"random_start: False there, True here"),
    "scenario": ({"scenarios": ["cart/white"]}, "scenarios: cart/slow there, not here"),
}


@pytest.mark.parametrize("case", CHANGED)
def test_a_changed_study_is_refused_with_what_changed(copy, case):
    change, said = CHANGED[case]
    before = {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()}
    with pytest.raises(UserError, match=said) as caught:
        pcbench.run(STUDY | change, out=copy)
    assert "\n" not in str(caught.value)
    assert {p: p.read_bytes() for p in copy.rglob("*") if p.is_file()} == before, "nothing was written"


def test_fresh_starts_over_and_only_when_asked(copy, tmp_path):
    other = STUDY | {"seeds": 8}
    pcbench.run(other, out=copy, fresh=True)
    pcbench.run(other, out=tmp_path / "new")
    same(copy, tmp_path / "new")


MISTAKES = [
    *({"memory": "2Gx"}, {"block": 0}, {"until_se": "mae"}, {"dask": "nonsense"}, {"max_seeds": 3}, {"workers": 2}),
    *({"dask": "local", "workers": 0}, {"devices": -1}),
]


@pytest.mark.parametrize("mistake", MISTAKES, ids=str)
def test_a_mistake_beside_fresh_removes_nothing(copy, mistake, monkeypatch):
    monkeypatch.setattr(executors, "PATIENCE", "1s")
    before = tables(copy)
    with pytest.raises(UserError) as caught:
        pcbench.run(STUDY | {"seeds": 8}, out=copy, fresh=True, **mistake)
    assert "\n" not in str(caught.value)
    assert tables(copy) == before


def test_fresh_keeps_a_study_that_somebody_wrote(tmp_path):
    (tmp_path / "study.toml").write_text('name = "mine"\nscenarios = ["cart/slow"]\n')
    with pytest.raises(UserError, match="is not as pcbench run has written it"):
        pcbench.run(STUDY, out=tmp_path, fresh=True)
    assert (tmp_path / "study.toml").exists()


NOT_OURS = ["", "seeds = 3", "[resolved]", "resolved = 3", "x = [", 'seeds = "a"\nfirst_seed = 0\n[resolved]']


@pytest.mark.parametrize("text", NOT_OURS)
def test_a_study_text_that_is_not_ours_is_one_sentence(copy, text):
    (copy / "study.toml").write_text(text)
    for act in (lambda: pcbench.run(STUDY, out=copy), lambda: inspection.status(copy)):
        with pytest.raises(UserError, match="is not as pcbench run has written it"):
            act()


def test_a_damaged_block_does_not_stand_when_a_study_grows_over_it(copy, tmp_path):
    """The gap is cut anew, under another name."""
    path = max((copy / "runs").rglob("*.parquet"))
    path.write_bytes(path.read_bytes()[:-20])
    pcbench.run(STUDY, out=copy, seeds=61, block=100)
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=61)
    same(copy, tmp_path / "at-once")


def test_a_damaged_closing_table_is_made_anew(copy):
    want = tables(copy)
    (copy / "stats.parquet").write_bytes(want["stats.parquet"][:-9])
    assert inspection.verify(copy, 0, 0, lambda *a: None).wrong
    pcbench.run(STUDY, out=copy)
    assert tables(copy) == want


def test_more_seeds_that_never_ran_bind_nobody(copy, monkeypatch):
    def refuse(*args):
        raise UserError("disk: is full, expected room; make some.")

    monkeypatch.setattr(blocks, "compute", refuse)
    with pytest.raises(UserError, match="disk"):
        pcbench.run(STUDY, out=copy, seeds=4000)
    monkeypatch.undo()
    pcbench.run(STUDY, out=copy)
    assert inspection.status(copy).closed


def test_columns_keep_their_kind_when_a_study_grows(tmp_path):
    """One number for all channels stays one: a list beside it could not be read together."""
    tank = {"name": "tank", "scenarios": ["csth/10s-noise"], "observers": ["dkf"], "seeds": 2}
    pcbench.run(tank | {"axes": {"delay": [[40.0, 40.0, 40.0]]}}, out=tmp_path / "out")
    with pytest.raises(UserError, match=r"axes.delay: a number for all channels"):
        pcbench.run(tank | {"axes": {"delay": [[40.0, 40.0, 40.0], [20.0, 50.0, 70.0]]}}, out=tmp_path / "out")


def test_files_that_other_systems_leave_are_passed_over(copy):
    for name in (".DS_Store", ".nfs000001", "_SUCCESS"):
        (next((copy / "runs").rglob("cell-*")).parent / name).write_text("")
    pcbench.run(STUDY, out=copy)
    assert inspection.status(copy).closed


def test_fresh_removes_nothing_of_others(tmp_path):
    (tmp_path / "thesis.tex").write_text("precious")
    for fresh in (False, True):
        with pytest.raises(UserError, match="holds other files"):
            pcbench.run(STUDY, out=tmp_path, fresh=fresh)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_folder_removed_while_running_is_one_sentence(tmp_path, monkeypatch):
    out, before = tmp_path / "out", blocks.compute
    monkeypatch.setattr(blocks, "compute", lambda *a: (shutil.rmtree(out, ignore_errors=True), before(*a))[1])
    with pytest.raises(UserError, match=r"cannot be written \(No such file or directory\)"):
        pcbench.run(STUDY, out=out)
    assert not out.exists()


def test_a_disk_that_fills_up_keeps_every_finished_block(whole, tmp_path, monkeypatch):
    import os

    left, sync = [5], os.fsync

    def fill_up(handle):
        left[0] -= 1
        if left[0] < 0:
            raise OSError(28, "No space left on device")
        sync(handle)

    monkeypatch.setattr(store.os, "fsync", fill_up)
    with pytest.raises(UserError, match=r"No space left on device\); every file already written is complete"):
        pcbench.run(STUDY, out=tmp_path / "out", block=16)
    monkeypatch.undo()
    finished = tables(tmp_path / "out")
    assert 0 < len(finished) < 12
    assert all(tables(whole)[name] == content for name, content in finished.items())
    assert not inspection.status(tmp_path / "out").closed
    pcbench.run(STUDY, out=tmp_path / "out", block=16)
    assert tables(tmp_path / "out") == tables(whole)


def test_status_says_how_far_a_study_is(copy):
    found = inspection.status(copy)
    assert found.closed
    assert [(s.observer, s.cells, s.seeds, s.wanted) for s in found.shares] == [
        ("pccebo", 2, 80, 80),
        ("kfbo", 2, 80, 80),
    ]
    files = sorted((copy / "runs").rglob("*.parquet"))
    files[0].unlink()
    files[1].write_bytes(b"PAR1")
    found = inspection.status(copy)
    assert not found.closed
    assert len(found.damaged) == 1
    assert sum(s.seeds for s in found.shares) == 160 - 16


def test_verify_finds_a_number_that_was_changed_and_nothing_else(copy):
    found = inspection.verify(copy, None, 0, lambda *a: None)
    assert (found.files, len(found.recomputed), found.wrong, found.differing) == (12, 12, [], [])
    place = store.target(copy)
    b = ledger.present(place)[5]
    table = ledger.read(place, b)
    i = table.schema.get_field_index("rmse")
    values = table["rmse"].to_numpy().copy()
    values[7] = np.nextafter(values[7], 1e9)
    changed = table.set_column(i, table.schema.field(i), [values])
    store.put_table(place, b.name, ledger.sealed(changed, ledger.about(table)))
    found = inspection.verify(copy, None, 0, lambda *a: None)
    assert len(found.differing) == 1
    assert b.name in found.differing[0]
    assert "rounding" in found.differing[0]
    assert [w.split(":")[0] for w in found.wrong] == ["stats.parquet", "pairs.parquet"], "they do not follow any more"


def test_two_halves_merged_are_the_whole(whole, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=25, block=16)
    pcbench.run(STUDY, out=b, seeds=24, first_seed=16, block=10)
    made = merging.merge([b, a], tmp_path / "both")
    assert (made.missing, made.doubled) == (0, 2 * 2 * 9)
    same(tmp_path / "both", whole)
    again = pcbench.run(STUDY, out=tmp_path / "both")
    assert again.provenance["merged"]
    assert "Nothing was left to do" in call("run", str(a / "study.toml"), "--out", str(a)).stdout
    same(tmp_path / "both", whole)


def test_cells_numbered_otherwise_are_merged_by_what_they_are(tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=9)
    pcbench.run(STUDY | {"axes": {"noise_std": [0.5, 0.1]}}, out=b, seeds=5, first_seed=9)
    merging.merge([a, b], tmp_path / "both")
    pcbench.run(STUDY, out=tmp_path / "at-once", seeds=14)
    same(tmp_path / "both", tmp_path / "at-once")


def test_a_gap_between_merged_parts_is_said_and_can_be_filled(whole, tmp_path):
    a, b = tmp_path / "a", tmp_path / "b"
    pcbench.run(STUDY, out=a, seeds=10)
    pcbench.run(STUDY, out=b, seeds=20, first_seed=20)
    made = merging.merge([a, b], tmp_path / "both")
    assert made.missing == 2 * 2 * 10
    assert not (tmp_path / "both" / "stats.parquet").exists()
    pcbench.run(STUDY, out=tmp_path / "both")
    same(tmp_path / "both", whole)


def test_parts_that_disagree_are_not_merged(copy, whole, tmp_path):
    place = store.target(copy)
    b = ledger.present(place)[0]
    table = ledger.read(place, b)
    i = table.schema.get_field_index("mae")
    changed = table.set_column(i, table.schema.field(i), [table["mae"].to_numpy() * (1 + 1e-12)])
    store.put_table(place, b.name, ledger.sealed(changed, ledger.about(table)))
    with pytest.raises(UserError, match=r"differ by 1.0e-12 of themselves"):
        merging.merge([whole, copy], tmp_path / "both")
    assert not (tmp_path / "both").exists()


def test_other_studies_are_not_merged(whole, tmp_path):
    pcbench.run(STUDY | {"options": {"kfbo": {"R": 0.7}}}, out=tmp_path / "b", seeds=3)
    with pytest.raises(UserError, match=r"options of cart/slow.kfbo.R: 0.3 there, 0.7 here"):
        merging.merge([whole, tmp_path / "b"], tmp_path / "both")


def test_a_cell_has_the_same_bits_alone_and_among_others(whole, tmp_path):
    """Room for a longer delay, for more samples at a time, and for drift changes no number."""
    among = STUDY | {"axes": {"noise_std": [0.1, 0.5], "delay": [1.0, 3.0], "drift": [0.0, 1.0]}, "seeds": 16}
    pcbench.run(among, out=tmp_path / "many")
    a, b = rows(whole), rows(tmp_path / "many")
    a, b = a[a.seed < 16], b[(b.delay == 1.0) & (b.drift == 0.0)]
    by = ["noise_std", "observer", "seed", "signal"]
    a, b = (f.sort_values(by, ignore_index=True).drop(columns="cell") for f in (a, b))
    pd.testing.assert_frame_equal(a, b, check_exact=True)


def test_commands_on_a_dataset_answer(copy, tmp_path):
    assert "Every run is there" in call("status", str(copy)).stdout
    done = call("verify", str(copy), "--sample", "1")
    assert "all 12 blocks are whole; 1 of 1 came out again" in done.stdout, done.stderr
    done = call("merge", str(copy), str(copy), "--out", str(tmp_path / "m"))
    assert "160 runs stood in more than one" in done.stdout, done.stderr
    for words in (
        ["status", str(tmp_path)],
        ["verify", str(tmp_path)],
        ["merge", str(copy), "--out", str(tmp_path / "n")],
    ):
        done = call(*words)
        assert done.returncode == 2
        assert done.stderr.count("\n") == 1, done.stderr


ELSEWHERE = {
    "csth/10s-noise": ({"delay": [[20.0, 50.0, 70.0], [20.0, 50.0, 120.0]]}, {}),
    "cart/variable": ({"delay": [0.2, 0.6], "loss": [0.0, 0.2]}, {}),
    "arm/sampled": ({"delay": [0.02, 0.1], "drift": [0.0, 0.05]}, {}),
    "helicopter/constant": (
        {"delay": [0.01, 0.04], "sampling_period": [0.05, 0.2]},
        {"observers": ["high-gain", "ekf"]},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ELSEWHERE)
def test_every_scenarios_cells_have_the_same_bits_alone_and_among_others(scenario, tmp_path):
    axes, more = ELSEWHERE[scenario]
    study = {"name": "bits", "scenarios": [scenario], "seeds": 3} | more
    first = {name: values[:1] for name, values in axes.items()}
    pcbench.run(study | {"axes": axes}, out=tmp_path / "many")
    pcbench.run(study | {"axes": first}, out=tmp_path / "one")
    a, b = rows(tmp_path / "one"), rows(tmp_path / "many")
    pd.testing.assert_frame_equal(a, b[b.cell == 0].reset_index(drop=True), check_exact=True)
