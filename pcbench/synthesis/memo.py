"""The last answers of a function of arrays, given again for equal ones: cells of a study come one after the other, alike."""

from collections import OrderedDict
from collections.abc import Callable
from typing import Any, Generic, TypeVar

import numpy as np

Answer = TypeVar("Answer")
ROOM = 16  # answers


class Again(Generic[Answer]):
    """A function with a memory of its last answers, by what it was given, to the bit; arguments are positional.

    An answer is shared: whoever gets it leaves it as it is. What is raised is not remembered.
    """

    def __init__(self, function: Callable[..., Answer]) -> None:
        self.function = function
        self.kept: OrderedDict[Any, Answer] = OrderedDict()

    def __call__(self, *given: Any) -> Answer:
        """Return what the function does."""
        key = tuple((a.dtype.str, a.shape, a.tobytes()) if isinstance(a, np.ndarray) else a for a in given)
        if key not in self.kept:
            self.kept[key] = self.function(*given)
            if len(self.kept) > ROOM:
                self.kept.popitem(last=False)
        return self.kept[key]

    def forget(self) -> None:
        """Begin anew."""
        self.kept.clear()
