"""A log longer than memory is read in parts: in a process that may hold less than the log's file is long."""

import json
import os
import subprocess
import sys

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
import recorded

MEGABYTE = 1 << 20
LIMIT = 320 * MEGABYTE  # of data; half of it are pcbench's imports
LOOK = """
import json, resource, sys
import pcbench, pandas, pyarrow.parquet
resource.setrlimit(resource.RLIMIT_DATA, (int(sys.argv[2]), int(sys.argv[2])))
print(json.dumps(pcbench.log(sys.argv[1]).to_dict("records")))
"""


def looked_at(path, size):
    """What is in a log, by a process that cannot hold `size` bytes."""
    assert size > LIMIT
    words = [sys.executable, "-c", LOOK, str(path), str(LIMIT)]
    plain = os.environ | {
        "ARROW_DEFAULT_MEMORY_POOL": "system",
        "MALLOC_ARENA_MAX": "2",
    }  # others reserve a gigabyte at once
    done = subprocess.run(words, capture_output=True, text=True, timeout=300, env=plain)
    assert done.returncode == 0, done.stderr[-2000:]
    (row,) = json.loads(done.stdout)
    return row


def table(many):
    t = np.arange(many) * 0.001
    value = np.random.default_rng(1).standard_normal(many)
    channel = pa.DictionaryArray.from_arrays(np.zeros(many, np.int8), ["y1"]).cast(pa.string())
    return pa.table({"channel": channel, "sampled": t, "arrived": t + 0.0625, "value": value})


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["csv", "parquet of one group", "parquet of a million a group"])
def test_a_table_longer_than_memory_is_read(kind, tmp_path):
    many = (10 if kind == "csv" else 18) * 10**6
    path = tmp_path / f"flight.{kind.split()[0]}"
    if kind == "csv":
        pyarrow.csv.write_csv(table(many), path)
    else:
        group = many if "one group" in kind else 10**6
        pq.write_table(table(many), path, row_group_size=group, compression="none", use_dictionary=["channel"])
    row = looked_at(path, path.stat().st_size)
    assert (row["samples"], row["out_of_order"], row["doubled"]) == (many, 0, 0)
    assert row["delay_mean"] == pytest.approx(0.0625, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("write", [recorded.FORMATS[k] for k in recorded.FORMATS if k not in ("MATLAB", "flight log")],
                         ids=[k for k in recorded.FORMATS if k not in ("MATLAB", "flight log")])  # fmt: skip
def test_a_recording_longer_than_memory_is_read(write, tmp_path):
    """Samples among pictures, as cameras leave them: a name of a frame that is as long as a picture stands for one."""
    t = np.arange(4000) * 0.01
    run = recorded.Run(t, t + 0.0625, np.sin(t), t, np.cos(t))
    path = write(tmp_path, run, frame_id="x" * 50_000)
    size = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    row = looked_at(path, size)
    assert (row["samples"], row["out_of_order"]) == (4000, 0)
    assert row["delay_mean"] == pytest.approx(0.0625, abs=1e-9)
