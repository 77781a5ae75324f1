"""A user's own code, found by MODULE:NAME and known by its content.

MODULE is the path of a .py file, or a name that can be imported, from the working folder too. A file is run once for each
content: two versions of it stand side by side in one process, and what it makes can be sent to another process with the file
and the modules beside it that it imports (`Code`). Of an installed module only the digest is kept. What the user's code raises
comes back as one sentence.
"""

import ast
import hashlib
import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple, NoReturn

from pcbench.errors import UserError, describe_exception, nearest_name, short

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
        folder = f"{FOLDER}/{self.digest}/" if is_file(self.module) else ""
        return f"{folder}{self.module}:{self.name}"


class UserPlugin(NamedTuple):
    """What is a user's own, as an entry beside pcbench's, and the code that makes it."""

    entry: Any
    code: Code


def absent(reference: str) -> Callable[..., NoReturn]:
    """Return what stands for each function of a user's own where its code is not asked for: a result is read so."""

    def nothing(*given: object) -> NoReturn:
        raise UserError(f"{reference}: got no code, expected it where runs are made; run the study that names it.")

    return nothing


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
            f"{where}: got '{short(text)}', expected MODULE:NAME such as mine.py:nudge; write the module or its file, "
            "a colon, and the name in it."
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
        near = nearest_name(path.name, (each.name for each in path.parent.glob("*.py")))
        hint = f"did you mean '{Path(module).parent / near}'? " if near else ""
        raise UserError(
            f"{where}: '{short(module)}' is no file; {hint}give the path of a .py file, or a module's name."
        )
    files, waiting = dict[str, bytes](), [path]  # with those beside it that it imports, and those that they import
    while waiting:
        each = waiting.pop(0)
        if each.name not in files:
            files[each.name] = each.read_bytes()
            beside = (path.parent / f"{name}.py" for name in _imports(files[each.name]))
            waiting += [other for other in beside if other.is_file()]
    found = tuple(files.items())
    return Code(path.name, name, found, digest(found))


def digest(files: tuple[tuple[str, bytes], ...]) -> str:
    """Return what tells the content of a module and the files beside it from any other, whatever their order."""
    module, *beside = files
    parts = [module, *sorted(beside)]
    return hashlib.sha256(b"".join(name.encode() + b"\0" + text + b"\0" for name, text in parts)).hexdigest()[:DIGITS]


def module_of(code: Code, where: str, folder: Path | None = None) -> ModuleType:
    """Return the module, run once in a process for each content; raise UserError for what it raises.

    `folder` is where its files are: what they import else is found there, and errors name their lines.
    """
    module = code.module
    try:
        return _execute(code, folder) if code.files else _import_module(module)
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        missing = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if missing and (module + ".").startswith(missing + "."):
            package, _, _ = missing.rpartition(".")  # by their full names, the modules beside the missing one
            folders = list(getattr(sys.modules.get(package), "__path__", [])) if package else None
            names = [f"{package}.{m.name}".lstrip(".") for m in pkgutil.iter_modules(folders)]
            near = nearest_name(missing, names, cutoff=0.6)
            hint = f"did you mean '{near}'? " if near else ""
            raise UserError(
                f"{where}: there is no module '{short(missing)}' here; {hint}Give a module's name or the path of a .py file."
            ) from None
        raise UserError(
            f"{where}: {short(module)} cannot be imported: {describe_exception(error)}; correct that line."
        ) from None


def digest_of(code: Code, module: ModuleType) -> str:
    """Return the digest of the code: of an installed module that of its file."""
    if code.files or not getattr(module, "__file__", None):
        return code.digest
    return hashlib.sha256(Path(str(module.__file__)).read_bytes()).hexdigest()[:DIGITS]


def resolve_reference(text: str, folder: Path) -> str:
    """Return MODULE:NAME with the path of a file taken from a folder; anything else as it is."""
    module, _, name = text.rpartition(":")
    return f"{folder / module}:{name}" if is_file(module) else text


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


def _execute(code: Code, folder: Path | None) -> ModuleType:
    name = f"{Path(code.module).stem}_{code.digest}"  # by which its types are found when they are unpickled
    if name in sys.modules:
        return sys.modules[name]
    place = folder or Path(FOLDER, code.digest)  # as a dataset calls it: of files of elsewhere there is the text alone
    module = ModuleType(name)
    module.__file__ = str(place / code.module)
    sys.modules[name] = module
    try:
        with _with_siblings_found(code, place, folder):
            exec(compile(code.files[0][1], module.__file__, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _with_siblings_found(code: Code, place: Path, folder: Path | None) -> Iterator[None]:
    """Have the files beside a module found while it runs, and modules of their names that the host program has left to it.

    `sys.path` is not touched. What is neither beside the module nor found elsewhere is looked for in its `folder`, if it has
    one; `place` is what errors call it.
    """
    texts = {Path(file).stem: text for file, text in code.files[1:]}
    hosts = {stem: sys.modules.pop(stem) for stem in texts if stem in sys.modules}
    first, last = Siblings(texts, place, code.digest), InFolder(folder)
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

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
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

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        """Return what is in the folder under a name; None where nothing is."""
        return PathFinder.find_spec(fullname, [str(self.folder)]) if self.folder and path is None else None


def _import_module(name: str) -> ModuleType:
    """Import a module by its name, one of the working folder after all others."""
    finder = InFolder(Path.cwd())
    sys.meta_path.append(finder)
    try:
        return importlib.import_module(name)
    finally:
        sys.meta_path.remove(finder)


def found_in(module: ModuleType, name: str, kind: type | tuple[type, ...]) -> tuple[object, list[str]]:
    """Return the attribute of a module, None where there is none, and the names of those of a kind, or else all public ones."""
    there = [n for n, v in vars(module).items() if isinstance(v, kind) and not n.startswith("__")]
    public = [n for n in vars(module) if not n.startswith("_")]
    return getattr(module, name, None), there or public
