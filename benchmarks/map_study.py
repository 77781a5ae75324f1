"""One study in full, in a process of its own: what it took, as a line of JSON. Works with earlier releases too."""

import json
import resource
import tempfile
import time
from typing import Any

SAID = ("planning_seconds", "computing_seconds", "compile_seconds", "writing_seconds", "closing_seconds")


def say(study: dict[str, Any]) -> None:
    """Run a study into a temporary folder and print what that took."""
    from pcbench.runtime import config

    config.setup()
    from pcbench import api

    start, cpu = time.perf_counter(), time.process_time()
    with tempfile.TemporaryDirectory() as out:
        result = api.run(study, out=out)
    took = {"seconds": time.perf_counter() - start, "cpu": time.process_time() - cpu}
    said = {what: result.provenance[what] for what in SAID if what in result.provenance}
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(json.dumps(took | said | {"runs": result.provenance["runs_added"], "peak_mib": peak}))
