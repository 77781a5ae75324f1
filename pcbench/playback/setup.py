"""Observers of a plant as a study has them, made ready for a log: their gains, with room for what the log brings.

Designers are told of the study's own period, delay, noise and horizon, which is what is believed; only room is the log's: how
many samples overtake, are on their way, how old they get. So on a log of a simulated run gains are those of that run.
"""

from typing import NamedTuple

import jax
import numpy as np

from pcbench import planning
from pcbench.errors import UserError
from pcbench.plants import signals_of
from pcbench.playback.step_block import PLANT
from pcbench.protocols import Observer
from pcbench.recordings.windows import Room
from pcbench.simulation import shape_checks
from pcbench.simulation.types import GridPointParams, InputWindow, Layout
from pcbench.study.grid import Cell
from pcbench.synthesis.certificate import Certificate, DesignContext, power_of_2


class Prepared(NamedTuple):
    """Observers ready to run; m inputs."""

    layout: Layout
    problem: GridPointParams
    setting: DesignContext
    certificates: dict[str, Certificate]
    back: int  # ticks of inputs that they may ask for
    m: int
    sizes: dict[str, int]  # of what each estimates


def prepared(cell: Cell, room: Room, last: int, log: str) -> Prepared:
    """Design the observers of a cell for a log of ticks 0 .. `last`; raise UserError where the log does not fit its horizon."""
    s, where = cell.scenario, f"{log} on {cell.scenario.name}"
    _require_fit(cell, room, where)
    known = planning.setting(cell)
    reach = max(-(-room.latest // max(each, 1)) for each in known.period)
    known = known._replace(
        overtaking=max(known.overtaking, room.overtaking),
        flight=max(known.flight, room.flight),
        latest=max(known.latest, room.latest),
        reach=max(known.reach, reach),
    )
    designs = {o: planning.designed(o, cell.entry(o), known, options) for o, options in cell.options.items()}
    m, signals = known.model.B.shape[1], len(signals_of(s))
    back = min(last + 1, power_of_2(room.latest + (2 * room.overtaking + 2) * max(room.apart, 1)))
    belief = s.belief
    around = cell.choices.random_initial_state and belief.initial_box
    problem = GridPointParams(
        params=np.zeros(len(s.sampling.delay)),
        gains={o: d.gains for o, d in designs.items()},
        schedule=(),
        inputs=InputWindow(np.zeros((back + 1, m)), np.asarray(-back)),
        dt=np.asarray(s.dt),
        x0=np.zeros(signals),
        xhat0=np.array(s.truth.x0 if around else belief.xhat0),
        spread0=np.diag(belief.prior_std),
        noise_std=np.array(s.sampling.noise_std),
        band=np.array(s.scoring.settle_band),
        bound=np.broadcast_to(np.asarray(s.scoring.divergence_threshold, float), signals),
        windows=np.zeros((0, 2), int),
    )
    layout = Layout(
        plant=PLANT,
        observers=tuple((o, cell.entry(o).observer) for o in cell.options),
        width=1,
        ring=power_of_2(max(room.flight, 1)),
        random_initial_state=False,
        watch=False,
    )
    for label, observer in layout.observers:
        shape_checks.check(label, observer, problem._replace(x0=problem.xhat0))
    return Prepared(
        layout=layout,
        problem=problem,
        setting=known,
        certificates={o: d.certificate for o, d in designs.items()},
        back=back,
        m=m,
        sizes={o: _size(observer, problem, o) for o, observer in layout.observers},
    )


def _size(observer: Observer, p: GridPointParams, label: str) -> int:
    """How many signals an observer estimates."""
    found = jax.eval_shape(lambda p: observer.estimate(p.gains[label], observer.init(p.gains[label], p.xhat0)), p)
    return int(found.shape[0])


def _require_fit(cell: Cell, room: Room, where: str) -> None:
    s = cell.scenario
    if s.sampling.continuous or cell.times.error:
        what = (
            "measures continuously"
            if s.sampling.continuous
            else f"believes delays wrong by {cell.times.error * s.dt:g} s"
        )
        raise UserError(f"{where}: got a scenario that {what}, expected one that samples; take another plant file.")
    if room.apart + room.latest > cell.times.ticks:
        gap = f"{room.apart * s.dt:g} s without a sample before row {room.apart_row}"
        raise UserError(
            f"{where}: got {gap} and some up to {room.latest * s.dt:g} s late, expected less than the duration of "
            f"{s.duration:g} "
            "s in all; cut the log there, or write a longer horizon."
        )
