"""Pydantic's validation errors as pcbench sentences: the place, the value, what was expected, and how to correct it."""

import re
from collections.abc import Iterable, Mapping

from pydantic import ValidationError

from pcbench.errors import UserError, brief_repr, short, unknown

KINDS = ("float", "str")  # last part of pydantic's location for a value with several allowed types


def user_error(where: str, error: ValidationError, keys: Mapping[str, Iterable[str]]) -> UserError:
    """Return pydantic's first error as a UserError; for a value with several allowed types, the nearest.

    `keys` are the allowed keys by name of the table; "" is the whole file.
    """
    # an unknown key may cause other errors, so it comes first
    errors = sorted(error.errors(), key=lambda e: e["type"] != "extra_forbidden")
    loc, kind = errors[0]["loc"], errors[0]["type"]
    place = _place(loc)
    if kind == "extra_forbidden":
        inside = ".".join(str(part) for part in loc[:-1])
        table = ".".join(str(part) for part in loc[:-1] if not isinstance(part, int))
        place, name = f"{where}: {inside}" if inside else where, str(loc[-1])
        if table in ("lti", "scenario") and (name in keys["options.scenario"] or name in keys[""]):
            fix = "in [options.scenario]" if name in keys["options.scenario"] else "above the first table of the file"
            return UserError(f"{place}: '{name}' is no key here; write it {fix}.")
        return unknown(place, "key here", name, keys.get(table, keys[""]))
    if kind == "missing":
        return UserError(f"{where}: {place} is missing; write {loc[-1]} = ...")
    same_key = [e for e in errors if e["loc"][:1] == loc[:1] and _place(e["loc"]).startswith(place)]
    deepest = max(len(_place(e["loc"])) for e in same_key)
    nearest = [e for e in same_key if len(_place(e["loc"])) == deepest]
    expected = " or ".join(dict.fromkeys(_rephrase(e["msg"]) for e in nearest))
    place = _place(nearest[0]["loc"])
    return UserError(
        f"{where}: {place + ': ' if place else ''}got {brief_repr(nearest[0]['input'])}, expected {expected}."
    )


def _place(loc: tuple[int | str, ...]) -> str:
    """Return the place of an error as in TOML, without pydantic's names of types."""
    is_type = [str(part).rstrip("]").endswith(KINDS) or str(part).startswith("literal[") for part in loc]
    parts = [part for i, part in enumerate(loc) if not i or not is_type[i]]
    return "".join(f"[{part}]" if isinstance(part, int) else f".{short(part)}" for part in parts).removeprefix(".")


def _rephrase(message: str) -> str:
    """Return pydantic's message as an expectation."""
    text = message.removeprefix("Value error, ").removeprefix("Input should be ")
    text = re.sub(r"dictionary( or instance of \w+)?", "table", text)
    pattern = r"List should have at (least|most) (\d+) items? after validation, not \d+"
    text = re.sub(pattern, r"a list of at \1 \2", text)
    text = text.replace("String should", "a string that should").replace("List should", "a list that should")
    return (text[0].lower() + text[1:]).rstrip(".")
