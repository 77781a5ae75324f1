"""An observer's design, asked for in one place: what a user's code raises or returns instead is one sentence with its line."""

import inspect
import os
from typing import Any

from pcbench.errors import UserError, is_ours, line_of, raised
from pcbench.observers import ObserverSpec
from pcbench.synthesis.certificate import Certificate, Design, DesignContext

EXPECTED = "expected Design(gains, Certificate)"


def designed(label: str, entry: ObserverSpec, known: DesignContext, options: Any) -> Design:
    """Return an observer's gains with their certificate; raise UserError where its design refuses, or is not as it must be."""
    try:
        found = entry.design(known, options)
    except UserError:
        raise
    except Exception as error:
        if is_ours(entry.design):
            raise
        place = "" if line_of(error) else _place(entry.design)
        raise UserError(f"observer {label}: design got {raised(error)}{place}, {EXPECTED}; mend that line.") from error
    if not isinstance(found, Design) or not isinstance(found.certificate, Certificate):
        raise UserError(
            f"observer {label}: design returned {type(found).__name__}{_place(entry.design)}, {EXPECTED}; mend it."
        )
    return found


def _place(function: Any) -> str:
    """Where a function is defined, as `, file line n`; empty where that is not known."""
    code = getattr(inspect.unwrap(function), "__code__", None)
    return f", {os.path.basename(code.co_filename)} line {code.co_firstlineno}" if code else ""
