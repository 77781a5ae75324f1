"""How long a tuning takes: every cart observer with free parameters, 256 training runs, the default budget, from a cold start.

    python benchmarks/tuning.py [--scenario cart/gaussian] [--exact] [--small]

Each tuning is a process of its own with an empty cache, so compiling, designing and judging on 1024 other runs are in its time.
A tuning that hands out worse than its start, on the runs it was tuned on, ends the program with exit code 1.
With --exact every tuning is done both ways, on runs and on expected values, for steady_pooled_rmse.
With --small every tuning is a search of three points over eight runs, all in this process: its figures mean nothing then.
Printed: seconds, points asked for, and the objective at the start and as tuned, on the training runs or as expected (of
steady_pooled_rmse the mean square).
"""

import argparse
import contextlib
import io
import json
import os
import subprocess
import sys
import tempfile
from time import perf_counter
from typing import Any

from rich.console import Console
from rich.table import Table

OBSERVERS = {
    "cart/gaussian": ["pccebo", "kfbo", "kf"],
    "cart/white": ["pccebo", "kfbo", "kf"],
    "cart/variable": ["pco", "pi-pco", "pccebo", "kf"],
}
FEW = {"cart/white": ["kfbo"], "cart/variable": ["pco"]}  # one by its gain, one by options
ROUNDING = 1e-6  # an option that is tuned on a logarithm comes back rounded
FEW_RUNS = 8
SMALL = ["--budget", "3", "--training-seeds", "0:8", "--validation-seeds", "1000:1008", "--optimizer", "search"]


def tuned(words: list[str]) -> dict[str, Any]:
    """Return what a tuning says, in a process of its own from a cold start."""
    with tempfile.TemporaryDirectory() as cache:
        environment = {**os.environ, "PCBENCH_CACHE": cache}
        command = [sys.executable, "-m", "pcbench", *words]
        return dict(json.loads(subprocess.run(command, capture_output=True, check=True, env=environment).stdout))


def tuned_here(words: list[str]) -> dict[str, Any]:
    """Return what the same command says in this process."""
    from pcbench.cli.commands import app
    from pcbench.engine import runner

    runner.WIDTH = FEW_RUNS
    with contextlib.redirect_stdout(io.StringIO()) as said:
        app([*words, *(SMALL[:2] if "--exact-objective" in words else SMALL)], standalone_mode=False)
    return dict(json.loads(said.getvalue()))


def main() -> None:
    """Print a row for each tuning."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenario", choices=OBSERVERS, help="one of them; default all")
    parser.add_argument("--exact", action="store_true", help="both ways: on runs, and on expected values")
    parser.add_argument("--small", action="store_true", help="three points, eight runs, two tunings; every check")
    options = parser.parse_args()
    tune, runs, points = (tuned_here, FEW_RUNS, 3) if options.small else (tuned, 256, 60)
    aim = "steady_pooled_rmse" if options.exact else "steady_rmse"
    table = Table(title=f"tuning for {aim}, {runs} training runs, {points} points at most")
    for head in ("scenario", "observer", "on", "seconds", "points", "start", "tuned"):
        table.add_column(head, justify="left" if head in ("scenario", "observer", "on") else "right")
    sets = FEW if options.small else OBSERVERS
    for scenario in [options.scenario] if options.scenario else sets:
        for observer in sets.get(scenario, OBSERVERS[scenario][:1]):
            for way in [[], ["--exact-objective"]] if options.exact else [[]]:
                start = perf_counter()
                said = tune(["tune", scenario, observer, "--objective", aim, "--json", *way])
                seconds, first = perf_counter() - start, said["judged"][0]
                if not first["tuned"] <= first["start"] * (1 + ROUNDING):
                    raise SystemExit(f"tuning: {scenario} {observer}: {first}, expected no worse than its start.")
                row = f"{seconds:.1f}", str(said["points"]), f"{first['start']:.5g}", f"{first['tuned']:.5g}"
                table.add_row(scenario, observer, "runs" if first["what"] == "training" else "moments", *row)
    Console().print(table)


if __name__ == "__main__":
    main()
