"""The memory that this process may use."""

import sys
from contextlib import suppress
from pathlib import Path

from pcbench.errors import UserError

UNITS = {"B": 1, "KB": 1e3, "MB": 1e6, "GB": 1e9, "TB": 1e12, "KIB": 2**10, "MIB": 2**20, "GIB": 2**30, "TIB": 2**40}


def usable() -> int:
    """Return the bytes of memory that this process may use: the machine's, or the limit of its control group."""
    import psutil

    total = int(psutil.virtual_memory().total)
    for limit in _limits():
        with suppress(OSError, ValueError):
            total = min(total, int(limit.read_text()))
    return total


def _limits() -> list[Path]:
    """Return the files that may contain a memory limit of this process's control group or a parent group."""
    out = [Path("/sys/fs/cgroup/memory.max"), Path("/sys/fs/cgroup/memory/memory.limit_in_bytes")]
    with suppress(OSError):
        for line in Path("/proc/self/cgroup").read_text().splitlines():
            _, kinds, path = line.split(":", 2)
            if not kinds or "memory" in kinds.split(","):
                root, name = ("memory", "memory.limit_in_bytes") if kinds else ("", "memory.max")
                parts = Path(path).parts[1:]
                out += [Path("/sys/fs/cgroup", root, *parts[:i], name) for i in range(1, len(parts) + 1)]
    return out


def free() -> int:
    """Return the free bytes of memory within the limits of this process, including `ulimit -d`."""
    import psutil

    return min(int(psutil.virtual_memory().available), usable(), _left_of_data())


def _left_of_data() -> int:
    """Return the bytes by which this process's data may grow; a huge number if there is no limit."""
    import psutil

    if sys.platform != "linux":
        return sys.maxsize
    import resource

    limit, _ = resource.getrlimit(resource.RLIMIT_DATA)
    return sys.maxsize if limit == resource.RLIM_INFINITY else max(limit - int(psutil.Process().memory_info().data), 0)


def memory_budget(amount: str | int | None) -> float:
    """Return the bytes that results may use: `amount`, by default a quarter of the memory, at most the free memory."""
    if amount is None:
        return min(usable() / 4, free())
    text = str(amount).strip().upper()
    number = text.rstrip("BKMGTI").strip()
    unit = text[len(number) :].strip() or "B"
    try:
        size = float(number) * UNITS[unit if unit.endswith("B") else unit + "B"]
    except (KeyError, ValueError):
        size = -1.0
    if not 0 < size < 1e18:
        raise UserError(f"--memory: got {amount!r}, expected an amount such as 500MB or 2GiB; write that.")
    return size
