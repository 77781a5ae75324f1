"""The user's code of a study, copied into its dataset.

A file is stored as code/DIGEST/FILE, with the files in its folder that it imports. Reading a result needs none of it.
"""

import hashlib
import re
from pathlib import PurePosixPath

from pydantic.errors import PydanticUserError

from pcbench.dataset import storage
from pcbench.dataset.study_diff import Files
from pcbench.errors import UserError, short
from pcbench.study import Study
from pcbench.study.plugins import registry, user_code, user_controllers, user_observers, user_plants
from pcbench.study.plugins.references import SCENARIO, Gate, PluginReference
from pcbench.study.plugins.user_code import UserPlugin
from pcbench.study.serialize import codes
from pcbench.toml_text import TomlTable

COPY = re.compile(rf"{user_code.FOLDER}/[0-9a-f]{{{user_code.DIGITS}}}/[^/]+\.py")


def store_code(target: storage.Target, study: Study) -> None:
    """Copy the files of user-defined observers into a target, unless they are there."""
    for plugin in study._plugins.values():
        for name, text in plugin.code.files:
            path = f"{user_code.FOLDER}/{plugin.code.digest}/{name}"
            if storage.read_bytes(target, path) != text:
                storage.write_file(target, path, text)


def files_in(target: storage.Target, table: TomlTable) -> Files:
    """Return the digests of the copies of users' code of the study in `table`."""
    folders = {name: f"{user_code.FOLDER}/{digest}" for name, digest in table["resolved"].get("code", {}).items()}
    return {
        name: {
            PurePosixPath(file).name: _digest(storage.read_bytes(target, file))
            for file in storage.file_names(target, folder)
        }
        for name, folder in folders.items()
    }


def files_of(study: Study) -> Files:
    """Return the digests of the files of users' code in a study."""
    return {name: {file: _digest(text) for file, text in code.files} for name, code in codes(study).items()}


def _digest(text: bytes | None) -> str:
    return hashlib.sha256(text or b"").hexdigest()[: user_code.DIGITS]


def copies(target: storage.Target) -> list[str]:
    """Return the names of the copies of users' code in a target; raise UserError for any other file among them."""
    names = storage.file_names(target, user_code.FOLDER)
    for name in names:
        if not COPY.fullmatch(name):
            raise UserError(
                f"{target.name}: contains other files ({name}), expected only copies of users' code in {user_code.FOLDER}/; "
                "give another folder with --out, or move them away."
            )
    return names


def copy(target: storage.Target, into: storage.Target) -> None:
    """Copy the users' code of one dataset into another."""
    for name in copies(target):
        if (text := storage.read_bytes(target, name)) is not None:
            storage.write_file(into, name, text)


def gate(target: storage.Target, table: TomlTable, run: bool) -> Gate:
    """Return what the study in `table` may access: no files, and code only if it will be `run`.

    Without its code, an observer or controller has the options in [resolved], and a plant the facts in [resolved].
    Scenarios by MODULE:NAME are always refused, because the study of a dataset contains their tables.
    """

    def load(reference: PluginReference, where: str) -> UserPlugin:
        if reference.kind == SCENARIO:
            raise UserError(
                f"{where}: got '{short(reference.reference)}', expected a table: the study of a dataset names no scenario by "
                "MODULE:NAME; run the study again from its own file into a new folder."
            )
        module, name = user_code.split(reference.reference, where)
        is_copy, path = module.startswith(f"{user_code.FOLDER}/"), PurePosixPath(module)
        if run and is_copy:
            code = user_code.Code(path.name, name, _files(target, path), path.parent.name)
            return registry.plugin_of(reference.kind, code, where)
        if run:
            return registry.load(reference.kind, reference.reference, where)
        code = user_code.Code(path.name if is_copy else module, name, (), path.parent.name if is_copy else "")
        try:
            return _absent(reference, code, table["resolved"])
        except (LookupError, TypeError, ValueError, AttributeError, NameError, PydanticUserError):
            raise UserError(
                f"{where}: got '{short(reference.reference)}', whose facts and options are not in [resolved] as written, "
                "expected them there; run the study again from its own file into a new folder."
            ) from None

    return Gate(load, files=False)


def _absent(reference: PluginReference, code: user_code.Code, resolved: TomlTable) -> UserPlugin:
    """A substitute for user-defined code that is not loaded, from the study's text."""
    key = reference.key if reference.kind == "observer" else f"{reference.kind} {code.name}"
    code = code._replace(digest=code.digest or resolved.get("code", {}).get(key, ""))
    if reference.kind == "plant":
        return user_plants.absent(reference.reference, code, resolved["plants"][reference.reference])
    if reference.kind == "controller":
        return user_controllers.absent(reference.reference, code)
    option_tables = [resolved["options"].get(scenario, {}) for scenario in resolved["observers"]]
    options: TomlTable = next((t[reference.key] for t in option_tables if reference.key in t), {})
    return user_observers.absent(reference.reference, code, options)


def _files(target: storage.Target, path: PurePosixPath) -> tuple[tuple[str, bytes], ...]:
    """The files of a copy, the module first; raise UserError if they have changed."""
    names = {PurePosixPath(name).name for name in storage.file_names(target, str(path.parent))} - {path.name}
    order = [path.name, *sorted(name for name in names if name.endswith(".py"))]
    files = tuple((name, storage.read_bytes(target, f"{path.parent}/{name}") or b"") for name in order)
    if user_code.digest(files) != path.parent.name:
        raise UserError(
            f"{target.name}/{path}: is missing or changed, expected the code that the runs were made with; run the study again "
            "from its own file to copy it again."
        )
    return files
