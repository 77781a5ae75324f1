"""The benchmark script runs, and refuses to time what does not compute the same numbers."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / "benchmarks" / "throughput.py"


@pytest.mark.slow
def test_throughput_agrees_with_its_baselines_and_prints_every_row():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--quick", "--json"], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    rows = json.loads(done.stdout)
    rows = rows["rows"] if isinstance(rows, dict) else rows
    for word in ("(a)", "(b)", "(c)", "pcbench"):
        assert any(word in row["what"] for row in rows)
    assert all(row["best"] > 0 for row in rows)
