"""How long a log of a million samples takes, from the file to the estimates of three observers, and how much memory.

    python benchmarks/replay.py            # a million samples, one a tick of 1 ms, each 5 ms late
    python benchmarks/replay.py --small    # a thousand, for the tests

A process of its own reads a log in Parquet and replays it through kf, pccebo and ukf on a linear plant of two states, programs
compiled anew. Printed are seconds and the largest memory of that process. It refuses to report where kf's last estimate is not
that of a plain recursion.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import pcbench
from pcbench.dataset import single_table
from pcbench.recordings import tables
from pcbench.recordings.log import Batch

DT, LATE = 1e-3, 5
NOISE, WALK = 0.1, 0.01
OBSERVERS = ["kf", "pccebo", "ukf"]
PLANT = {"A": [[0.0, 1.0], [-2.0, -3.0]], "B": [[0.0], [1.0]], "C": [[1.0, 0.0]]}
EXPERIMENT = {
    "sampling_period": DT,
    "delay": LATE * DT,
    "noise_std": NOISE,
    "process_std": [0.0, WALK],
    "duration": 10.0,
}


def made(folder: Path, many: int) -> None:
    """Write a log of so many samples."""
    rng, t = np.random.default_rng(0), np.arange(many) * DT
    y = np.sin(t) + NOISE * rng.normal(size=many)
    batch = Batch(np.zeros(many, int), t, t + LATE * DT, y, np.arange(1, many + 1))
    for name, table in tables.as_tables(batch, ["y1"], (t, np.sin(t)[:, None])).items():
        single_table.write_table(folder / f"{name}.parquet", table)


def plain(many: int) -> np.ndarray:
    """Return kf's last estimate by a recursion over ticks: filtered up to LATE ticks before, then the model alone."""
    from scipy.linalg import expm

    A, B, C = (np.array(PLANT[k]) for k in "ABC")
    whole = expm(np.block([[A, B], [np.zeros((1, 3))]]) * DT)
    Phi, Gamma, Q = whole[:2, :2], whole[:2, 2], np.diag([0.0, WALK**2])
    rng, t = np.random.default_rng(0), np.arange(many) * DT
    y, x, P = np.sin(t) + NOISE * rng.normal(size=many), np.zeros(2), np.eye(2)
    for k in range(many + LATE):
        if k < many:
            K = P @ C[0] / (C[0] @ P @ C[0] + NOISE**2)
            x, P = x + K * (y[k] - C[0] @ x), P - np.outer(K, C[0] @ P)
        if k < many + LATE - 1:
            x, P = Phi @ x + Gamma * np.sin(t[min(k, many - 1)]), Phi @ P @ Phi.T + Q
    return x


def one(folder: Path, many: int) -> None:
    """Replay in this process and print what it took."""
    pcbench.setup()
    began = time.perf_counter()
    study = {"name": "motor", "lti": PLANT | EXPERIMENT}
    pcbench.replay(folder / "log", study, OBSERVERS, out=folder / "out")
    took = time.perf_counter() - began
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    import pyarrow.parquet as pq

    last = pq.read_table(folder / "out" / "estimates.parquet", columns=["kf.x1", "kf.x2"]).slice(many + LATE - 1, 1)
    found = np.array([column.to_numpy()[0] for column in last.columns])
    if not np.allclose(found, want := plain(many), rtol=0, atol=1e-8):
        raise SystemExit(f"kf: got {found} at the last tick, expected {want}.")
    print(f"replay: {many:,} samples through {', '.join(OBSERVERS)}: {took:.1f} s, {peak:.2f} GiB")


def main() -> None:
    """Make a log, and replay it in a process of its own."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--small", action="store_true", help="a thousand samples")
    parser.add_argument("--replay", nargs=2, help=argparse.SUPPRESS)
    asked = parser.parse_args()
    if asked.replay:
        one(Path(asked.replay[0]), int(asked.replay[1]))
        return
    many = 1_000 if asked.small else 1_000_000
    with tempfile.TemporaryDirectory() as folder:
        made(Path(folder) / "log", many)
        subprocess.run([sys.executable, __file__, "--replay", folder, str(many)], check=True)


if __name__ == "__main__":
    main()
