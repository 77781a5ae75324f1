"""A flow that goes by chunks leaves what one leaves that goes tick by tick; what cannot go so is stepped.

The oracle of the sums is a loop in NumPy over the recording of a run, which goes tick by tick.
"""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.engine import event_loop, runner
from pcbench.engine.products import affine_detection, matmul
from pcbench.engine.products.block_maps import every_map
from pcbench.observers import OBSERVERS
from pcbench.protocols import Observer
from pcbench.runtime import config
from pcbench.simulation import metrics
from tests.support.harness import LINEAR, ODD, Case, problem, recorder

pytestmark = pytest.mark.usefixtures("in_a_hurry")
STEPPED = {"chain", "equal-delay", "no-delay", "kf-delayed-horizon"}  # with schedules of their own in memory
LIFTED = sorted({"kf", "ekf", "kfbo", "pccebo", "pco", "kf-larsen", "kf-ignore-delay", "oosm-lag", "model-only"})
CASE = Case(ODD, 37, 74, ticks=400, h=0.01, noise_std=0.4, seed=3, xhat0=[0.5, -1.0, 2.0], input_intensity=0.05)
ROOM, WIDTH, N = 64, 4, CASE.ticks
BAND, FAR = np.array([1.0, 0.5, 0.8]), np.full(3, 1e9)
RELATIVE, ZERO = 1e-11, 1e-13  # other orders of sums; and that, as a part of the largest, is rounding of zero


def outcome(observers, lifted, bound=FAR, jumps=(), spread=1.0):
    """What runs of CASE leave, by its own start or by random ones."""
    layout, p = problem(CASE, {o: {} for o in observers})
    p = p._replace(band=BAND, bound=bound, jumps=np.array(jumps, int), spread0=np.eye(3) * spread)
    layout = layout._replace(lifted=lifted, width=WIDTH, random_initial_state=spread > 0)
    job = runner.Job(p, 0, np.arange(WIDTH) + CASE.seed)
    with config.float64():
        made = runner.program(layout, job)
        return made.ways, next(runner.serial(made, [job]))[1]


