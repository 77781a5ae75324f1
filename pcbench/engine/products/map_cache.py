"""Maps made by a program of their own, and kept: cells that agree in what maps depend on have them once.

What they depend on is read from their equations: the plant, observers' own motion, the input and where events are; not noise,
seeds or the start, nor the gains of most jumps. Of a call with few lanes, making them is two thirds.
"""

import hashlib
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future
from functools import partial
from threading import Lock
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.engine import jaxpr_compat
from pcbench.engine.initial_state import begin
from pcbench.engine.products.affine_detection import forms
from pcbench.engine.products.block_maps import Maps, maps
from pcbench.engine.products.blocks import chunks
from pcbench.engine.products.jaxpr_dependence import read
from pcbench.simulation.problem import Layout, Problem

Every = dict[str, Maps]  # by the label of a form


class Maker(NamedTuple):
    """What makes the maps of a layout."""

    call: Any  # (problem) -> Every
    reads: tuple[int, ...]  # leaves of the problem that they depend on, as `jax.tree.leaves` counts them
    number: int  # tells it from every other of this process, so that maps that are kept do not keep its program


class Kept:
    """Maps that were asked for last, by what they are made from; several threads may ask, and one makes them."""

    def __init__(self, room: int) -> None:
        """Begin with none; `room` is how many bytes are kept, besides those of the last."""
        self.room, self.lock = room, Lock()
        self.made: OrderedDict[Any, Future[Any]] = OrderedDict()

    def ask(self, key: Any, make: Callable[[], Any]) -> Any:
        """Return what was made from this, or make it."""
        with self.lock:
            mine = self.made.get(key)
            if new := mine is None:
                mine = self.made[key] = Future()
            self.made.move_to_end(key)
        if new:
            try:
                mine.set_result(make())
            except BaseException as error:
                with self.lock:
                    self.made.pop(key, None)
                mine.set_exception(error)
                raise
            self._forget()
        return mine.result()

    def clear(self) -> None:
        """Forget all."""
        with self.lock:
            self.made.clear()

    def _forget(self) -> None:
        """Forget those that were asked for first, until the others fit."""
        with self.lock:
            done = {key: f.result() for key, f in self.made.items() if f.done() and not f.exception()}
            sizes = {key: sum(a.nbytes for a in jax.tree.leaves(found)) for key, found in done.items()}
            over = sum(sizes.values()) - self.room
            for key in list(sizes)[:-1]:
                if over > 0:
                    over -= sizes[key]
                    del self.made[key]


KEPT = Kept(2**27)  # 14 cells' maps of three observers of the cart over 10,000 ticks


def made(layout: Layout, p: Problem) -> Every:
    """Return the maps of the plant and of every observer that goes by products; none where nothing does."""
    if not layout.lifted:
        return {}
    layout = bare(layout)
    state = jax.eval_shape(partial(begin, layout), p, jnp.asarray(0), jnp.zeros(1, int))
    each = chunks(p, layout.lifted)
    return {form.label: maps(layout, p, state, form, each) for form in forms(layout, p, state)}


def bare(layout: Layout) -> Layout:
    """Return a layout without what no map depends on."""
    return layout._replace(width=1, ring=1)


class Traced(NamedTuple):
    """What makes the maps of a layout, traced: it is asked for what it reads, for their shapes, and compiled."""

    closed: Any  # its jaxpr
    shape: Every  # of arrays their shapes

    def __call__(self, p: Problem) -> Every:
        """Return the maps."""
        every: Every = jax.tree.unflatten(
            jax.tree.structure(self.shape), jaxpr_compat.jaxpr_as_fun(self.closed)(*jax.tree.leaves(p))
        )
        return every


def traced(layout: Layout, p: Problem) -> Traced:
    """Return what makes the maps of a layout, of problems with these shapes."""
    return Traced(*jax.make_jaxpr(partial(made, layout), return_shape=True)(p))


def reads(maker: Traced) -> dict[str, list[int]]:
    """Return by form the leaves of the problem that its maps depend on."""
    found, _ = read(*maker)
    return {
        label: sorted(frozenset().union(*jax.tree.leaves(each, is_leaf=lambda a: isinstance(a, frozenset))))
        for label, each in found.items()
    }


def given(maker: Maker | None, p: Problem, kept: Kept = KEPT) -> Every:
    """Return the maps of a problem whose leaves are NumPy's arrays: those that are kept, or new ones."""
    if maker is None:
        return {}
    leaves = jax.tree.leaves(p)
    return kept.ask((maker.number, *(_digest(leaves[i]) for i in maker.reads)), lambda: maker.call(p))


def _digest(numbers: np.ndarray) -> bytes:
    return hashlib.sha1(np.ascontiguousarray(numbers).data, usedforsecurity=False).digest()
