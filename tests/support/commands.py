"""Command lines, and files of Python, in processes of their own, without importing everything for each: one process imports,
then forks for each.

The fork happens before jax starts its devices, so a command starts as it would from a shell, three seconds later.
"""

import json
import os
import select
import subprocess
import sys
import tempfile
from functools import cache
from pathlib import Path

SERVER = """
import json, os, runpy, sys, traceback
from pcbench import api, cli
from pcbench.cli import catalogue, commands
from pcbench.cli.render import results
from pcbench.dataset import columns, storage
from pcbench.runtime import config
from pcbench.study import parse

for line in sys.stdin:
    words, cwd, outputs = json.loads(line)
    child = os.fork()
    if child:
        print(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), flush=True)
        continue
    os.chdir(cwd)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, path in enumerate(outputs, 1):
        os.dup2(os.open(path, os.O_WRONLY | os.O_CREAT), number)
    sys.argv, code = words, 1
    try:
        if words[0] == "pcbench":
            cli.main()
        else:
            sys.path.insert(0, cwd)
            runpy.run_path(words[0], run_name="__main__")
            code = 0
    except SystemExit as done:
        code = done.code if isinstance(done.code, int) else int(done.code is not None)
    except BaseException:
        traceback.print_exc()
    sys.stdout.flush(), sys.stderr.flush()
    os._exit(code)
"""


PATIENCE = 900  # [s] a command that takes longer hangs


@cache
def server() -> subprocess.Popen:
    return subprocess.Popen([sys.executable, "-c", SERVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def call(*words, cwd=None) -> subprocess.CompletedProcess:
    """Run `pcbench WORDS...` and return what it left, as subprocess.run would."""
    return start("pcbench", *words, cwd=cwd)


def start(*words, cwd=None) -> subprocess.CompletedProcess:
    """Run `pcbench WORDS...`, or `python WORDS...` where the first word is a file, likewise."""
    process, given = server(), [str(word) for word in words]
    with tempfile.TemporaryDirectory() as folder:
        outputs = [str(Path(folder) / name) for name in ("out", "err")]
        process.stdin.write(json.dumps([given, str(cwd or os.getcwd()), outputs]) + "\n")
        process.stdin.flush()
        if not select.select([process.stdout], [], [], PATIENCE)[0]:
            process.kill()
            raise TimeoutError(f"{' '.join(given)} took more than {PATIENCE} s")
        code = int(process.stdout.readline())
        out, err = (Path(path).read_text() for path in outputs)
    return subprocess.CompletedProcess(given, code, out, err)
