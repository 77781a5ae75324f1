"""Several channels, each with its own period and delay: what is handed over is what was measured, with its note and age."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from harness import LINEAR, ODD, Case, noise, problem

from pcbench.engine import common_schedule, lane_array, steps
from pcbench.protocols import Observer
from pcbench.simulation.schedule import common_times
from pcbench.simulation.types import Layout

SHAPE = (2,)


def remember(gains, memory, now, arrival):
    """Keep the newest value, age, number and note of each channel, and count the arrivals."""
    keep = lambda new, old: jnp.where(arrival.mask, new, old)  # noqa: E731
    return {
        "tick": memory["tick"],
        "value": keep(arrival.value, memory["value"]),
        "age": keep(1.0 * arrival.age, memory["age"]),
        "index": keep(1.0 * arrival.index, memory["index"]),
        "note": keep(jnp.full(SHAPE, arrival.snapshot[0]), memory["note"]),
        "count": memory["count"] + arrival.mask,
        "since": keep(jnp.full(SHAPE, 1.0 * arrival.ticks_since_arrival), memory["since"]),
        "u": keep(jnp.stack([now.u[0], now.past_u(1)[0]]), memory["u"]),
    }


SPY = Observer(
    init=lambda gains, xhat0: (
        {k: jnp.zeros(SHAPE) for k in ("value", "age", "index", "note", "count", "since", "u")}
        | {"tick": jnp.zeros(())}
    ),
    snapshot=lambda gains, memory, now: memory["tick"][None] + 0.5,  # something that differs at every tick
    jump=remember,
    flow=lambda gains, memory, now: memory | {"tick": memory["tick"] + 1.0},
    estimate=lambda gains, memory: jnp.stack([memory["value"][0], memory["value"][1], memory["count"].sum()]),
)


def whole(x):
    """A memory's leaf of the only lane."""
    return np.asarray(lane_array.join(x))[..., 0] if lane_array.is_lanes(x) else np.asarray(x)


REST = (((4, 4), (9, 2)), ((6, 9), (0, 0)), ((1, 3), (2, 50)))


@pytest.mark.parametrize(
    ("period", "delay"),
    [((7, 5), (3, 20)), *(pytest.param(*t, marks=pytest.mark.nightly) for t in REST)],
)
def test_each_channel_gets_its_own_samples(period, delay):
    ticks = 120
    case = Case(ODD, 1, 0, ticks=ticks, h=0.01, noise_std=0.4)
    _, p = problem(case, {"model-only": {}})
    plan = common_times.periodic(list(period), list(delay), ticks)
    p = jax.tree.map(jnp.asarray, p._replace(schedule=plan, gains={"spy": ()}))
    layout = Layout(LINEAR, (("spy", SPY),), 1, common_times.in_flight(plan), False)
    happen, state = common_schedule.prepare(layout, p, jnp.asarray(0), jnp.asarray([0]))
    v = np.stack(noise(case), -1)
    step = jax.jit(lambda s, k: happen(k, s))
    flow = jax.jit(lambda s, k: steps.flow(layout, p, k, s, jnp.zeros(0)))
    x, counts = [], np.zeros(2)
    arrivals = [int(a) for a in np.flatnonzero((plan.arrive >= 0).any(1))]
    for k in range(ticks + 1):
        x.append(np.asarray(state.x))
        state = step(state, jnp.asarray(k))
        got = {name: whole(leaf) for name, leaf in state.memories["spy"].items()}
        for j in range(2):
            if k >= delay[j]:
                i = (k - delay[j]) // period[j]
                taken = i * period[j]
                counts[j] = i + 1
                assert got["value"][j] == pytest.approx(ODD.C[j] @ x[taken] + v[i, j], rel=1e-12)
                assert got["index"][j] == i
                assert got["age"][j] == delay[j]
                assert got["note"][j] == taken + 0.5
                if k == taken + delay[j]:
                    before = [a for a in arrivals if a < k]
                    assert got["since"][j] == k - (before[-1] if before else 0)
                    assert got["u"][j] == (p.inputs[k - 1, 0] if k else 0.0), "u_k is not yet decided at a jump"
        np.testing.assert_array_equal(got["count"], counts)
        state = flow(state, jnp.asarray(k))
