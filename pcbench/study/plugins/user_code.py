"""A user's own code, found by MODULE:NAME and known by its content.

MODULE is the path of a .py file, or a name that can be imported, from the working folder too. A file is run once for each
content: two versions of it stand side by side in one process, and what it makes can be sent to another process with the file
and the modules beside it that it imports (`Code`). Of an installed module only the digest is kept. What the user's code raises
comes back as one sentence.
"""

import ast
import difflib
import hashlib
import importlib
import pkgutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from pcbench.errors import UserError, raised, short
from pcbench.study.plugins import user_imports

DIGITS = 12  # of a digest, in names
FOLDER = "code"  # of a dataset, with a folder for each digest in it


class Code(NamedTuple):
    """What makes an object of a user's own anew: the files it is of, by name, the module first; none of an installed module."""

    module: str  # a file's name, or a module's
    name: str  # of the object in it
    files: tuple[tuple[str, bytes], ...]
    digest: str  # of all files

    @property
    def reference(self) -> str:
        """Return MODULE:NAME as a dataset says it, which holds the files."""
        return (
            f"{FOLDER}/{self.digest}/{self.module}:{self.name}"
            if is_file(self.module)
            else f"{self.module}:{self.name}"
        )


class Own(NamedTuple):
    """What is a user's own, as an entry beside pcbench's, and the code that makes it."""

    entry: Any
    code: Code


def is_reference(text: str) -> bool:
    """Say whether a name is MODULE:NAME."""
    return ":" in text


def is_file(module: str) -> bool:
    """Say whether a MODULE is the path of a file."""
    return module.endswith(".py") or "/" in module


def split(text: str, where: str) -> tuple[str, str]:
    """Return MODULE and NAME; raise UserError where there are not both."""
    module, colon, name = text.rpartition(":")
    if not colon or not module or not name:
        raise UserError(
            f"{where}: got '{short(text)}', expected MODULE:NAME such as mine.py:nudge; name the module, or its file, "
            "and what it is called in it."
        )
    return module, name


def code_of(text: str, where: str, folder: Path | None = None) -> Code:
    """Return the code that MODULE:NAME names, a path taken from a `folder` (default: the working folder); nothing is run.

    Raises UserError where there is no such file.
    """
    module, name = split(text, where)
    if not is_file(module):
        return Code(module, name, (), "")
    path = (folder or Path()) / module
    if not path.is_file():
        near = difflib.get_close_matches(path.name, _files(path.parent), n=1, cutoff=0.4)
        hint = f"did you mean '{Path(module).parent / near[0]}'? " if near else ""
        raise UserError(
            f"{where}: '{short(module)}' is no file; {hint}give the path of a .py file, or a module's name."
        )
    files = tuple(_with_siblings(path))
    return Code(path.name, name, files, digest(files))


def digest(files: tuple[tuple[str, bytes], ...]) -> str:
    """Return what tells the content of a module and the files beside it from any other, whatever their order."""
    module, *beside = files
    parts = [module, *sorted(beside)]
    return hashlib.sha256(b"".join(name.encode() + b"\0" + text + b"\0" for name, text in parts)).hexdigest()[:DIGITS]


def module_of(code: Code, where: str, folder: Path | None = None) -> ModuleType:
    """Return the module, run once in a process for each content; raise UserError for what it raises.

    Files are run where they stand, in `folder`, or else from a copy: so errors name their lines.
    """
    if not code.files:
        return _run(lambda: _imported(code.module), code.module, where)
    return _run(lambda: _executed(code, folder), code.module, where)


def digest_of(code: Code, module: ModuleType) -> str:
    """Return the digest of the code: of an installed module that of its file."""
    if code.files or not getattr(module, "__file__", None):
        return code.digest
    return hashlib.sha256(Path(str(module.__file__)).read_bytes()).hexdigest()[:DIGITS]


def beside(text: str, folder: Path) -> str:
    """Return MODULE:NAME with the path of a file taken from a folder; anything else as it is."""
    module, _, name = text.rpartition(":")
    return f"{folder / module}:{name}" if is_file(module) else text


def _with_siblings(path: Path) -> Iterator[tuple[str, bytes]]:
    """Yield the file and the files beside it that it imports, and those that they import."""
    waiting, seen = [path], set[str]()
    while waiting:
        each = waiting.pop(0)
        if each.name in seen:
            continue
        seen.add(each.name)
        text = each.read_bytes()
        yield each.name, text
        waiting += [beside for name in _imports(text) if (beside := path.parent / f"{name}.py").is_file()]


def _imports(text: bytes) -> list[str]:
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):  # running it says what is wrong
        return []
    out: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            out += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            out.append(node.module)
    return sorted(name for name in out if "." not in name)


def _executed(code: Code, folder: Path | None) -> ModuleType:
    name = f"{Path(code.module).stem}_{code.digest}"  # by which its types are found when they are unpickled
    if name in sys.modules:
        return sys.modules[name]
    copy = _copied(code)  # the files beside it are imported from there: Python would keep an old content of a file
    path = (folder or copy) / code.module
    module = ModuleType(name)
    module.__file__ = str(path)
    sys.modules[name] = module
    try:
        with user_imports.beside({Path(file).stem: text for file, text in code.files[1:]}, copy, code.digest, folder):
            exec(compile(code.files[0][1], str(path), "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@cache
def _shelf() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory(prefix="pcbench-code-")


def _copied(code: Code) -> Path:
    """Write the files to a folder of this process."""
    folder = Path(_shelf().name) / code.digest
    folder.mkdir(exist_ok=True)
    for name, text in code.files:
        (folder / name).write_bytes(text)
    return folder


def _imported(name: str) -> ModuleType:
    """Import a module by its name, one of the working folder after all others."""
    finder = user_imports.InFolder(Path.cwd())
    sys.meta_path.append(finder)
    try:
        return importlib.import_module(name)
    finally:
        sys.meta_path.remove(finder)


def _run(make: Callable[[], ModuleType], module: str, where: str) -> ModuleType:
    """Import a user's module; whatever it raises becomes one sentence."""
    try:
        return make()
    except UserError:
        raise
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt):
            raise
        missing = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if missing and (module + ".").startswith(missing + "."):
            near = difflib.get_close_matches(missing, _modules(missing), n=1, cutoff=0.6)
            hint = f"did you mean '{near[0]}'? " if near else ""
            raise UserError(
                f"{where}: there is no module '{short(missing)}' here; {hint}Give a module's name or the path of a .py file."
            ) from None
        raise UserError(f"{where}: {short(module)} cannot be imported: {raised(error)}; mend that line.") from None


def _modules(missing: str) -> list[str]:
    """Return the modules beside a missing one, by their full names."""
    package, _, _ = missing.rpartition(".")
    folders = list(getattr(sys.modules.get(package), "__path__", [])) if package else None
    return [f"{package}.{m.name}".lstrip(".") for m in pkgutil.iter_modules(folders)]


def _files(folder: Path) -> list[str]:
    return [path.name for path in folder.glob("*.py")] if folder.is_dir() else []


def found_in(module: ModuleType, name: str, kind: type | tuple[type, ...]) -> tuple[Any, list[str]]:
    """Return the attribute of a module, None where there is none, and the names of those of a kind, or else all public ones."""
    there = [n for n, v in vars(module).items() if isinstance(v, kind) and not n.startswith("__")]
    public = [n for n in vars(module) if not n.startswith("_")]
    return getattr(module, name, None), there or public
