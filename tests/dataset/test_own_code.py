"""A dataset made with observers of a user's own: it keeps their code, is read without it, and refuses another version of it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from small_study import tables

import pcbench
from pcbench.cli.commands import app
from pcbench.dataset import merge, storage, verify
from pcbench.dataset.compare import compare
from pcbench.report import page
from pcbench.study import parse

pytestmark = pytest.mark.usefixtures("in_a_hurry")

SOURCE = Path(__file__).parents[1] / "support" / "own_observer.py"
STUDY = {"name": "mine", "scenarios": ["cart/slow"], "observers": ["mine.py:nudge", "kfbo"], "seeds": 16}


def marking(text):
    return f"{text}\nimport os\n\nopen(os.environ['MARK'], 'a').close()\n"


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with an observer whose code leaves a mark wherever it is run, the copy of a dataset too."""
    (tmp_path / "mine.py").write_text(marking(SOURCE.read_text()))
    monkeypatch.setenv("MARK", str(tmp_path / "mark"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The study once, to be copied."""
    folder = tmp_path_factory.mktemp("own")
    (folder / "mine.py").write_text(marking(SOURCE.read_text()))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MARK", str(folder / "mark"))
        patch.chdir(folder)
        pcbench.run(STUDY, out="out")
    return folder / "out"


@pytest.fixture
def out(here, made):
    return shutil.copytree(made, here / "out")


def forget(here):
    """Be as another process: no module of the user's own is loaded, and none has been run."""
    (here / "mark").unlink(missing_ok=True)
    for name in [name for name in sys.modules if name.startswith("mine_")]:
        del sys.modules[name]


@pytest.mark.ci
def test_it_keeps_the_code_and_runs_none_of_it_to_be_read(here, out):
    (copy,) = (out / "code").rglob("*.py")
    assert copy.read_bytes() == (here / "mine.py").read_bytes()
    (here / "mine.py").unlink()
    forget(here)
    assert page.write(out, here / "page.html")
    assert set(pcbench.open_result(out).stats.observer) == {"nudge", "kfbo"}
    assert verify.status(out).closed
    assert compare(out, out).largest == 0
    merge.merge([out, out], here / "merged")
    assert tables(here / "merged")["stats.parquet"]
    assert not verify.verify(out, 0, 0).wrong
    assert not (here / "mark").exists(), "nothing of it was run"
    parse.load(str(out / "study.toml"))
    assert (here / "mark").exists(), "as a study file it is"
    copy.unlink()
    assert set(pcbench.open_result(out).stats.observer) == {"nudge", "kfbo"}


@pytest.mark.ci
def test_exact_values_with_a_sample_of_none_are_refused_and_run_no_code(here, out):
    forget(here)
    with pytest.raises(pcbench.UserError, match="--sample has no effect with --exact"):
        app(["verify", "out", "--sample", "0", "--exact", "--quiet"], standalone_mode=False)
    assert not (here / "mark").exists()


@pytest.mark.ci
def test_it_comes_out_again_by_the_copy(here, out):
    (here / "mine.py").unlink()
    forget(here)
    found = verify.verify(out, None, 0)
    assert (here / "mark").exists()
    assert not found.wrong
    assert not found.differing
    assert len(found.recomputed) == 2


def test_a_changed_copy_is_named(here, out):
    (copy,) = (out / "code").rglob("*.py")
    copy.write_text(copy.read_text() + "\n# more\n")
    forget(here)
    with pytest.raises(pcbench.UserError, match=r"code/\w+/mine.py: is missing or changed"):
        verify.verify(out, None, 0)


def test_another_version_is_refused_with_what_changed(here, out):
    before = tables(out)
    (here / "mine.py").write_text((here / "mine.py").read_text().replace("share / noisier", "share / noisier / 2"))
    changed = r"the code of nudge: mine.py has changed since\)"
    with pytest.raises(pcbench.UserError, match=changed):
        pcbench.run(STUDY | {"seeds": 32}, out="out")
    assert tables(out) == before
    pcbench.run(STUDY | {"seeds": 8}, out="out", overwrite=True)
    assert len(list((out / "code").rglob("*.py"))) == 1, "the old copy went with the old runs"


@pytest.mark.nightly
def test_a_study_refuses_a_changed_imported_file_by_its_name(here):
    source = (here / "mine.py").read_text().replace("share: float = 0.1", "share: float = pcbench.tunable(SHARE, gt=0)")
    (here / "mine.py").write_text(source.replace("import pcbench\n", "import pcbench\nfrom part import SHARE\n", 1))
    (here / "part.py").write_text("SHARE = 0.1\n")
    tuned = {"tuning": "tuned", "tune": {"budget": 1, "training": 2}, "seeds": 2}
    study = (
        STUDY
        | tuned
        | {"observers": ["mine.py:nudge"], "scenario": {"base": "cart/slow", "duration": 2.0, "steady_start": 1.0}}
    )
    del study["scenarios"]
    pcbench.run(study, out="out")
    page.write(here / "out", here / "page.html")
    text = (here / "page.html").read_text()
    assert "The gains of nudge were tuned for rmse of position" in text
    before = tables(here / "out")
    (here / "part.py").write_text("SHARE = 0.2\n")
    found = r"out/tuning/nudge: contains another tuning \(the code of nudge: part.py has changed .*; give .* with --overwrite.$"
    with pytest.raises(pcbench.UserError, match=found):
        pcbench.run(study, out="out")
    with pytest.raises(
        pcbench.UserError, match=r"out: holds .* \(the code of nudge: part.py has changed since.* --overwrite.$"
    ):
        pcbench.run(study | {"tuning": "published"}, out="out")
    assert tables(here / "out") == before
    (here / "part.py").write_text("SHARE = 0.1\n")
    found = r"nudge: contains another tuning \(.*sampling_period.*expected the same study"
    with pytest.raises(pcbench.UserError, match=found):
        pcbench.run(study | {"scenario": study["scenario"] | {"sampling_period": 0.4}}, out="out")


def test_it_grows_from_its_own_study_file(here, out):
    (here / "mine.py").unlink()
    forget(here)
    assert len(pcbench.run(str(out / "study.toml"), seeds=24, out=out).runs.seed.unique()) == 24


def test_a_study_whose_text_is_lost_knows_blocks_by_their_code(here, out):
    (out / "study.toml").unlink()
    pcbench.run(STUDY, out="out")
    (out / "study.toml").unlink()
    (here / "mine.py").write_text((here / "mine.py").read_text() + "\n# another\n")
    with pytest.raises(pcbench.UserError, match="options of nudge"):
        pcbench.run(STUDY, out="out")


def test_only_what_is_named_is_copied(here):
    pcbench.run(STUDY | {"observers": ["kfbo"], "seeds": 4}, out="plain")
    assert not (here / "plain" / "code").exists()
    assert storage.file_names(storage.target("plain"), "code") == []


LOOP = {"name": "s", "scenarios": ["mine.py:late"], "observers": ["mine.py:nudge", "kf"], "seeds": 4}


@pytest.mark.nightly
def test_plants_and_laws_are_kept_likewise(here):
    """One dataset of an observer, a plant, a law and a scenario: read without the file, come out again by the copy."""
    loop = SOURCE.with_name("own_loop.py").read_text().replace("Options", "Gentle")
    entry = 'law = pcbench.ControllerSpec(options=Gentle, prepare=prepare, summary="PI", controller='
    loop = loop.replace("law = ", entry, 1).replace("params.m,\n)", "params.m,\n))")
    (here / "mine.py").write_text(marking(SOURCE.read_text() + loop))
    pcbench.run(LOOP, out="out")
    before = tables(here / "out")
    kept = (here / "mine.py").rename(here / "aside.py")
    forget(here)
    assert page.write(here / "out", here / "page.html")
    opened = pcbench.open_result("out")
    assert set(opened.stats.observer) == {"nudge", "kf"}
    assert verify.status(here / "out").closed
    assert compare(here / "out", here / "out").largest == 0
    assert not (here / "mark").exists(), "nothing of it was run"
    found = verify.verify(here / "out", None, 0)
    assert (found.wrong, found.differing, len(found.recomputed)) == ([], [], 2)
    kept.rename(here / "mine.py")
    assert pcbench.run(LOOP, out="out").cost.runs == 0, "its blocks are known again"
    (here / "mine.py").write_text((here / "mine.py").read_text().replace("0.4  # 1/s", "0.5  # 1/s"))
    with pytest.raises(pcbench.UserError, match=r"the code of plant pendulum: mine\.py has changed since"):
        pcbench.run(LOOP | {"seeds": 8}, out="out")
    assert tables(here / "out") == before


@pytest.mark.nightly
def test_a_report_has_the_run_in_time_that_was_kept(here):
    """By the command line: the code is at hand when the study is run, and gone when it is reported."""
    call = [sys.executable, "-m", "pcbench"]
    run = [*call, "run", "cart/slow", "--observers", "mine.py:nudge,kfbo", "--seeds", "4", "--out", "out", "--quiet"]
    subprocess.run(run, check=True, cwd=here, capture_output=True)
    (here / "mine.py").unlink()
    done = subprocess.run([*call, "report", "out"], cwd=here, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    page = (here / "out" / "report.html").read_text()
    assert "nudge" in page
    assert "Seed 0" in page or "seed 0" in page


@pytest.mark.nightly
@pytest.mark.parametrize("study", [STUDY, LOOP | {"observers": ["kf"], "seeds": 8}], ids=["observer", "plant and law"])
def test_workers_need_no_file(here, study):
    """Two Dask workers that stand in another folder leave the bytes that this process leaves."""
    pytest.importorskip("distributed")
    if study is not STUDY:
        shutil.copy(SOURCE.with_name("own_loop.py"), here / "mine.py")
    pcbench.run(study, out=here / "whole", block_size=4)
    code = f"import pcbench; pcbench.run({study!r}, out={str(here / 'out')!r}, block_size=4, dask='local', workers=2)"
    script = here / "go.py"
    script.write_text(f"if __name__ == '__main__':\n    {code}\n")
    subprocess.run([sys.executable, str(script)], check=True, cwd=here, env=os.environ | {"PYTHONPATH": ROOT})
    assert tables(here / "out") == tables(here / "whole")


ROOT = str(Path(pcbench.__file__).parents[1])
