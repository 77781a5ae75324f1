"""Links and files of others in a dataset: nothing outside it is read, written or removed, nothing of the user is."""

import os
import shutil
from contextlib import suppress

import pytest

import pcbench
from pcbench.dataset import moments_tables, storage, verify
from pcbench.gains import gain_variants
from pcbench.study import STUDIES

pytestmark = pytest.mark.usefixtures("in_a_hurry")
ASKED = {"study": "cart/slow", "observers": ["kf"], "seeds": 2}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    out = tmp_path_factory.mktemp("links") / "ds"
    pcbench.run(**ASKED, out=out)
    return out


@pytest.fixture
def ds(made, tmp_path):
    return shutil.copytree(made, tmp_path / "ds")


@pytest.fixture
def victim(tmp_path):
    (tmp_path / "victim" / "sub").mkdir(parents=True)
    (tmp_path / "victim" / "thesis.txt").write_text("a")
    (tmp_path / "victim" / "sub" / "data.csv").write_text("b")
    return tmp_path / "victim"


def content(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.ci
@pytest.mark.parametrize("overwrite", [True, False])
@pytest.mark.parametrize("name", ["code", "runs", "moments", "runs/scenario=cart%2Fslow", "study.toml"])
def test_no_link_is_followed_below_a_dataset(ds, victim, name, overwrite):
    before, place = content(victim), ds / name
    if place.is_dir():
        shutil.copytree(place, victim / "copy")
        shutil.rmtree(place)
    elif place.exists():
        shutil.copy(place, victim / "copy")
        place.unlink()
    place.symlink_to(victim / "copy" if (victim / "copy").exists() else victim)
    before = content(victim)
    with suppress(pcbench.UserError):  # a link that is in nobody's way is left alone
        pcbench.run(**ASKED | {"seeds": 4}, out=ds, overwrite=overwrite)
    assert content(victim) == before


@pytest.mark.ci
def test_a_table_that_is_a_link_is_not_read(ds, tmp_path):
    (ds / "stats.parquet").rename(tmp_path / "private.parquet")
    (ds / "stats.parquet").symlink_to(tmp_path / "private.parquet")
    with pytest.raises(pcbench.UserError, match=r"stats.parquet: is a symbolic link"):
        pcbench.open_result(ds)
    (block,) = (ds / "runs").rglob("*.parquet")
    (ds / "stats.parquet").unlink()
    block.rename(tmp_path / "block.parquet")
    block.symlink_to(tmp_path / "block.parquet")
    with pytest.raises(pcbench.UserError, match=r"seeds-\d+-\d+.parquet: is a symbolic link"):
        verify.status(ds)


def test_a_link_to_the_dataset_itself_may_be_given(ds, tmp_path):
    (tmp_path / "there").symlink_to(ds)
    assert len(pcbench.open_result(tmp_path / "there").runs)


def test_a_folder_of_the_users_own_beside_a_study_is_refused_with_fresh_too(ds, tmp_path):
    mixed = tmp_path / "mixed"
    (mixed / "code").mkdir(parents=True)
    shutil.copy(ds / "study.toml", mixed)
    (mixed / "code" / "mylib.py").write_text("my = 1")
    with pytest.raises(pcbench.UserError, match=r"mixed: contains other files \(code/mylib.py\)"):
        pcbench.run(**ASKED, out=mixed, overwrite=True)
    (mixed / "thesis.tex").write_text("mine")
    (mixed / "code" / "mylib.py").rename(mixed / "mylib.py")
    with pytest.raises(pcbench.UserError, match=r"mixed: contains other files \(mylib.py\)"):
        pcbench.run(**ASKED, out=mixed, overwrite=True)
    assert sorted(p.name for p in mixed.rglob("*.*")) == ["mylib.py", "study.toml", "thesis.tex"]


def test_fresh_removes_only_what_a_run_has_written(ds):
    (ds / "code").mkdir()
    (ds / "code" / "mylib.py").write_text("my = 1")
    before = content(ds)
    with pytest.raises(pcbench.UserError, match=r"contains other files \(code/mylib.py\)"):
        pcbench.run(**ASKED, out=ds, overwrite=True)
    assert content(ds) == before
    (ds / "code" / "mylib.py").unlink()
    (ds / "code" / "0123456789ab").mkdir()
    (ds / "code" / "0123456789ab" / "mine.py").write_text("")
    (ds / "thesis.tex").write_text("mine")
    pcbench.run(**ASKED, out=ds, overwrite=True)
    assert not list((ds / "code").rglob("*.py"))
    assert (ds / "thesis.tex").exists()


def test_forms_of_what_is_removed_leave_names_of_users_alone(tmp_path):
    ours = "moments/scenario=cart%2Fslow/cell=0.parquet"
    assert [n for n in (ours, "moments.md", "moments/mine.parquet") if moments_tables.OVER_TIME.fullmatch(n)] == [ours]
    for name in (
        "tuning/mine/notes.txt",
        "tuning/kf/history.parquet",
        "tuning/kf/tuned.toml",
        "tuning/kf/tuned.toml.old",
    ):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("")
    gain_variants._require_study_folder(STUDIES["quick"], tmp_path, True)
    assert storage.file_names(storage.target(tmp_path)) == ["tuning/kf/tuned.toml.old", "tuning/mine/notes.txt"]


def test_an_unfinished_file_is_new_and_no_link(tmp_path, monkeypatch):
    """Whoever may write into the folder cannot choose by a link where the next unfinished file is written."""
    victim, target = tmp_path / "victim", storage.target(tmp_path / "ds")
    victim.write_text("mine")
    storage.create_folder(target)
    monkeypatch.setattr(storage, "_COUNT", iter([7, 7, 8, 9]))
    storage.write_file(target, "first", b"1")
    unfinished = next(iter(storage._partial(target.root)[:1]))
    assert "-7.partial" in unfinished
    os.unlink(unfinished)
    monkeypatch.setattr(storage, "_COUNT", iter([7, 8]))
    os.symlink(victim, unfinished)
    storage.write_file(target, "second", b"2")
    assert (tmp_path / "ds" / "second").read_bytes() == b"2"
    assert victim.read_text() == "mine"


def test_fresh_accepts_the_report_beside_exact_results(ds):
    for name in storage.file_names(storage.target(ds), "runs"):
        (ds / name).unlink()
    (ds / "report.html").write_text("a page of pcbench report")
    pcbench.run(**ASKED, out=ds, overwrite=True)
    assert (ds / "stats.parquet").exists()
