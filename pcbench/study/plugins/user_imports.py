"""Imports of a user's file while it runs: files beside it and in its folder are found, and the host program's modules stay."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any


@contextmanager
def beside(texts: dict[str, bytes], copy: Path, digest: str, folder: Path | None) -> Iterator[None]:
    """Have the files beside a module found while it runs, and modules of their names that the host program has left to it.

    `texts` are those files by name, `copy` is where they are, `digest` that of all.
    `sys.path` is not touched. What is neither beside the module nor found elsewhere is looked for in its folder.
    """
    hosts = {stem: sys.modules.pop(stem) for stem in texts if stem in sys.modules}
    first, last = Siblings(texts, copy, digest), InFolder(folder)
    sys.meta_path[:] = [first, *sys.meta_path, last]
    try:
        yield
    finally:
        sys.meta_path[:] = [each for each in sys.meta_path if each is not first and each is not last]
        sys.modules.update({stem: each for stem, each in hosts.items() if each.__name__ == stem})  # others are of ours


class Siblings(MetaPathFinder, Loader):
    """Finds and runs the files beside a module, each as NAME_DIGEST, so that its types are found when they are unpickled."""

    def __init__(self, texts: dict[str, bytes], folder: Path, digest: str) -> None:
        self.texts, self.folder, self.digest = texts, folder, digest

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Return how a file beside the module is run; None for another name."""
        if fullname not in self.texts:
            return None
        return ModuleSpec(fullname, self, origin=str(self.folder / f"{fullname}.py"))

    def exec_module(self, module: ModuleType) -> None:
        """Run a file."""
        stem, path = module.__name__, str(self.folder / f"{module.__name__}.py")
        module.__name__, module.__file__ = f"{stem}_{self.digest}", path
        sys.modules[module.__name__] = module
        exec(compile(self.texts[stem], path, "exec"), module.__dict__)


class InFolder(MetaPathFinder):
    """Finds what no other finder has found in a folder, if there is one."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def find_spec(self, fullname: str, path: Any, target: Any = None) -> ModuleSpec | None:
        """Return what is in the folder under a name; None where nothing is."""
        return PathFinder.find_spec(fullname, [str(self.folder)]) if self.folder and path is None else None
