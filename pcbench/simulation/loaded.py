"""A compiled program as bytes, and back, without what its trees are made of: that is looked at when it is called.

Machine code is linked by jax alone, beside Python, while the modules of the trees' types may still be imported.
"""

import pickle
import zlib
from functools import cached_property
from typing import Any

import jax
from jax.experimental import serialize_executable
from jax.tree_util import PyTreeDef


def as_bytes(compiled: Any) -> bytes:
    """Return a program that jax has compiled as bytes. Raises what jax raises where a platform cannot."""
    said, given, left = serialize_executable.serialize(compiled)
    sizes = given.num_leaves, left.num_leaves
    return zlib.compress(pickle.dumps((said, sizes, pickle.dumps((given, left)))), 1)


class Loaded:
    """A program out of bytes: it takes and returns the trees that the one takes and returns which they were made of.

    Raises ValueError or what pickle raises for bytes that are none of a program.
    """

    def __init__(self, content: bytes, device: Any) -> None:
        said, (many, few), self._trees = pickle.loads(zlib.decompress(content))
        given, left = jax.tree.structure(((0,) * many, {})), jax.tree.structure([0] * few)
        self._flat = serialize_executable.deserialize_and_load(said, given, left, execution_devices=[device])
        self.memory_analysis = self._flat.memory_analysis

    @cached_property
    def trees(self) -> tuple[PyTreeDef, PyTreeDef]:
        """What the program takes, and what it returns. Raises what pickle does where their types are gone."""
        given, left = pickle.loads(self._trees)
        return given, left

    def __call__(self, *args: Any) -> Any:
        """Call the program. Raises TypeError for trees that it was not compiled for."""
        leaves, tree = jax.tree.flatten((args, {}))
        given, left = self.trees
        if tree != given:
            raise TypeError(f"a program that is kept: got {tree}, expected {given}")
        return jax.tree.unflatten(left, self._flat(*leaves))
