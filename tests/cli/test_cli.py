"""The command line as a user meets it: real processes, exit codes, one sentence for every mistake."""

import json
import signal
import subprocess
import sys
import time
from importlib.metadata import version

import pandas as pd
import pytest
from commands import call
from pyarrow import csv

PCBENCH = [sys.executable, "-m", "pcbench"]
SMALL = ["cart/slow", "--observers", "pccebo,kfbo"]  # the program of `small_study`


ENDS = """
import atexit, sys
import pcbench.cli

def stop():
    atexit.register(print, "called", flush=True)
    sys.exit({code})

pcbench.cli.main = stop
pcbench.cli.program()
"""


@pytest.mark.parametrize("code", [0, 2, 130])
def test_program_ends_with_its_code_and_calls_functions_of_atexit(code):
    done = subprocess.run([sys.executable, "-c", ENDS.format(code=code)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout) == (code, "called\n"), done.stderr


def assert_refusal(done):
    """Exit code 2, nothing on standard output, one sentence."""
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("pcbench: ")
    assert lines[0].endswith(".")
    return lines[0]


BAD = {
    "study": (["run", "quik"], "'quik' is no study", "'quick'"),
    "observer": (["run", "quick", "--observers", "pcebo"], "'pcebo' is no observer", "'pccebo'"),
    "axis": (["run", "quick", "--set", "axes.noise=1"], "'noise' is no axis", "'noise_std'"),
    "option": (["run", "quick", "--set", "options.kfbo.lagaware=true"], "'lagaware'", "'lag_aware'"),
    "option value": (["run", "quick", "--set", "options.kfbo.R=-1"], "options.kfbo: R: got -1", "greater than 0"),
    "whole ticks": (["run", "quick", "--set", "axes.delay=0.2005"], "got 0.2005 s", "0.2 or 0.201"),
    "no period": (["run", "quick", "--set", "axes.sampling_period=0"], "got 0 s", "at least one tick"),
    "negative": (["run", "quick", "--set", "axes.noise_std=-0.1"], "got -0.1", "at least 0"),
    "nan": (["run", "quick", "--set", "axes.noise_std=nan"], "got nan", "finite"),
    "text": (["run", "quick", "--set", "axes.parameter_drift=lots"], "got 'lots'", "finite number"),
    "empty axis": (["run", "quick", "--set", "axes.delay=[]"], "empty list", "at least one value"),
    "metric": (["run", "quick", "--metric", "rmsd"], "'rmsd' is no metric", "'rmse'"),
    "zero seeds": (["run", "quick", "--seeds", "0"], "seeds: got 0", "greater than 0"),
    "more seeds than a disk": (["run", "quick", "--seeds", "99999999999999"], "seeds: got 99999999999999", "less than"),
    "a huge number": (["run", "quick", "--set", "axes.noise_std=1e200"], "got 1e+200", "at most 1e+12"),
    "a tiny number": (["run", "quick", "--set", "axes.noise_std=1e-200"], "got 1e-200", "expected 0 or"),
    "below one tick": (["run", "quick", "--set", "axes.sampling_period=0.0001"], "got 0.0001 s", "write 0.001."),
    "a huge seed": (
        ["simulate", "cart/nominal", "--observer", "kfbo", "--seed", "99999999999", "--out", "x.csv"],
        "got 99999999999",
        "below 2^32",
    ),
    "seeds in words": (["run", "quick", "--seeds", "many"], "--seeds", "valid integer"),
    "too late": (["run", "quick", "--set", "axes.delay=11"], "got 11 s", "at most the duration"),
    "no file": (["run", "nowhere.toml"], "nowhere.toml", "there is no such file"),
    "a folder": (["run", "."], ".: got a folder", "pcbench status"),
    "no equals sign": (["run", "quick", "--set", "axes.delay"], "--set axes.delay", "KEY=VALUE"),
    "command": (["rum", "quick"], "rum", "--help"),
    "flag": (["run", "quick", "--sedes", "3"], "--sedes", "--help"),
    "trace scenario": (
        ["simulate", "cart/nominl", "--observer", "kfbo", "--out", "x.csv"],
        "'cart/nominl'",
        "'cart/nominal'",
    ),
    "trace seed": (
        ["simulate", "cart/nominal", "--observer", "kfbo", "--seed", "-1", "--out", "x.csv"],
        "got -1",
        "0 or more",
    ),
    "design observer": (["design", "cart/nominal", "kbo"], "'kbo' is no observer", "'kfbo'"),
    "paper": (["reproduce", "card"], "'card' is no paper", "'cart'"),
    "list": (["list", "observer"], "'observer'", "'observers'"),
    "cells": (["design", "cart/nominal", "kfbo", "--set", "axes.delay=[0.1,0.2]"], "got 2 grid points", "one value"),
    "unequal channels": (["run", "quick", "--set", "axes.delay=[[0.1,0.2]]"], "got 2 values", "one or 1"),
    "both variants": (
        ["run", "quick", "--set", "options.kfbo.lag-aware=true", "--set", "options.kfbo.sampled-innovation=true"],
        "one of lag_aware",
        "not both",
    ),
}


@pytest.mark.ci
@pytest.mark.parametrize("name", BAD)
def test_a_mistake_is_one_sentence_and_writes_nothing(name, tmp_path):
    words, got, expected = BAD[name]
    sentence = assert_refusal(call(*words, cwd=tmp_path))
    assert got in sentence
    assert expected in sentence
    assert list(tmp_path.iterdir()) == []


PLANT = "[lti]\nA = [[0.0, 1.0], [0.0, -1.0]]\nC = [[1.0, 0.0]]\nsampling_period = 0.1\nnoise_std = 0.1\n"
TOML = {
    "not toml": ("name = 'x", "not valid TOML"),
    "unknown key": ("name = 'x'\nscenarios = ['cart/nominal']\nseed = 3", "did you mean 'seeds'"),
    "wrong type": ("name = 'x'\nscenarios = 'cart/nominal'", "scenarios: got 'cart/nominal', expected a valid list"),
    "missing": ("name = 'x'", "scenarios is missing; write scenarios = ..."),
    "unknown scenario": ("name = 'x'\nscenarios = ['cart/nominale']", "did you mean 'cart/nominal'"),
    "scenario twice": ("name = 'x'\nscenarios = ['cart/slow', 'cart/slow']", "twice"),
    "value twice": ("name = 'x'\nscenarios = ['cart/slow']\n[axes]\ndelay = [0.1, 0.1]", "twice"),
    "unknown observer options": ("name = 'x'\nscenarios = ['cart/slow']\n[options.kfb]\nR = 1", "did you mean 'kfbo'"),
    "unknown input": (
        "name = 'x'\nscenarios = ['cart/slow']\n[options.scenario]\ninput = 'saw'",
        "did you mean 'sawtooth'",
    ),
    "a key that explains what is missing": ("[lit]\nA = [[0.0]]", "'lit' is no key here; did you mean 'lti'"),
    "such a key in a table": (
        f"{PLANT}B = [[0.0], [2.0]]\ndellay = 0.1",
        "lti: 'dellay' is no key here; did you mean 'delay'",
    ),
    "a matrix as a list": (
        f"{PLANT}B = [0.0, 2.0]\ndelay = 0.1",
        "lti.B: got [0.0, 2.0], expected a list of rows; write [[0.0], [2.0]]",
    ),
    "a row as a list": (
        f"{PLANT}B = [[0.0], [2.0]]\ndelay = 0.1".replace("[[1.0, 0.0]]", "[1.0, 0.0]"),
        "lti.C: got [1.0, 0.0], expected a list of rows; write [[1.0, 0.0]]",
    ),
    "a name in two spellings": (
        "scenarios = ['cart/slow']\n[axes]\nnoise-std = 0.1\nnoise_std = 0.2",
        "axes: got noise-std twice, with - and with _",
    ),
}


@pytest.mark.ci
@pytest.mark.parametrize("name", TOML)
def test_a_mistake_in_a_file_names_the_file(name, tmp_path):
    text, expected = TOML[name]
    path = tmp_path / "study.toml"
    path.write_text(text)
    sentence = assert_refusal(call("run", path, "--out", tmp_path / "out"))
    assert expected in sentence
    assert str(path) in sentence
    assert not (tmp_path / "out").exists()


@pytest.mark.ci
def test_an_unwritable_folder_is_one_sentence(tmp_path):
    (tmp_path / "file").write_text("")
    sentence = assert_refusal(call("run", "quick", "--seeds", "1", "--out", tmp_path / "file" / "below"))
    assert "cannot be written" in sentence


@pytest.mark.nightly
def test_a_toml_study_with_axes_and_options_runs(tmp_path):
    path = tmp_path / "noise-map.toml"
    path.write_text(
        'name = "noise-map"\nscenarios = ["cart/gaussian"]\nobservers = ["pccebo", "kfbo"]\nseeds = 4\n'
        "[axes]\nnoise_std = [0.1, 1.0]\nplant.lam = [110.0, 122.0]\n[options.kfbo]\nR = 0.3\nlag-aware = true\n"
    )
    done = call("run", path, "--out", tmp_path / "out", "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["study"] == "noise-map"
    runs = pd.read_parquet(tmp_path / "out" / "runs")
    assert len(runs) == 4 * 2 * 4 * 2
    assert set(runs["plant.lam"]) == {110.0, 122.0}


@pytest.mark.ci
def test_run_shows_a_table_and_says_where_the_files_are(tmp_path):
    done = call("run", "quick", "--seeds", "8", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    for word in ("pccebo", "kfbo", "kf", "model-only", "position [m]", "±", "results/quick", "rms_efficiency"):
        assert word in done.stdout
    assert sorted(p.name for p in (tmp_path / "results" / "quick").iterdir()) == [
        "pairs.parquet", "provenance.json", "runs", "stats.parquet", "study.toml",
    ]  # fmt: skip


@pytest.mark.nightly
def test_quiet_says_only_where_the_result_is(tmp_path):
    done = call("run", *SMALL, "--seeds", "2", "--quiet", "--out", tmp_path / "q")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"{tmp_path / 'q'}\n", "")


HINTS = {
    "noise_std=0.1": "'noise_std' is no key of a study; write axes.noise_std.",
    "noise-std=0.1": "write axes.noise_std.",
    "lag_aware=true": "write options.kfbo.lag_aware.",
    "random_initial_state=true": "write options.scenario.random_initial_state.",
    "lam=100": "write axes.plant.lam.",
    "sedes=3": "did you mean 'seeds'?",
}


@pytest.mark.parametrize("change", HINTS)
def test_a_name_without_its_table_is_answered_with_the_table(change, tmp_path):
    assert HINTS[change] in assert_refusal(call("run", "quick", "--set", change, cwd=tmp_path))


@pytest.mark.nightly
def test_names_may_be_written_with_either_dash_and_an_axis_with_one_value(tmp_path):
    texts = (
        "noise-std = 0.1\nplant.lam = 110.0\n[options.kfbo]\nlag-aware = true",
        "noise_std = [0.1]\nplant.lam = [110.0]\n[options.kfbo]\nlag_aware = true",
    )
    for name, text in zip("ab", texts, strict=True):
        (tmp_path / f"{name}.toml").write_text(
            f"name = 'x'\nscenarios = ['cart/slow']\nobservers = ['pccebo', 'kfbo']\nseeds = 2\n[axes]\n{text}\n"
        )
        assert call("run", tmp_path / f"{name}.toml", "--quiet", "--out", tmp_path / name).returncode == 0
    assert (tmp_path / "a" / "stats.parquet").read_bytes() == (tmp_path / "b" / "stats.parquet").read_bytes()


@pytest.mark.parametrize("words", [["--version"], ["-V"]])
def test_it_says_which_release_it_is(words):
    assert call(*words).stdout == f"pcbench {version('pcbench')}\n"


def test_help_is_short_for_h_and_a_module_can_be_run():
    done = subprocess.run([*PCBENCH, "run", "-h"], capture_output=True, text=True, check=False)
    assert done.returncode == 0
    assert "Example: pcbench run quick" in done.stdout


def test_commands_stand_in_the_order_of_work_and_no_line_is_cut():
    said = call("--help").stdout
    names = [line.split()[0] for line in said.partition("Commands:")[2].splitlines() if line.strip()]
    assert names == [
        "list",
        "guide",
        "show",
        "new",
        "run",
        "report",
        "tables",
        "find-limit",
        "simulate",
        "info",
        "convert",
        "replay",
        "status",
        "verify",
        "merge",
        "compare",
        "design",
        "tune",
        "export",
        "check",
        "cite",
        "reproduce",
        "external",
    ]
    assert said.count("...") == 1, "of the usage"
    assert "--install-completion" in said


@pytest.mark.parametrize("words", [["rum"], ["run", "quick", "--sedes", "3"], ["run"], ["simulate", "cart/white"]])
def test_a_wrong_word_points_to_the_help_of_its_own_command(words):
    sentence = assert_refusal(call(*words))
    assert sentence.endswith(f"; see pcbench{' ' + words[0] if words[0] != 'rum' else ''} --help.")
    assert "?" not in sentence.removesuffix(".")
    assert words[0] != "rum" or "did you mean 'run'" in sentence


@pytest.mark.ci
def test_a_trace_is_of_the_kind_that_its_name_says(tmp_path):
    for name in ("t.csv", "t.parquet"):
        done = call("simulate", "cart/slow", "--observer", "model-only", "--out", tmp_path / name)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / "t.parquet").read_bytes()[:4] == b"PAR1"
    written = csv.read_csv(tmp_path / "t.csv").to_pandas()  # which reads every digit
    pd.testing.assert_frame_equal(written, pd.read_parquet(tmp_path / "t.parquet"), check_exact=True, check_dtype=False)
    for name, said in (("t.mat", "got the suffix '.mat'"), ("t", "got no suffix")):
        assert said in assert_refusal(
            call("simulate", "cart/slow", "--observer", "model-only", "--out", tmp_path / name)
        )


@pytest.mark.ci
def test_trace_writes_every_tick(tmp_path):
    done = call("simulate", "cart/white", "--observer", "kfbo", "--seed", "3", "--out", tmp_path / "t.parquet")
    assert done.returncode == 0, done.stderr
    frame = pd.read_parquet(tmp_path / "t.parquet")
    assert list(frame.columns) == ["t", "position", "velocity", "kfbo.position", "kfbo.velocity", "u1", "y1"]
    assert len(frame) == 10001
    assert frame["t"].iloc[-1] == pytest.approx(10.0)
    assert frame["y1"][:200].isna().all(), "nothing has arrived before tick d"
    assert frame["y1"][200:].notna().all()
    assert frame["y1"][200:400].nunique() == 1, "an arrived sample is held"
    assert abs(frame["y1"][400] - frame["position"][200]) < 5 * 0.6, "it is the noisy position of its own time"


@pytest.mark.nightly
def test_the_trace_is_the_run_of_the_tables(tmp_path):
    call("simulate", "cart/white", "--observer", "kfbo", "--seed", "3", "--out", tmp_path / "t.parquet")
    call("run", "cart/white", "--seeds", "4", "--quiet", "--out", tmp_path / "r")
    frame = pd.read_parquet(tmp_path / "t.parquet")
    mae = (frame["position"] - frame["kfbo.position"]).abs()[:-1].mean()
    runs = pd.read_parquet(tmp_path / "r" / "runs")
    row = runs[(runs.observer == "kfbo") & (runs.seed == 3) & (runs.signal == "position")].iloc[0]
    assert row.mae == pytest.approx(mae, rel=1e-12)


@pytest.mark.ci
def test_design_shows_gain_and_certificate():
    done = call("design", "cart/nominal", "pccebo", "--json")
    found = json.loads(done.stdout)
    assert found["margin"] > 0.99
    assert found["status"] == "optimal"
    assert found["numbers"]["L"][0] == [1.0]
    assert "margin" in call("design", "cart/slow", "kfbo").stdout


def test_list_names_everything():
    found = json.loads(call("list", "--json").stdout)
    assert set(found) == {"plants", "controllers", "observers", "scenarios", "studies"}
    assert len(found["scenarios"]) >= 6
    assert "kfbo" in call("list", "observers").stdout


@pytest.mark.nightly
def test_reproduce_prints_every_claim_with_a_verdict():
    done = call("reproduce", "cart", "--json")
    assert done.returncode == 0, done.stderr
    claims = json.loads(done.stdout)["claims"]
    verdicts = {c["claim"]: c["verdict"] for c in claims}
    assert [v for c, v in verdicts.items() if c.startswith(("KFBO", "PCCEBO"))] == ["reproduced"] * 16
    ordering = [v for c, v in verdicts.items() if "better in position" in c]
    assert ordering == ["reproduced"] * 10, "five experiments, MAE and RMSE"
    marked = {
        v: sum(verdict == v for verdict in verdicts.values()) for v in ("misprint", "does not hold", "not determinable")
    }
    assert marked == {"misprint": 3, "does not hold": 4, "not determinable": 5}
    assert verdicts["6.3: PCCEBO less sensitive to the parameters, MAE"] == "does not hold"


@pytest.mark.nightly
def test_ctrl_c_leaves_complete_files_only(tmp_path):
    out = tmp_path / "out"
    words = [*PCBENCH, "run", *SMALL, "--seeds", "64000", "--block-size", "256", "--out", str(out)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while not list(out.rglob("*.parquet")) and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=900)
    assert process.returncode == 130, stderr
    assert "stopped" in stderr
    assert "Traceback" not in stderr
    found = list(out.rglob("*.parquet"))
    assert found
    for path in found:
        first, last = (int(part) for part in path.stem.split("-seeds-")[1].split("-"))
        assert len(pd.read_parquet(path)) == 2 * (last + 1 - first)
    assert not (out / "stats.parquet").exists()
    assert not [p for p in out.rglob("*") if "partial" in p.name]


@pytest.mark.ci
def test_ctrl_c_where_python_cannot_raise_it_still_stops(tmp_path):
    """It lands in a finaliser, which Python ignores with a traceback: here it is one sentence, at the next occasion."""
    code = (
        "import os, signal, sys\n"
        "from pcbench import cli\nfrom pcbench.cli import catalogue\n"
        "class Last:\n    def __del__(self): os.kill(os.getpid(), signal.SIGINT); [None for _ in range(10**6)]\n"
        "names, real = catalogue.CATALOGUE['plants']\n"
        "def plant(name):\n    Last()\n    return real(name)\n"
        "catalogue.CATALOGUE['plants'] = names, plant\n"
        "sys.argv = ['pcbench', 'list', 'plants']\n"
        "cli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert done.returncode == 130
    assert done.stderr == "pcbench: stopped; every file already written is complete.\n"


@pytest.mark.ci
@pytest.mark.parametrize("raised", ["MemoryError('of 3 GiB')", "RuntimeError('RESOURCE_EXHAUSTED: Out of memory')"])
def test_where_memory_runs_out_a_command_says_so(raised):
    code = (
        "import sys\nfrom pcbench import cli\nfrom pcbench.cli import catalogue\n"
        f"def plant(name):\n    raise {raised}\n"
        "catalogue.CATALOGUE['plants'] = catalogue.CATALOGUE['plants'][0], plant\n"
        "sys.argv = ['pcbench', 'list', 'plants']\ncli.main()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=900, check=False)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert done.stderr.startswith("pcbench: memory ran out (")