def read(left, label):
    return metrics.read(left.streams[label], left.watches[label], left.final[label], N, N // 2, CASE.h, True)


def agree(a, b):
    largest = np.nanmax(a["max_abs_error"], -1, keepdims=True)
    for name in a:
        if name in ("settling_time", "recovery_time", "unsettled", "diverged", "divergence_time"):
            np.testing.assert_array_equal(a[name], b[name], err_msg=name)
        else:
            size = largest**2 if name.endswith("mse") and not name.endswith("rmse") else largest
            within = RELATIVE * np.abs(a[name]) + ZERO * size
            assert ((np.abs(a[name] - b[name]) <= within) | np.isnan(a[name])).all(), name
            np.testing.assert_array_equal(np.isnan(a[name]), np.isnan(b[name]))


def both(observers, **given):
    """Compare the two; return how observers went, and what those that were lifted leave."""
    (ways, quick), (_, slow) = outcome(observers, ROOM, **given), outcome(observers, 0, **given)
    for o in observers:
        agree(read(slow, o), read(quick, o))
    return ways, quick


@pytest.mark.ci
def test_lifted_equals_stepped_and_who_leaves_its_bound_does_so_at_the_same_tick():
    ways, left = both(["kf"], jumps=(210, 300))
    peaks = np.asarray(left.streams["kf"].peak).max(0)[2]
    _, left = both(["kf"], bound=np.array([1e9, 1e9, np.median(peaks)]))
    bad = np.asarray(left.watches["kf"].first_bad)
    assert ways == {"kf": "lifted"}
    assert (bad > 0).any()
    assert (bad < 0).any()


@pytest.mark.nightly
@pytest.mark.parametrize("spread", [0.0, 1.0])
@pytest.mark.parametrize("bound", [4.0, 1e9], ids=["some leave", "none leaves"])
@pytest.mark.parametrize("jumps", [(), (210, 300)])
def test_every_affine_observer_is_the_same_lifted_and_stepped(spread, bound, jumps):
    ways, _ = both([*LIFTED, "chain", "kf-delayed-horizon"], jumps=jumps, spread=spread, bound=np.full(3, bound))
    assert {o for o, way in ways.items() if way == "stepped"} == {"chain", "kf-delayed-horizon"}


@pytest.mark.parametrize("jumps", [pytest.param((), marks=pytest.mark.ci), (210, 300)])
def test_sums_are_those_of_the_errors_of_a_recorded_run(jumps):
    layout, p = problem(CASE, {"kf": {}})
    with config.float64():
        run = recorder()(layout._replace(random_initial_state=True), p, np.asarray(0), np.asarray(CASE.seed))
    e = np.abs(np.asarray(run.x) - np.asarray(run.estimates["kf"]))[:N]
    _, left = outcome(["kf"], ROOM, jumps=jumps)
    found = read(left, "kf")
    expected = {"mae": e.mean(0), "mse": (e**2).mean(0), "max_abs_error": e.max(0), "steady_mae": e[N // 2 :].mean(0)}
    for name, value in expected.items():
        np.testing.assert_allclose(found[name][:, 0], value, 1e-10, err_msg=name)
    last = np.array([np.flatnonzero(e[:, i] > BAND[i])[-1] + 1 for i in range(3)])
    np.testing.assert_array_equal(found["settling_time"][:, 0], last * CASE.h)


def ways(observer=None, label="kf", case=CASE):
    """How an observer goes, by its shapes alone; one's own takes the gains of `kf`."""
    layout, p = problem(case, {label: {}})
    each = ((label, observer or OBSERVERS[label].observer),)
    with config.float64():
        found = jax.eval_shape(
            partial(every_map, layout._replace(observers=each, lifted=ROOM, random_initial_state=True)), p
        )
        return "lifted" if label in found else "stepped"


@pytest.mark.ci
@pytest.mark.parametrize("label", ["kf", "kfbo", "chain", "kf-delayed-horizon"])
def test_who_keeps_a_schedule_of_its_own_is_stepped(label):
    assert ways(label=label) == ("stepped" if label in STEPPED else "lifted")


@pytest.mark.nightly
@pytest.mark.parametrize("label", sorted({*LIFTED, *STEPPED}))
def test_who_goes_by_products(label):
    assert ways(label=label) == ("stepped" if label in STEPPED else "lifted")


def own(flow):
    return Observer(
        init=lambda gains, xhat0: (xhat0, jnp.asarray(0)),
        snapshot=lambda gains, memory, now: jnp.zeros(0),
        jump=lambda gains, memory, now, arrival: (memory[0] + 0.1 * arrival.value[0], memory[1]),
        flow=flow,
        estimate=lambda gains, memory: memory[0],
    )


FLOWS = {
    "affine": (lambda g, m, now: (0.9 * m[0] + now.u[0], m[1] + 1), "lifted"),
    "affine by the time": (lambda g, m, now: (jnp.where(now.tick > 50, m[0], 0.5 * m[0]), m[1]), "lifted"),
    "a square": (lambda g, m, now: (m[0] * m[0], m[1]), "stepped"),
    "a bend": (lambda g, m, now: (jnp.where(m[0] > 0, m[0], 0.5 * m[0]), m[1]), "stepped"),
    "by a counter of its own": (lambda g, m, now: (jnp.where(m[1] > 50, m[0], 0.5 * m[0]), m[1] + 1), "stepped"),
    "a counter of what it finds": (lambda g, m, now: (m[0], m[1] + (m[0][0] > 0).astype(int)), "stepped"),
}


@pytest.mark.ci
@pytest.mark.parametrize("kind", FLOWS)
def test_an_observer_of_ones_own_is_lifted_where_its_flow_is_affine(kind):
    flow, way = FLOWS[kind]
    assert ways(own(flow)) == way


def test_a_plant_that_bends_lifts_nobody():
    layout, p = problem(CASE, {"kf": {}})
    bent = LINEAR._replace(step=lambda params, now, x: jnp.sin(x))
    with config.float64():
        assert jax.eval_shape(partial(every_map, layout._replace(plant=bent, lifted=ROOM)), p) == {}
        assert every_map(layout, p) == {}
        assert not affine_detection.plant_goes(layout._replace(plant=bent), p)
        assert not affine_detection.plant_goes(layout, p._replace(process_std=np.ones(3)))


def test_reach_looks_into_loops_and_branches():
    def f(a, b, c):
        looped = jax.lax.scan(lambda s, r: ((s[1], s[0] + r), s[1]), (a, b), jnp.ones(3))
        chosen = jax.lax.cond(c > 0, lambda a, b: (a + 1, b), lambda a, b: (a, a * a), a, b)
        return looped[0][0], looped[1], chosen, c, jax.jit(lambda x, y: x)(a, b)

    found, same = affine_detection.reach(f, 1.0, 2.0, 3.0)
    sets = [set(each) for each in jax.tree.leaves(found, is_leaf=lambda x: isinstance(x, frozenset))]
    assert sets == [{0, 1}, {0, 1}, {0, 2}, {0, 1, 2}, {2}, {0}]
    assert same[4]
    assert not any(same[:4])


def test_chunks_are_of_every_tick_once_and_of_no_two_events(monkeypatch):
    monkeypatch.setattr(matmul, "FEWEST", 0)
    _, p = problem(CASE, {"kf": {}})
    event = np.asarray(p.schedule.event)
    with config.float64():
        each = jax.tree.map(np.asarray, jax.jit(partial(matmul.chunks, room=ROOM))(p))
    ticks = [range(a, a + many) for a, many in zip(each.start, each.length, strict=True) if many]
    assert [k for some in ticks for k in some] == list(range(N - 1))
    edges = set(np.flatnonzero(event)) | set(p.windows[:, 0])
    assert not any(k in edges for some in ticks for k in some[1:])
    assert max(map(len, ticks)) <= matmul.TICKS
    assert [each.before[some[0]] for some in ticks] == list(range(len(ticks)))
    assert len(ticks) <= matmul.room(event, 3) % (ROOM + 1)


def test_dense_events_and_long_and_short_horizons_are_stepped():
    assert matmul.room(np.ones(10**4, bool), 3) == 0
    assert matmul.room(np.arange(matmul.FEWEST - 1) % 200 == 0, 3) == 0
    assert matmul.room(np.arange(matmul.FEWEST) % 200 == 0, 3) > 0
    assert matmul.room(np.arange(10**6) % 200 == 0, 3) == 0
    assert matmul.room(np.arange(10**4) % 200 == 0, 3) == 256


@pytest.mark.parametrize("own", [0, 2, matmul.FEW, matmul.FEW + 3])
def test_products_are_those_of_matrices_whether_written_out_or_not(own):
    rng = np.random.default_rng(own)
    M, fixed, z = rng.normal(size=(6, own)), rng.normal(size=6), rng.normal(size=(own, 5))
    with config.float64():
        found = matmul.of_lanes(*(jnp.asarray(a) for a in (M, fixed, z)))
    np.testing.assert_allclose(np.broadcast_to(found, (6, 5)), fixed[:, None] + M @ z, rtol=1e-13, atol=1e-14)


def test_maps_are_made_once_for_the_calls_of_a_cell_and_anew_for_the_next():
    _, p = problem(CASE, {"kf": {}})
    calls, other = [], p._replace(noise_std=p.noise_std * 2)
    maps = runner.MapsOfCell(lambda p: calls.append(p) or {"made": len(calls)})
    found = [maps(q)["made"] for q in (p, p, other, other, p)]
    assert found == [1, 1, 2, 2, 3]
    assert runner.MapsOfCell(None)(p) == {}


@pytest.mark.nightly
def test_a_call_leaves_the_same_with_maps_that_it_makes_itself():
    layout, p = problem(CASE, {o: {} for o in ("pccebo", "kf")})
    layout, p = layout._replace(lifted=ROOM, width=WIDTH, random_initial_state=True), jax.tree.map(np.asarray, p)
    job = runner.Job(p, 0, np.arange(WIDTH))
    with config.float64():
        made = next(runner.serial(runner.program(layout, job), [job]))[1]
        alone = jax.jit(partial(event_loop.simulate, layout))(p, np.asarray(0), np.arange(WIDTH))
    for a, b in zip(jax.tree.leaves(made), jax.tree.leaves(alone), strict=True):
        np.testing.assert_allclose(a, b, 1e-11, 1e-13 * np.abs(b).max(initial=0.0))
