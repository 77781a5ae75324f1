"""A planned cell as bytes, to be laid aside or sent to another process, and back.

Numbers travel; functions do not: they are found again by name, so that a program compiled for one cell serves the next, and
the gains are those that were designed and certified once, in one place.
"""

import pickle
from pathlib import Path
from types import MappingProxyType

from pcbench import plants
from pcbench.observers import base_of, entry_of
from pcbench.planning import controller
from pcbench.planning.padding import Plan


def pack(p: Plan) -> bytes | Plan:
    """Return a planned cell as bytes; unchanged where its observers' numbers are of a type that no other process knows."""
    plain = {k: dict(v) for k, v in p.cell.scenario.flat().items() if isinstance(v, MappingProxyType)}
    proofs = {o: c._replace(numbers={}) for o, c in p.certificates.items()}
    layout = p.layout._replace(plant=None, observers=None, controller=None)  # type: ignore[arg-type]
    cell = p.cell._replace(scenario=p.cell.scenario.having(**plain), options={})
    try:
        return pickle.dumps(p._replace(cell=cell, layout=layout, certificates=proofs))
    except (pickle.PicklingError, AttributeError):
        return p


def unpack(parcel: bytes | Plan) -> Plan:
    """Return the planned cell that `pack` was given, with the functions of this process."""
    if isinstance(parcel, Plan):
        return parcel
    p: Plan = pickle.loads(parcel)
    s = p.cell.scenario
    names = [(base_of(o) or o) if s.loop.controller else o for o in p.labels]
    each = tuple((name, entry_of(o).observer) for name, o in zip(names, p.labels, strict=True))
    plant, law = plants.entry_of(s).plant, controller.controller(p.cell)
    return p._replace(layout=p.layout._replace(plant=plant, observers=each, controller=law))


def lay_aside(p: Plan, path: Path) -> Path | Plan:
    """Write a planned cell to a file and return its path; return the cell itself where it cannot be written."""
    parcel = pack(p)
    if isinstance(parcel, Plan):
        return parcel
    path.write_bytes(parcel)
    return path


def take_up(laid: Path | Plan) -> bytes | Plan:
    """Return what was laid aside: bytes, or a planned cell."""
    return laid.read_bytes() if isinstance(laid, Path) else laid
