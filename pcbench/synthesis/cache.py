"""Remember what a solver found, so that the second run of a study need not import it.

Only raw answers are kept, under the hash of the problem's bits and the solver's version; every certificate is re-checked
on what comes back, so a damaged or foreign entry can cost time but cannot enter a table. PCBENCH_CACHE names the folder.
"""

import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from platformdirs import user_cache_path


def folder() -> Path:
    """Return the folder of everything pcbench can make again."""
    return Path(os.environ.get("PCBENCH_CACHE") or user_cache_path("pcbench"))


def remembered(kind: Any, name: str, problem: tuple[np.ndarray, ...], solve: Callable[[], Any]) -> Any:
    """Return `kind` (a NamedTuple of arrays, numbers and strings) from the cache, or solve and remember it."""
    bits = b"".join(np.ascontiguousarray(a, float).tobytes() + str(np.shape(a)).encode() for a in problem)
    key = hashlib.sha256(bits + f"{name} {version('cvxpy')} {version('clarabel')}".encode()).hexdigest()[:32]
    path = folder() / "gains" / f"{name}-{key}.json"
    try:
        stored = json.loads(path.read_text())
        return kind(**{k: np.array(v) if isinstance(v, list) else v for k, v in stored.items()})
    except (OSError, ValueError, TypeError, AttributeError):
        found = solve()
        _store(path, found)
        return found


def _store(path: Path, found: Any) -> None:
    text = json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found._asdict().items()})
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False) as beside:
            beside.write(text)
        os.replace(beside.name, path)
    except OSError:
        return  # a cache that cannot be written only costs time
