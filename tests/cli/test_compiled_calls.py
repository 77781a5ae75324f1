"""Calls of compiled code that take hours: announced, written observer by observer, ended by Ctrl-C."""

import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pandas as pd
import pytest

from pcbench.dataset import verify

PCBENCH = [sys.executable, "-m", "pcbench"]
SOURCE = Path(__file__).parents[1] / "support" / "own_observer.py"
STEPS = 50_000  # of a loop in each tick: a call takes minutes
FLOW = "gains.Phi @ memory + gains.Gamma @ now.u"
LOOP = f"jax.lax.fori_loop(0, {STEPS}, lambda i, x: x - 1e-9 * jnp.sin(x), {FLOW})"
LAST = "pcbench: stopped; every file already written is complete."


@pytest.fixture
def here(tmp_path):
    """A folder with an observer in long.py whose ticks take long."""
    text = SOURCE.read_text().replace(FLOW, LOOP).replace("import jax.numpy", "import jax\nimport jax.numpy")
    assert text.count(LOOP) == 1
    (tmp_path / "long.py").write_text(text)
    return tmp_path


def send_signal(words, here, ready, number=signal.SIGINT):
    """Send a signal once `ready` (what it has written to standard error); return that, and the seconds until the end."""
    with (here / "stderr").open("w") as errors:
        process = subprocess.Popen([*PCBENCH, *words], cwd=here, stdout=subprocess.DEVNULL, stderr=errors)
    try:
        limit = time.monotonic() + 240
        while not ready((here / "stderr").read_text()):
            assert process.poll() is None, (here / "stderr").read_text()
            assert time.monotonic() < limit, (here / "stderr").read_text()
            time.sleep(0.05)
        process.send_signal(number)
        start = time.monotonic()
        process.wait(60)
        took = time.monotonic() - start
    finally:
        process.kill()
    assert process.returncode == 128 + number
    return (here / "stderr").read_text(), took


def blocks(here):
    return list((here / "out").rglob("cell-*.parquet"))


def hidden(here):
    return list((here / "out").rglob(".*"))


@pytest.mark.slow
def test_ctrl_c_ends_a_long_call_after_other_observers_are_written(here):
    words = ["run", "cart/white", "--observers", "long.py:nudge,kf", "--seeds", "8", "--out", "out"]
    said, took = send_signal(words, here, lambda said: blocks(here) and "takes about" in said)
    announced, last = said.splitlines()
    found = re.fullmatch(
        r"pcbench: cart/white: a call of nudge, of up to 64 runs, takes about \d+(\.\d)? (min|h) or more; calls to do: 1\. .*",
        announced,
    )
    assert found, announced
    assert last == LAST
    assert took < 4, "one second of grace, on a machine under load"
    (block,) = blocks(here)
    assert len(pd.read_parquet(block)) == 8 * 2
    assert "observer=kf" in str(block)
    assert not hidden(here)
    shares = {share.observer: share.seeds for share in verify.status(here / "out").shares}
    assert shares == {"kf": 8, "nudge": 0}


@pytest.mark.slow
def test_sigterm_ends_a_compiled_call_of_the_main_thread(here):
    words = ["simulate", "cart/white", "--observer", "long.py:nudge", "--out", "trace.csv"]
    (here / "long.py").write_text((here / "long.py").read_text().replace(str(STEPS), "10**9") + MARK)
    said, took = send_signal(words, here, lambda said: (here / "begun").exists(), signal.SIGTERM)
    assert said == LAST + "\n"
    assert took < 4
    assert not (here / "trace.csv").exists()


def test_ctrl_c_ends_a_call_that_python_cannot_interrupt(tmp_path):
    """Without jax: a digest of 1e9 rounds takes minutes, and another thread writes a file in the meantime."""
    code = (
        "import hashlib, os, signal, sys, threading, time\n"
        "from pathlib import Path\nfrom pcbench import cli\nfrom pcbench.cli import catalogue\n"
        "from pcbench.runtime import ending\n"
        "def write():\n    with ending.uncut():\n        time.sleep(2.5); Path('file').write_text('complete')\n"
        "    with ending.uncut():\n        Path('later').write_text('begun after that')\n"
        "def plant(name):\n"
        "    with ending.temporary_folder() as folder:\n"
        "        Path('folder').write_text(folder)\n"
        "        threading.Thread(target=write).start()\n"
        "        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()\n"
        "        hashlib.pbkdf2_hmac('sha256', b'', b'', 10**9)\n"
        "names, real = catalogue.CATALOGUE['plants']\n"
        "catalogue.CATALOGUE['plants'] = names, plant\n"
        "sys.argv = ['pcbench', 'list', 'plants']\ncli.main()\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False
    )
    assert (done.returncode, done.stderr) == (130, LAST + "\n")
    assert (tmp_path / "file").read_text() == "complete"
    assert not (tmp_path / "later").exists()
    assert not Path((tmp_path / "folder").read_text()).exists()


MARK = """
import jax
from pathlib import Path
before = nudge.flow
def marked(gains, memory, now):
    jax.debug.callback(lambda: Path("begun").write_text(""))
    return before(gains, memory, now)
nudge = nudge._replace(flow=marked)
"""
