"""Short runs, recorded tick by tick; quiet ones, in which an observer has nothing to do.

In a quiet run the model is true, the start known and there is no noise; schedule, input and controller are the cell's.

An observer run against data that can be changed: a recorded run of one lane, without noise.

What the network brings may be shifted, packet by packet (values and notes), and so may the ages and the inputs: what an
estimate depends on is then seen by comparing two runs bit for bit.

Check that a batch of runs is the runs one at a time, carried over lanes as pcbench does it and as vmap does.
"""

from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from numpy.typing import NDArray

from pcbench import planning
from pcbench.checking.fixtures import Trial
from pcbench.checking.jaxpr_checks import Asked
from pcbench.checking.targets import require
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.engine.lane_array import is_lanes, join, split
from pcbench.errors import UserError, raised
from pcbench.planning import padding
from pcbench.planning.padding import Plan
from pcbench.plants import states_of
from pcbench.simulation import trajectory
from pcbench.simulation.simulate_runs import Shift
from pcbench.simulation.trajectory import Recording
from pcbench.simulation.types import GridPointParams, Layout, present, truth
from pcbench.study.grid import Cell

LONGEST = 4000  # ticks that are recorded while one waits


def short(cell: Cell) -> Cell:
    """Return a cell with a horizon that is soon recorded."""
    s = cell.scenario
    ticks = min(cell.times.ticks, LONGEST)
    return cell.having(duration=ticks * s.dt, steady_start=min(s.scoring.steady_start, (ticks - 1) * s.dt))


def quiet(cell: Cell) -> Cell:
    """Return a cell in which all is as observers believe."""
    s = cell.scenario
    pushed = {"unknown_input": "zero"} if s.truth.unknown_input else {}
    calm = cell.having(
        **pushed,
        parameter_drift=0.0,
        parameters={},
        process_std=(),
        assumed_process_std=s.belief.assumed_process_std or s.truth.process_std,
        command_std=0.0,
        xhat0=s.truth.x0,
        initial_box=(),
        assumed_delay_error=0.0,
    )
    choices = cell.choices.model_copy(update={"random_initial_state": False, "initial_spread": 0.0})
    return calm._replace(parameters={}, choices=choices)


def planned(cell: Cell, known: bool = True) -> list[Plan]:
    """Return a cell with its observers, of a closed loop one by one; they are told the plant's unknowns where `known`."""
    setting = planning.setting(cell)
    if known:
        setting = setting._replace(unknown0=unknowns(cell, setting.unknown0))
    each = [{o: given} for o, given in cell.options.items()] if cell.scenario.loop.controller else [cell.options]
    return [padding.fit([planning.draft(cell, options, setting)])[0] for options in each]


def unknowns(cell: Cell, believed: tuple[float, ...]) -> tuple[float, ...]:
    """Return the plant's unknowns at the start, as they are; what is `believed` of those that it does not say."""
    drafted = planning.draft(cell, {})
    p, n = jax.tree.map(jnp.asarray, drafted.problem), len(states_of(cell.scenario))
    found = truth(drafted.layout, p.params, present(p, jnp.asarray(0), True), p.x0)[n:]
    return tuple(map(float, found)) if len(found) == len(believed) else believed


def recorded(p: Plan, seed: int = 0, noise: bool = True, inputs: NDArray[np.float64] | None = None) -> Recording:
    """Record a run, with other `inputs` [N+1, m] of an open loop where they are given."""
    p = planning.alone(p, 0, seed)
    problem = p.problem if inputs is None else p.problem._replace(inputs=inputs)
    if not noise:
        problem = problem._replace(noise_std=np.zeros_like(problem.noise_std))
    return Recording(
        *jax.tree.map(np.asarray, tuple(trajectory.compiled()(p.layout, problem, np.asarray(0), np.asarray(seed))))
    )


def errors(p: Plan, out: Recording) -> dict[str, NDArray[np.float64]]:
    """Return the size of the error in every signal of each observer, by label: [N+1, n or n + s]."""
    found = {}
    for label, (name, _) in zip(p.labels, p.layout.observers, strict=True):
        xhat = np.asarray(out.estimates[name])
        found[label] = np.abs(np.asarray(out.x)[:, : xhat.shape[1]] - xhat)
    return found


