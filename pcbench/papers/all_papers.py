"""All papers and the field: one process each, as many in parallel as there are cores."""

import multiprocessing
from concurrent.futures import ProcessPoolExecutor, as_completed

from pcbench.engine import runner
from pcbench.papers import PAPERS
from pcbench.papers.claim import Claim
from pcbench.runtime import config
from pcbench.runtime.progress import SILENT, Progress

LONGEST_FIRST = ("field", "arm", "helicopter", "pi-pco", "chain", "cart")  # measured; affects only the duration


def claims(progress: Progress = SILENT) -> dict[str, list[Claim]]:
    """Return the claims of every paper, in the order of PAPERS."""
    names = sorted(PAPERS, key=lambda name: LONGEST_FIRST.index(name) if name in LONGEST_FIRST else -1)
    progress.begin("papers", len(names))
    spawn = multiprocessing.get_context("spawn")  # a forked process would inherit jax's threads in an undefined state
    results = {}
    with ProcessPoolExecutor(min(len(names), runner.cores()), spawn) as pool:
        names_by_future = {pool.submit(claims_of, name): name for name in names}
        try:
            for future in as_completed(names_by_future):
                results[names_by_future[future]] = future.result()
                progress.step(1)
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return {name: results[name] for name in PAPERS}


def claims_of(paper: str) -> list[Claim]:
    """Return the claims of one paper, computed in a process of pcbench."""
    config.setup()
    return PAPERS[paper][1]()
