"""User-defined code, found by MODULE:NAME and identified by its content.

MODULE is the path of a .py file, or the name of a module that can be imported, also from the working folder. A file is run once
per content, so two versions can coexist in one process. Its objects can be sent to another process together with the file and
the modules next to it that it imports (`Code`). For an installed module only the digest is kept. Exceptions in user code are
reported as one sentence.
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
FOLDER = "code"  # folder in a dataset, with one subfolder per digest


class Code(NamedTuple):
    """The code of a user-defined object: its files by name, the module first; no files for an installed module."""

    module: str  # name of the file or module
    name: str  # name of the object in it
    files: tuple[tuple[str, bytes], ...]
    digest: str  # of all files

    @property
    def reference(self) -> str:
        """Return the reference MODULE:NAME in a dataset, which contains the files."""
        folder = f"{FOLDER}/{self.digest}/" if is_file(self.module) else ""
        return f"{folder}{self.module}:{self.name}"


class UserPlugin(NamedTuple):
    """A user-defined object: its entry, and its code."""

    entry: Any
    code: Code


def absent(reference: str) -> Callable[..., NoReturn]:
    """Return a placeholder for the functions of a user-defined object, used when a result is read without its code."""

    def placeholder(*args: object) -> NoReturn:
        raise UserError(f"{reference}: got no code, expected it where runs are made; run the study that names it.")

    return placeholder


def is_reference(text: str) -> bool:
    """Return whether a name is MODULE:NAME."""
    return ":" in text


def is_file(module: str) -> bool:
    """Return whether MODULE is the path of a file."""
    return module.endswith(".py") or "/" in module


def split(text: str, where: str) -> tuple[str, str]:
    """Return MODULE and NAME; raise UserError if one is missing."""
    module, colon, name = text.rpartition(":")
    if not colon or not module or not name:
        raise UserError(
            f"{where}: got '{short(text)}', expected MODULE:NAME such as mine.py:nudge; write the module or its file, "
            "a colon, and the name in it."
        )
    return module, name


def code_of(text: str, where: str, folder: Path | None = None) -> Code:
    """Return the code of MODULE:NAME without running it; paths are relative to `folder` (default: the working folder).

    Raises UserError if the file does not exist.
    """
    module, name = split(text, where)
    if not is_file(module):
        return Code(module, name, (), "")
    path = (folder or Path()) / module
    if not path.is_file():
        nearest = nearest_name(path.name, (file.name for file in path.parent.glob("*.py")))
        hint = f"did you mean '{Path(module).parent / nearest}'? " if nearest else ""
        raise UserError(
            f"{where}: '{short(module)}' is no file; {hint}give the path of a .py file, or a module's name."
        )
    files, queue = dict[str, bytes](), [path]  # with the files next to it that it imports, recursively
    while queue:
        file = queue.pop(0)
        if file.name not in files:
            files[file.name] = file.read_bytes()
            siblings = (path.parent / f"{name}.py" for name in _imports(files[file.name]))
            queue += [p for p in siblings if p.is_file()]
    contents = tuple(files.items())
    return Code(path.name, name, contents, digest(contents))


def digest(files: tuple[tuple[str, bytes], ...]) -> str:
    """Return the digest of the contents of a module and the files next to it, in any order."""
    module, *siblings = files
    parts = [module, *sorted(siblings)]
    return hashlib.sha256(b"".join(name.encode() + b"\0" + text + b"\0" for name, text in parts)).hexdigest()[:DIGITS]


def module_of(code: Code, where: str, folder: Path | None = None) -> ModuleType:
    """Return the module, run once per content in a process; raise UserError for an exception in it.

    `folder` contains its files: other imports are found there, and errors refer to their lines.
    """
    module = code.module
    try:
        return _execute(code, folder) if code.files else _import_module(module)
    except (UserError, KeyboardInterrupt):
        raise
    except BaseException as error:
        missing = getattr(error, "name", None) if isinstance(error, ModuleNotFoundError) else None
        if missing and (module + ".").startswith(missing + "."):
            package, _, _ = missing.rpartition(".")  # full names of the modules next to the missing one
            folders = list(getattr(sys.modules.get(package), "__path__", [])) if package else None
            names = [f"{package}.{m.name}".lstrip(".") for m in pkgutil.iter_modules(folders)]
            nearest = nearest_name(missing, names, cutoff=0.6)
            hint = f"did you mean '{nearest}'? " if nearest else ""
            raise UserError(
                f"{where}: there is no module '{short(missing)}' here; {hint}Give a module's name or the path of a .py file."
            ) from None
        raise UserError(
            f"{where}: {short(module)} cannot be imported: {describe_exception(error)}; correct that line."
        ) from None


def digest_of(code: Code, module: ModuleType) -> str:
    """Return the digest of the code; for an installed module that of its file."""
    if code.files or not getattr(module, "__file__", None):
        return code.digest
    return hashlib.sha256(Path(str(module.__file__)).read_bytes()).hexdigest()[:DIGITS]


def resolve_reference(text: str, folder: Path) -> str:
    """Return MODULE:NAME with the path of a file relative to a folder resolved; anything else unchanged."""
    module, _, name = text.rpartition(":")
    return f"{folder / module}:{name}" if is_file(module) else text


def _imports(text: bytes) -> list[str]:
    try:
        tree = ast.parse(text)
    except (SyntaxError, ValueError):  # running it reports the error
        return []
    out: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            out += [alias.name for alias in node.names]
        if isinstance(node, ast.ImportFrom) and node.module and not node.level:
            out.append(node.module)
    return sorted(name for name in out if "." not in name)


def _execute(code: Code, folder: Path | None) -> ModuleType:
    name = f"{Path(code.module).stem}_{code.digest}"  # the module name by which its types are unpickled
    if name in sys.modules:
        return sys.modules[name]
    # without a folder as a dataset names it: for files from elsewhere only the text is available
    place = folder or Path(FOLDER, code.digest)
    module = ModuleType(name)
    module.__file__ = str(place / code.module)
    sys.modules[name] = module
    try:
        with _importable_siblings(code, place, folder):
            exec(compile(code.files[0][1], module.__file__, "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module


@contextmanager
def _importable_siblings(code: Code, place: Path, folder: Path | None) -> Iterator[None]:
    """Make the files next to a module importable while it runs, and restore modules with these names afterwards.

    `sys.path` is not changed. Modules found neither next to it nor elsewhere are looked up in `folder`, if given. `place` is
    the path in error messages.
    """
    texts = {Path(file).stem: text for file, text in code.files[1:]}
    hosts = {stem: sys.modules.pop(stem) for stem in texts if stem in sys.modules}
    first, last = Siblings(texts, place, code.digest), InFolder(folder)
    sys.meta_path[:] = [first, *sys.meta_path, last]
    try:
        yield
    finally:
        sys.meta_path[:] = [finder for finder in sys.meta_path if finder is not first and finder is not last]
        sys.modules.update({stem: m for stem, m in hosts.items() if m.__name__ == stem})  # the others are siblings


class Siblings(MetaPathFinder, Loader):
    """Import hook for the files next to a module, each as NAME_DIGEST, so that its types can be unpickled."""

    def __init__(self, texts: dict[str, bytes], folder: Path, digest: str) -> None:
        self.texts, self.folder, self.digest = texts, folder, digest

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        """Return the spec of a file next to the module; None for another name."""
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
    """Import hook of last resort that looks in a folder, if there is one."""

    def __init__(self, folder: Path | None) -> None:
        self.folder = folder

    def find_spec(self, fullname: str, path: object, target: object = None) -> ModuleSpec | None:
        """Return the spec of a module in the folder; None if there is none."""
        return PathFinder.find_spec(fullname, [str(self.folder)]) if self.folder and path is None else None


def _import_module(name: str) -> ModuleType:
    """Import a module by its name, from the working folder last."""
    finder = InFolder(Path.cwd())
    sys.meta_path.append(finder)
    try:
        return importlib.import_module(name)
    finally:
        sys.meta_path.remove(finder)


def attribute_of(module: ModuleType, name: str, kind: type | tuple[type, ...]) -> tuple[object, list[str]]:
    """Return an attribute of a module (None: missing), and the names of its attributes of a kind, or else all public ones."""
    names = [n for n, v in vars(module).items() if isinstance(v, kind) and not n.startswith("__")]
    public = [n for n in vars(module) if not n.startswith("_")]
    return getattr(module, name, None), names or public
