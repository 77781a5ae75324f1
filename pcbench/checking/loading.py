"""The observer to be checked: one of a user's own, named by MODULE:OBSERVER, with its options.

OBSERVER is an attribute of the module: an `Entry`, or an `Observer` whose module has its `design` and, where it takes any, its
`Options`.
"""

from typing import Any, NamedTuple

from pydantic import ValidationError

from pcbench.errors import UserError, raised, short, unknown
from pcbench.observers import ObserverSpec
from pcbench.study.plugins import registry

WHERE = "check"


class Candidate(NamedTuple):
    """An observer with the name it goes by and its options."""

    label: str
    entry: ObserverSpec
    options: Any


def load(target: str, given: dict[str, Any] | None = None) -> Candidate:
    """Return the observer that MODULE:OBSERVER names, with the options `given`; raise UserError where there is none."""
    entry = registry.load("observer", target, WHERE).entry
    return Candidate(target.rpartition(":")[2], entry, _options(entry, given or {}, f"{WHERE} {short(target)}"))


def _options(entry: ObserverSpec, given: dict[str, Any], where: str) -> Any:
    named = {key.replace("-", "_"): value for key, value in given.items()}
    fields = getattr(entry.options, "model_fields", {})
    for key in named:
        if key not in fields:
            raise unknown(where, "option", key, fields)
    try:
        return entry.options(**named)
    except ValidationError as error:
        first = error.errors()[0]
        raise UserError(
            f"{where}: option {'.'.join(map(str, first['loc'])) or 'of Options'}: {first['msg']}; give it with "
            "--set OPTION=VALUE, or write a default."
        ) from None
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        raise UserError(f"{where}: its options cannot be made: {raised(error)}; mend that.") from None
