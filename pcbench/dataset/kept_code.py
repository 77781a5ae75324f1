"""The code of a user's own observers, copied into the dataset that was made with it.

A file stands as code/DIGEST/FILE, with the files beside it that it imports. A result is read without any of it.
"""

from pathlib import PurePosixPath
from typing import Any

from pcbench.dataset import store
from pcbench.errors import UserError
from pcbench.study import Study, own, own_observers
from pcbench.study.own_observers import OwnObserver
from pcbench.study.read import Load


def keep(target: store.Target, study: Study) -> None:
    """Copy the files of a study's own observers into a target, where they do not stand yet."""
    for mine in study._own.values():
        for name, text in mine.code.files:
            path = f"{own.FOLDER}/{mine.code.digest}/{name}"
            if store.text(target, path) != text:
                store.put(target, path, text)


def remove(target: store.Target) -> None:
    """Remove what a target has of its users' code."""
    for name in store.names(target, own.FOLDER):
        store.remove(target, name)


def copy(target: store.Target, into: store.Target) -> None:
    """Copy what one dataset has of its users' code into another."""
    for name in store.names(target, own.FOLDER):
        if (text := store.text(target, name)) is not None:
            store.put(into, name, text)


def loader(target: store.Target, there: dict[str, Any], run: bool) -> Load:
    """Return what finds the observers of the study whose text is `there`: by their code where it is to be `run`, else without.

    Without it they have the options that the text says they had.
    """
    every = there["resolved"]["options"]

    def load(label: str, reference: str, where: str) -> OwnObserver:
        module, name = own.split(reference, where)
        if not run:
            options: dict[str, Any] = next(
                (every[s][label] for s in there["resolved"]["observers"] if label in every.get(s, {})), {}
            )
            return own_observers.absent(label, reference, options)
        if not module.startswith(f"{own.FOLDER}/"):
            return own_observers.load(reference, where)
        path = PurePosixPath(module)
        return own_observers.of(own.Code(path.name, name, _files(target, path), path.parent.name), where)

    return load


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
