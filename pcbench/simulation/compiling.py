"""A function compiled for arguments of some shapes: loaded where it is kept, else traced, made, and kept."""

from collections.abc import Callable, Hashable
from functools import wraps
from typing import Any

import jax

from pcbench.simulation import kept_programs

MOST = 16  # programs that one cache keeps
MAPPINGS = 10_000  # of memory, that these have together: a program has 130 to 5,000, and Linux allows a process 65,530


def bounded(function: Callable[..., Any], static_argnums: int | tuple[int, ...] = ()) -> Callable[..., Any]:
    """Return a function compiled once for each shape and static argument; after `MOST` programs it drops them all."""
    jitted: Any = jax.jit(function, static_argnums=static_argnums)

    @wraps(function)
    def call(*arguments: Any) -> Any:
        if jitted._cache_size() >= MOST:
            jitted.clear_cache()
        return jitted(*arguments)

    call._cache_size = jitted._cache_size  # type: ignore[attr-defined]
    return call


class Programs(dict[Hashable, Any]):
    """The programs that were asked for last, by what they are compiled for, within `MOST` and `MAPPINGS`."""

    made = 0  # so far

    def __init__(self) -> None:
        """Begin with none."""
        super().__init__()
        self.mappings: dict[Hashable, int] = {}  # of each program, as far as it was made within `ask`

    def ask(self, key: Hashable, new: Callable[[], Any]) -> Any:
        """Return the program of a key, made by `new` if there is none."""
        if key in self:
            self[key] = found = self.pop(key)
            return found
        before = _mappings()
        self[key] = found = new()
        self.mappings[key], self.made = _mappings() - before, self.made + 1
        while len(self) > MOST or (len(self) > 1 and sum(self.mappings[each] for each in self) > MAPPINGS):
            oldest = next(iter(self))
            del self[oldest], self.mappings[oldest]
        return found


def _mappings() -> int:
    """Return how many memory mappings this process has; 0 where the system does not say."""
    try:
        with open("/proc/self/maps", "rb") as lines:
            return sum(1 for _ in lines)
    except OSError:
        return 0


def compiled(
    function: Callable[..., Any], given: Callable[[], tuple[Any, ...]], device: Any, options: Any, asked: str | None
) -> Any:
    """Return a function compiled for what `given` returns, trees of shapes on a device, with the compiler's options.

    `asked` tells the program from all others before it is traced (`kept_programs.asked`); None: it is traced in any case.
    """
    where = kept_programs.folder()
    text = kept_programs.known(where, asked) if where and asked else None
    if where and text and (found := kept_programs.load(where, text, device)) is not None:
        return found
    plain = function.__name__
    name = f"{plain}_{asked[:16]}" if asked else plain  # jax's own cache is not to know it by another

    def call(*a: Any) -> Any:
        return function(*a)

    call.__name__ = name
    lowered = jax.jit(call).lower(*given())
    said = lowered.as_text() if where else ""
    if where is None or not kept_programs.whole(said):
        return lowered.compile(options)
    # names of arguments, and shapes of those that are not used, are not in the text, and a call looks at them
    trees = f"{lowered.in_tree} {jax.tree.leaves(lowered.in_avals)} {lowered.out_tree}"
    text = kept_programs.of_text(said.replace(name, plain) + trees, device, options)
    found, trees_here = kept_programs.load(where, text, device), (lowered.in_tree, lowered.out_tree)
    if found is not None and found.trees == trees_here:  # they may hold functions, of the same text and yet not equal
        kept_programs.keep(where, text, asked)
        return found
    with kept_programs.found_by_jax() as hits:
        made = lowered.compile(options)
    if not hits:
        kept_programs.keep(where, text, asked, made)
    return made
