"""A planned cell as bytes for another process.

Numbers are transferred, functions are not. The other process finds them by name, so a program that is compiled for one
cell also serves the next. The gains are those that were designed and certified once.
"""

import io
import pickle
from collections.abc import Iterable, Iterator, Mapping
from functools import partial
from itertools import chain
from types import FunctionType, MappingProxyType, ModuleType

from pcbench import plants
from pcbench.observers import base_of
from pcbench.planning import loop_setup
from pcbench.planning.padding import Plan
from pcbench.study.plugins import registry


def pack(p: Plan) -> bytes | Plan:
    """Return a planned cell as bytes, or unchanged if its observers' numbers have a type of this process alone.

    The user's code comes before the numbers, which may have types from that code. They may also contain its functions
    without a name. Such a function is stored as its position among the objects that the code makes.
    """
    plain = {k: dict(v) for k, v in p.cell.scenario.flat().items() if isinstance(v, MappingProxyType)}
    certificates = {o: c._replace(numbers={}) for o, c in p.certificates.items()}
    layout = p.layout._replace(plant=None, observers=None, controller=None)  # type: ignore[arg-type]
    cell = p.cell._replace(scenario=p.cell.scenario.with_fields(user_code={}, **plain), options={}, user_observers={})
    plugins = {("observer", o): plugin for o, plugin in p.cell.user_observers.items() if o in p.labels}
    plugins |= {(kind, ""): plugin for kind, plugin in p.cell.scenario.user_code.items()}
    numbers = io.BytesIO()
    try:
        _Pickler(numbers, plugins).dump(p._replace(cell=cell, layout=layout, certificates=certificates))
        return pickle.dumps(({key: plugin.code for key, plugin in plugins.items()}, numbers.getvalue()))
    except (pickle.PicklingError, AttributeError):
        return p


def unpack(parcel: bytes | Plan) -> Plan:
    """Return the planned cell of `pack`, with the functions of this process.

    Raises UserError if the user's code cannot run here.
    """
    if isinstance(parcel, Plan):
        return parcel
    codes, numbers = pickle.loads(parcel)
    plugins = {(kind, o): registry.plugin_of(kind, code, o or kind) for (kind, o), code in codes.items()}
    p: Plan = _Unpickler(io.BytesIO(numbers), plugins).load()
    s = p.cell.scenario.with_fields(user_code={kind: plugin for (kind, o), plugin in plugins.items() if not o})
    cell = p.cell._replace(scenario=s, user_observers={o: plugin for (_, o), plugin in plugins.items() if o})
    names = [(base_of(o) or o) if s.loop.controller else o for o in p.labels]
    observers = tuple((name, cell.entry(o).observer) for name, o in zip(names, p.labels, strict=True))
    plant, controller = plants.entry_of(s).plant, loop_setup.controller(cell)
    return p._replace(cell=cell, layout=p.layout._replace(plant=plant, observers=observers, controller=controller))


class _Pickler(pickle.Pickler):
    """Writes a function without a name, which a user's code has made, as its position among these."""

    def __init__(self, file: io.BytesIO, plugins: Mapping[tuple[str, str], object]) -> None:
        super().__init__(file)
        self.numbers = {id(f): i for i, f in enumerate(_nameless(plugins))}

    def persistent_id(self, x: object) -> int | None:
        return self.numbers.get(id(x))


class _Unpickler(pickle.Unpickler):
    """Reads the functions without a name again."""

    def __init__(self, file: io.BytesIO, plugins: Mapping[tuple[str, str], object]) -> None:
        super().__init__(file)
        self.functions = _nameless(plugins)

    def persistent_load(self, number: int) -> FunctionType:
        return self.functions[number]


def _nameless(plugins: Mapping[tuple[str, str], object]) -> list[FunctionType]:
    """The functions in the objects of a user's code that cannot be found by name, in a fixed order."""
    ids: set[int] = set()
    return [f for key in sorted(plugins) for f in _functions(plugins[key], ids) if "<" in f.__qualname__]


def _functions(x: object, ids: set[int]) -> Iterator[FunctionType]:
    if id(x) in ids or isinstance(x, type | ModuleType):
        return
    ids.add(id(x))
    parts: Iterable[object] = ()
    if isinstance(x, FunctionType):
        yield x
    elif isinstance(x, partial):
        # no new tuple, which might get the id of an earlier one
        parts = chain([x.func], x.args, x.keywords.values())
    elif isinstance(x, Mapping):
        parts = x.values()
    elif isinstance(x, tuple):
        parts = x
    elif hasattr(x, "__dict__"):
        parts = [vars(x)]
    for part in parts:
        yield from _functions(part, ids)
