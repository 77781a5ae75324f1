"""What of a cell goes through a program: the cell itself, each of its modes, or each of some drawn schedules."""

from collections.abc import Hashable, Iterator
from typing import Any, NamedTuple

import jax

from pcbench.moments.delay_modes import over_modes
from pcbench.moments.observer_affinity import curved
from pcbench.moments.realisations import Realised, losses_alone, over_losses, random, realised
from pcbench.planning.padding import Plan
from pcbench.simulation.types import GridPointParams


class Asked(NamedTuple):
    """What is asked of all cells of a study."""

    root_seed: int
    schedules: int  # realisations of a random cell: those of the first seeds
    recorded: str = ""  # nothing, "std" or "covariance" over time
    points: int = 0  # at so many ticks, about; 0: at every tick

    def every(self, ticks: int) -> int:
        """Return how many ticks apart those are that are recorded, of a cell of so many."""
        return max(1, ticks // self.points) if self.points else 1


class Item(NamedTuple):
    """One realisation of one cell."""

    planned: Plan  # without its long tables
    cell: int
    place: int  # which realisation, of
    many: int
    random: bool
    sizes: dict[str, int]  # by observer, what it estimates
    one: Realised
    bend: float = 0.0  # how far its plant is from affine, where it is and has noise
    whole: Plan | None = None  # with its tables, of a cell that may have to go on drawn schedules yet


def cell(p: Plan, number: int, asked: Asked, unlike: set[Hashable]) -> Iterator[Item]:
    """Yield a cell as its moments move: once, in each of its modes, or on each drawn schedule; on the first alone, to try."""
    alone = len(p.layout.observers) == 1
    modes = over_modes(p) if alone and kind(p) not in unlike else None
    mixed = over_losses(p) if alone and losses_alone(p) else None
    drawn = random(p) and not modes and mixed is None
    first = modes[0] if modes else mixed or realised(p, asked.root_seed, 0)
    tried = alone and drawn and asked.schedules > 1 and curved(first.layout, first.problem)
    many = len(modes) if modes else asked.schedules if drawn and not tried else 1
    sizes = _signals(p)
    for place in range(many):
        one = first if not place else modes[place] if modes else realised(p, asked.root_seed, place)
        yield Item(
            planned=_light(p),
            cell=number,
            place=place,
            many=many,
            random=drawn,
            sizes=sizes,
            one=one,
            whole=p if modes or tried else None,
        )


def bent(p: Plan, number: int, bend: float) -> Item:
    """Return a cell whose plant is not affine: nothing is computed of it."""
    one = Realised(p.layout, p.problem, ())
    return Item(planned=_light(p), cell=number, place=0, many=1, random=False, sizes=_signals(p), one=one, bend=bend)


def _light(p: Plan) -> Plan:
    """A planned cell without its long tables."""
    return p._replace(problem=p.problem._replace(schedule=(), inputs=(), params=(), gains={}))


def kind(p: Plan) -> Hashable:
    """Return what decides whether modes of a cell can meet: its observer, not its numbers."""
    return p.layout.observers, jax.tree.structure(p.problem)


def _signals(p: Plan) -> dict[str, int]:
    """How many signals each observer of a planned cell estimates."""
    n = len(p.problem.x0)
    if n == len(p.problem.band):
        return {label: n for label, _ in p.layout.observers}

    def estimates(problem: GridPointParams) -> dict[str, Any]:
        gains, xhat0 = problem.gains, problem.xhat0
        return {label: o.estimate(gains[label], o.init(gains[label], xhat0)) for label, o in p.layout.observers}

    return {label: e.shape[0] for label, e in jax.eval_shape(estimates, p.problem).items()}
