"""A log by its name: a folder or file of tables, or a TOML that says what of another file is which channel."""

from pathlib import Path

from pcbench.errors import UserError
from pcbench.recordings import columns, tables
from pcbench.recordings.log import Log


def opened(name: str | Path, delay: float | None = None) -> Log:
    """Return the log of a name; raise UserError where there is none, or it needs a TOML."""
    path = Path(name)
    if delay is not None and not delay >= 0:
        raise UserError(f"--delay: got {delay:g}, expected 0 s or more; write how late samples arrive.")
    if not path.exists():
        raise UserError(f"{path}: got no such file or folder, expected a log; see pcbench guide logs.")
    if path.suffix.lower() == ".toml":
        from pcbench.recordings import mapping

        return mapping.opened(path, delay)
    if path.is_dir() or path.suffix.lower() in columns.KINDS:
        return tables.opened(path, delay)
    raise UserError(
        f"{path}: got a file that may hold anything, expected a TOML that says which topics and fields are channels; see "
        "pcbench guide logs."
    )
