"""`pcbench external run`: an object in Python that estimates, run on a study's draws in a process of its own, and scored."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

from pcbench.dataset.result import Result
from pcbench.dataset.run_study import Say
from pcbench.errors import UserError
from pcbench.external import score
from pcbench.runtime.progress import SILENT, Progress


def run(folder: str | Path, reference: str, name: str, progress: Progress = SILENT, say: Say | None = None) -> Result:
    """Run a guest MODULE:NAME on the draws of a folder, and add it to the study's tables; raise UserError for its mistakes.

    It has a process of its own: what it imports, and what it does to it, is not pcbench's.
    """
    if not (Path(folder) / "draws" / "cells.json").is_file():
        raise UserError(
            f"{folder}: holds no draws, expected a folder that pcbench external prepare wrote; name that one."
        )
    with tempfile.TemporaryDirectory(prefix="pcbench-guest-") as place:
        out = f"{place}/estimates.parquet"
        progress.note("a guest estimates, one run at a time")
        words = [sys.executable, "-m", "pcbench.external.entry", str(folder), reference, out]
        done = subprocess.run(words, capture_output=True, text=True, env=dict(os.environ))
        if done.returncode:
            last = (done.stderr.strip().splitlines() or ["it ended without a word"])[-1]
            raise UserError(
                last if done.returncode == 2 else f"guest {reference}: ended with {last}, expected estimates; mend it."
            )
        return score.score(folder, out, name, progress, say)
