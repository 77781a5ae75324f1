"""Remember what a solver found, so that the second run of a study need not import it.

Only raw answers are kept, under the hash of the problem's bits, of the text that states it and of the solvers' versions;
every certificate is re-checked on what is read back, so a damaged or foreign entry can cost time but cannot enter a table.
"""

import hashlib
import inspect
import json
import sys
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from pcbench.runtime.cache import folder, keep
from pcbench.synthesis import solvers


def remembered(kind: Any, name: str, problem: tuple[np.ndarray, ...], solve: Callable[[], Any]) -> Any:
    """Return `kind` (a NamedTuple of arrays, numbers and strings) from the cache, or solve and remember it."""
    bits = b"".join(np.ascontiguousarray(a, float).tobytes() + str(np.shape(a)).encode() for a in problem)
    said = f"{name} {_solvers()}".encode()
    key = hashlib.sha256(bits + said + _source(kind.__module__) + _source(solvers.__name__)).hexdigest()[:32]
    path = folder("gains") / f"{name}-{key}.json"
    try:
        stored = json.loads(path.read_text())
        return kind(**{k: np.array(v) if isinstance(v, list) else v for k, v in stored.items()})
    except (OSError, ValueError, TypeError, AttributeError):
        found = solve()
        keep(path, _said(found))
        return found


@cache
def _solvers() -> str:
    """The versions of the solvers: looked up once, as each takes milliseconds."""
    return f"{version('cvxpy')} {version('clarabel')} {version('scs')}"


@cache
def _source(module: str) -> bytes:
    """The text of the module that states a problem: another statement may have another answer."""
    found = inspect.getsourcefile(sys.modules[module])
    return Path(found).read_bytes() if found else b""


def _said(found: Any) -> str:
    return json.dumps({k: v.tolist() if isinstance(v, np.ndarray) else v for k, v in found._asdict().items()})