def in_parts(p: Plan, out: Recording) -> dict[str, NDArray[np.float64]]:
    """Return by label the size of the error of every state in parts of the largest state: [N+1, n]."""
    n = len(states_of(p.cell.scenario))
    size = np.abs(np.asarray(out.x)[:, :n]).max() or 1.0
    return {label: e[:, :n] / size for label, e in errors(p, out).items()}


def none(p: GridPointParams) -> Shift:
    """Return the shift that changes nothing: of N + 2 packets, one a tick at most and a spare one."""
    many = p.schedule.sense.shape[0] + 1
    return Shift(jnp.zeros((many, p.noise_std.shape[0])), jnp.zeros(many))


def replay(t: Trial, p: GridPointParams, shift: Shift) -> Recording:
    """Record a run of the trial's observer on the numbers `p`, its packets shifted; room for all packets at once."""
    quiet = p._replace(noise_std=np.zeros_like(p.noise_std))
    layout = Layout(t.plant, ((t.label, t.observer),), 1, len(shift.notes), False)
    return trajectory.compiled()(layout, quiet, np.asarray(0), np.asarray(0), shift)


WIDTH, CLOSE = 3, 1e-11  # sums over lanes may be in another order


def same_in_lanes(every: Sequence[Asked], rows: Sequence[Any], with_: Callable[[Any], Any]) -> str:
    """Each lane of a batch is what the run gives alone; `rows` are what differs between lanes, `with_` puts the rest beside."""
    stacked = jax.tree.map(lambda *a: jnp.stack(a, -1), *rows)

    def all_of(some: Sequence[Asked]) -> Any:
        return lambda own: {a.name: a.f(with_(own)) for a in some}

    def alone(some: Sequence[Asked]) -> Any:
        f = jax.jit(all_of(some))
        return jax.tree.map(lambda *a: jnp.stack(a, -1), *map(f, rows))

    def entrywise(some: Any) -> Any:
        return jax.jit(lambda s: _whole(vmap_entrywise(all_of(some))(jax.tree.map(_split, s))))(stacked)

    ways = {
        "vmap over the last axis": lambda some: jax.jit(jax.vmap(all_of(some), -1, -1))(stacked),
        "pcbench's lanes": entrywise,
    }
    expected = alone(every)
    for way, run in ways.items():
        try:
            batch = run(every)
        except Exception:
            _name_the_one(way, run, every)
            raise
        for name, one in expected.items():
            require(
                _close(batch[name], one),
                f"lanes: {name} under {way}: got other numbers than one run at a time gives, expected the same; let no run "
                "depend on how many there are.",
            )
    return f"{len(rows)} runs at once are the same as one at a time"


def _name_the_one(way: str, run: Any, every: Sequence[Asked]) -> None:
    """Raise UserError for the function that cannot be batched."""
    for a in every:
        try:
            run([a])
        except Exception as error:
            raise UserError(
                f"lanes: {a.name} under {way}: got {raised(error)}, expected a batch of runs; write it in jax.numpy, without "
                "callbacks into Python."
            ) from None


def moved(tree: Any, i: int) -> Any:
    """Return what another lane has in place of a pytree: its real numbers differ."""
    return jax.tree.map(lambda a: a * (1 + i / 8) + i / 16 if jnp.issubdtype(a.dtype, jnp.floating) else a, tree)


def _split(a: Any) -> Any:
    """An array over lanes; what is empty differs in none."""
    return split(a) if a.size else a[..., 0]


def _whole(tree: Any) -> Any:
    """Join what is split; what does not differ between lanes is the same in each."""

    def one(x: Any) -> Any:
        return join(x) if is_lanes(x) else jnp.broadcast_to(jnp.asarray(x)[..., None], (*jnp.shape(x), WIDTH))

    return jax.tree.map(one, tree, is_leaf=is_lanes)


def _close(a: Any, b: Any) -> bool:
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(x.shape == y.shape and np.allclose(x, y, rtol=CLOSE, atol=CLOSE, equal_nan=True) for x, y in pairs)
