"""A planned cell as bytes, to be sent to another process, and back.

Numbers travel; functions do not: they are found again by name, so that a program compiled for one cell serves the next, and
the gains are those that were designed and certified once, in one place.
"""

import pickle
from types import MappingProxyType

from pcbench import plants
from pcbench.observers import base_of
from pcbench.planning import controller
from pcbench.planning.padding import Plan
from pcbench.study import own_entries


def pack(p: Plan) -> bytes | Plan:
    """Return a planned cell as bytes; unchanged where its observers' numbers are of a type that no other process knows.

    A user's own code goes before the numbers, which may be of its types.
    """
    plain = {k: dict(v) for k, v in p.cell.scenario.flat().items() if isinstance(v, MappingProxyType)}
    proofs = {o: c._replace(numbers={}) for o, c in p.certificates.items()}
    layout = p.layout._replace(plant=None, observers=None, controller=None)  # type: ignore[arg-type]
    cell = p.cell._replace(scenario=p.cell.scenario.having(own={}, **plain), options={}, own={})
    codes = {("observer", o): mine.code for o, mine in p.cell.own.items() if o in p.labels}
    codes |= {(kind, ""): mine.code for kind, mine in p.cell.scenario.own.items()}
    try:
        return pickle.dumps((codes, pickle.dumps(p._replace(cell=cell, layout=layout, certificates=proofs))))
    except (pickle.PicklingError, AttributeError):
        return p


def unpack(parcel: bytes | Plan) -> Plan:
    """Return the planned cell that `pack` was given, with the functions of this process.

    Raises UserError where a user's own code cannot be run here.
    """
    if isinstance(parcel, Plan):
        return parcel
    codes, numbers = pickle.loads(parcel)
    found = {(kind, o): own_entries.of(kind, code, o or kind) for (kind, o), code in codes.items()}
    p: Plan = pickle.loads(numbers)
    s = p.cell.scenario.having(own={kind: mine for (kind, o), mine in found.items() if not o})
    cell = p.cell._replace(scenario=s, own={o: mine for (_, o), mine in found.items() if o})
    names = [(base_of(o) or o) if s.loop.controller else o for o in p.labels]
    each = tuple((name, cell.entry(o).observer) for name, o in zip(names, p.labels, strict=True))
    plant, law = plants.entry_of(s).plant, controller.controller(cell)
    return p._replace(cell=cell, layout=p.layout._replace(plant=plant, observers=each, controller=law))
