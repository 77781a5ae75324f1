"""The code of what is a user's own in a study, copied into the dataset that was made with it.

A file stands as code/DIGEST/FILE, with the files beside it that it imports. A result is read without any of it.
"""

import hashlib
import re
from pathlib import PurePosixPath
from typing import Any

from pydantic.errors import PydanticUserError

from pcbench.dataset import store
from pcbench.dataset.changes import Files
from pcbench.errors import UserError, short
from pcbench.study import Study, own, own_controllers, own_entries, own_observers, own_plants
from pcbench.study.as_toml import codes
from pcbench.study.own import Own
from pcbench.study.references import SCENARIO, Gate, Named

COPY = re.compile(rf"{own.FOLDER}/[0-9a-f]{{{own.DIGITS}}}/[^/]+\.py")


def keep(target: store.Target, study: Study) -> None:
    """Copy the files of a study's own observers into a target, where they do not stand yet."""
    for mine in study._own.values():
        for name, text in mine.code.files:
            path = f"{own.FOLDER}/{mine.code.digest}/{name}"
            if store.text(target, path) != text:
                store.put(target, path, text)


def files_in(target: store.Target, there: dict[str, Any]) -> Files:
    """Return the digests of the copies of users' code that the study whose text is `there` was made with."""
    return {
        name: {
            PurePosixPath(file).name: _digest(store.text(target, file))
            for file in store.names(target, f"{own.FOLDER}/{digest}")
        }
        for name, digest in there["resolved"].get("code", {}).items()
    }


def files_of(study: Study) -> Files:
    """Return the digests of the files of users' code in a study."""
    return {name: {file: _digest(text) for file, text in code.files} for name, code in codes(study).items()}


def _digest(text: bytes | None) -> str:
    return hashlib.sha256(text or b"").hexdigest()[: own.DIGITS]


def copies(target: store.Target) -> list[str]:
    """Return the names of the copies of users' code in a target; raise UserError for another file among them."""
    names = store.names(target, own.FOLDER)
    for name in names:
        if not COPY.fullmatch(name):
            raise UserError(
                f"{target.name}: holds other files ({name}), expected only copies of users' code in {own.FOLDER}/; give "
                "another folder with --out, or move them away."
            )
    return names


def copy(target: store.Target, into: store.Target) -> None:
    """Copy what one dataset has of its users' code into another."""
    for name in copies(target):
        if (text := store.text(target, name)) is not None:
            store.put(into, name, text)


def gate(target: store.Target, there: dict[str, Any], run: bool) -> Gate:
    """Return what the study whose text is `there` may reach: no file, and code only where it is to be `run`.

    Without it observers and controllers have the options that the text says they had, and plants the facts. Scenarios are
    refused in either case: the study of a dataset has their tables.
    """

    def load(named: Named, where: str) -> Own:
        if named.kind == SCENARIO:
            raise UserError(
                f"{where}: got '{short(named.reference)}', expected a table: the study of a dataset names no scenario by "
                "MODULE:NAME; run the study again from its own file into a new folder."
            )
        module, name = own.split(named.reference, where)
        kept, path = module.startswith(f"{own.FOLDER}/"), PurePosixPath(module)
        if not run:
            digest = path.parent.name if kept else ""
            try:
                return _absent(named, own.Code(path.name if kept else module, name, (), digest), there["resolved"])
            except (LookupError, TypeError, ValueError, AttributeError, NameError, PydanticUserError):
                raise UserError(
                    f"{where}: got '{short(named.reference)}', whose facts and options are not in [resolved] as written, "
                    "expected them there; run the study again from its own file into a new folder."
                ) from None
        if not kept:
            return own_entries.load(named.kind, named.reference, where)
        return own_entries.of(named.kind, own.Code(path.name, name, _files(target, path), path.parent.name), where)

    return Gate(load, files=False)


def _absent(named: Named, code: own.Code, resolved: dict[str, Any]) -> Own:
    """What stands for a user's own whose code is left alone, by what a study's text says of it."""
    digest = code.digest or resolved.get("code", {}).get(
        named.key if named.kind == "observer" else f"{named.kind} {code.name}", ""
    )
    code = code._replace(digest=digest)
    if named.kind == "plant":
        return own_plants.absent(named.reference, code, resolved["plants"][named.reference])
    if named.kind == "controller":
        return own_controllers.absent(named.reference, code)
    every = resolved["options"]
    options: dict[str, Any] = next(
        (every[s][named.key] for s in resolved["observers"] if named.key in every.get(s, {})), {}
    )
    return own_observers.absent(named.reference, code, options)


def _files(target: store.Target, path: PurePosixPath) -> tuple[tuple[str, bytes], ...]:
    """The files of a copy, the module first; raise UserError where they are not as they were."""
    names = [PurePosixPath(name).name for name in store.names(target, str(path.parent))]
    order = [path.name, *sorted(name for name in names if name != path.name and name.endswith(".py"))]
    files = tuple((name, store.text(target, f"{path.parent}/{name}") or b"") for name in order)
    if own.digest(files) != path.parent.name:
        raise UserError(
            f"{target.name}/{path}: is gone or changed, expected the code that the runs were made with; run the study again "
            "from its own file to have it copied anew."
        )
    return files
