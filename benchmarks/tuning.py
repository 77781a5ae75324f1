"""How long a tuning takes: every cart observer with free parameters, 256 training runs, the default budget, from a cold start.

    python benchmarks/tuning.py [--scenario cart/gaussian]

Each tuning is a process of its own with an empty cache, so compiling, designing and judging on 1024 other runs are in its time.
Printed: seconds, points asked for, and the objective on the training runs at the start and as tuned.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from time import perf_counter

from rich.console import Console
from rich.table import Table

OBSERVERS = {
    "cart/gaussian": ["pccebo", "kfbo", "dkf"],
    "cart/white": ["pccebo", "kfbo", "dkf"],
    "cart/variable": ["pco", "pi-pco", "pccebo", "dkf"],
}


def tuned(scenario: str, observer: str) -> tuple[float, dict[str, object]]:
    """Return the seconds of one tuning, and what it says."""
    words = ["tune", scenario, observer, "--objective", "tail_rmse", "--json"]
    with tempfile.TemporaryDirectory() as cache:
        start = perf_counter()
        done = subprocess.run(
            [sys.executable, "-m", "pcbench.cli", *words],
            capture_output=True,
            text=True,
            check=True,
            env={**os.environ, "PCBENCH_CACHE": cache},
        )
        return perf_counter() - start, json.loads(done.stdout)


def main() -> None:
    """Print a row for each tuning."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", choices=OBSERVERS, help="one of them; default all")
    asked = parser.parse_args().scenario
    table = Table(title="tuning for tail RMSE, 256 training runs, 60 points at most")
    for head in ("scenario", "observer", "seconds", "points", "start", "tuned"):
        table.add_column(head, justify="left" if head in ("scenario", "observer") else "right")
    for scenario in [asked] if asked else OBSERVERS:
        for observer in OBSERVERS[scenario]:
            seconds, said = tuned(scenario, observer)
            (training, _) = said["judged"]  # type: ignore[misc]
            row = f"{seconds:.1f}", str(said["points"]), f"{training['start']:.4g}", f"{training['tuned']:.4g}"
            table.add_row(scenario, observer, *row)
    Console().print(table)


if __name__ == "__main__":
    main()
