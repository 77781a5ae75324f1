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
print(json.dumps(pcbench.info(sys.argv[1]).to_dict("records")))
"""


REPLAY_LIMIT = 740 * MEGABYTE  # half of it are imports and compiled programs
REPLAY = """
import json, resource, sys
import pcbench, pandas, pyarrow.parquet
pcbench.setup()
resource.setrlimit(resource.RLIMIT_DATA, (int(sys.argv[2]), int(sys.argv[2])))
experiment = dict(sampling_period=1e-3, delay=5e-3, noise_std=1.0, process_std=[0.0, 0.01], duration=10.0)
plant = dict(name="motor", lti=dict(A=[[0.0, 1.0], [-2.0, -3.0]], B=[[0.0], [1.0]], C=[[1.0, 0.0]], **experiment))
print(json.dumps([pcbench.replay(sys.argv[1], plant, "kf", out=sys.argv[3]).summary]))
"""


def survey_row(path, size):
    """What is in a log, by a process that cannot hold `size` bytes."""
    return by_a_small_process(LOOK, path, size, LIMIT)


def by_a_small_process(code, path, size, limit, *more):
    """What a process prints that may hold `limit` bytes, of a log that is `size` long."""
    assert size > limit
    words = [sys.executable, "-c", code, str(path), str(limit), *map(str, more)]
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


@pytest.mark.nightly
@pytest.mark.parametrize("kind", ["csv", "parquet of one group", "parquet of a million a group"])
def test_a_table_longer_than_memory_is_read(kind, tmp_path):
    many = (10 if kind == "csv" else 18) * 10**6
    path = tmp_path / f"flight.{kind.split()[0]}"
    if kind == "csv":
        pyarrow.csv.write_csv(table(many), path)
    else:
        group = many if "one group" in kind else 10**6
        pq.write_table(table(many), path, row_group_size=group, compression="none", use_dictionary=["channel"])
    row = survey_row(path, path.stat().st_size)
    assert (row["samples"], row["out_of_order"], row["doubled"]) == (many, 0, 0)
    assert row["delay_mean"] == pytest.approx(0.0625, abs=1e-9)


@pytest.mark.nightly
def test_a_table_longer_than_memory_is_replayed(tmp_path):
    """Lines with a remark each, as loggers leave them; for a smoother, which holds the whole log, memory does not suffice."""
    many, path = 3_500_000, tmp_path / "flight.csv"
    whole = table(many)
    remark = pa.DictionaryArray.from_arrays(np.zeros(many, np.int8), ["nothing to report. " * 10]).cast(
        pa.large_string()
    )
    pyarrow.csv.write_csv(whole.append_column("remark", remark), path)
    summary = by_a_small_process(REPLAY, path, path.stat().st_size, REPLAY_LIMIT, tmp_path / "out")
    assert summary["innovations"][0]["samples"] == many
    assert "and memory for all ticks." in " ".join(summary["notes"])
    assert summary["innovations"][0]["nis"] == pytest.approx(1.0, abs=0.01)
    assert pq.ParquetFile(tmp_path / "out" / "estimates.parquet").metadata.num_rows == summary["ticks"] + 1


@pytest.mark.nightly
@pytest.mark.parametrize("write", [recorded.FORMATS[k] for k in recorded.FORMATS if k not in ("MATLAB", "flight log")],
                         ids=[k for k in recorded.FORMATS if k not in ("MATLAB", "flight log")])  # fmt: skip
def test_a_recording_longer_than_memory_is_read(write, tmp_path):
    """Samples among pictures, as cameras leave them: a name of a frame that is as long as a picture stands for one."""
    t = np.arange(4000) * 0.01
    run = recorded.Run(t, t + 0.0625, np.sin(t), t, np.cos(t))
    path = write(tmp_path, run, frame_id="x" * 50_000)
    size = sum(p.stat().st_size for p in tmp_path.rglob("*") if p.is_file())
    row = survey_row(path, size)
    assert (row["samples"], row["out_of_order"]) == (4000, 0)
    assert row["delay_mean"] == pytest.approx(0.0625, abs=1e-9)
