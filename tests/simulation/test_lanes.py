"""`over(f)` is `vmap(f)` with lanes last, for whatever a one-lane function may do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax import lax

from pcbench import planning, protocols
from pcbench.engine import event_loop, interpreter, jaxpr_compat, lane_array, lane_forms, packing, runner
from pcbench.engine.interpreter import vmap_entrywise
from pcbench.errors import UserError
from pcbench.protocols import vmap_as_unit
from pcbench.study import parse

L, RNG = 5, np.random.default_rng(0)
M = RNG.normal(size=(3, 3))
BIG = RNG.normal(size=(12, 12))


def ring_of(x, A):
    """Rows written and read at indices that all lanes share, by loop and by hand, and as a whole afterwards."""
    ring = jnp.zeros((5, 3)).at[1].set(1.0)

    def step(i, ring):
        old = lax.dynamic_index_in_dim(ring, (i + 3) % 5, 0, False)
        return lax.dynamic_update_index_in_dim(ring, A @ x + 0.5 * old + i, (i * 2) % 5, 0)

    ring = step(2, step(1, step(0, ring)))
    total = lax.scan(lambda total, row: (total + row @ x, total), 0.0, ring)[0]
    return ring[4] + ring[0] * total + lax.dynamic_index_in_dim(ring, 2, 0, False)


FUNCTIONS = {
    "matrix": lambda x, A: A @ x + M @ x,
    "product of lanes": lambda x, A: A @ jnp.outer(x, x) @ A.T + A.T,
    "large product": lambda x, A: (BIG @ jnp.tile(x, 4))[:3] * A[0],
    "structure": lambda x, A: jnp.concatenate([x[::-1], A.reshape(-1)[2:5], jnp.ones(1)])[jnp.array([0, 3, 2])],
    "parts": lambda x, A: jnp.stack([jnp.split(jnp.tile(jnp.pad(x, (1, 2)), 2), 4)[1], A[1]], 1) @ x[:2],
    "reductions": lambda x, A: jnp.stack([jnp.sum(A), jnp.max(x), jnp.prod(x), jnp.where(jnp.all(x < 9), 1.0, 0.0)]),
    "choice": lambda x, A: jnp.where(x > 0, jnp.sin(x), A[1]) + jnp.where(True, x, A[0]),
    "linear algebra": lambda x, A: jnp.linalg.solve(A + 9 * jnp.eye(3), x),
    "loop": lambda x, A: lax.fori_loop(0, 4, lambda i, y: jnp.cos(A @ y) + i, x),
    "while, all leave together": lambda x, A: lax.fori_loop(
        0, jnp.argmax(BIG[0, :3]) + 2, lambda i, y: jnp.cos(A @ y) + i * x, x
    ),
    "while, each leaves by itself": lambda x, A: lax.while_loop(
        lambda y: y[0] < 3, lambda y: y + jnp.abs(A @ x) + 1, x
    ),
    "branch": lambda x, A: lax.cond(x[0] > 0, lambda y: A @ y, lambda y: y - 1, x),
    "jitted": lambda x, A: jax.jit(lambda y: jnp.clip(y, -0.5, 0.5) ** 3)(x) + A[2],
    "einsum": lambda x, A: jnp.einsum("ij,jk,k->i", A, A, x),
    "entry of a table": lambda x, A: lax.dynamic_index_in_dim(BIG, jnp.abs(4 * x[0]).astype(int), 0, False)[:3] * A[0],
    "rows of a table": lambda x, A: (
        jnp.take(BIG[:, :6].reshape(12, 2, 3), jnp.abs(4 * x[:2]).astype(int), 0, mode="clip")[1, 1] * A[0]
    ),
    "rows of an own table": lambda x, A: jnp.take(A, jnp.abs(x[:2]).astype(int), 0, mode="clip")[1],
    "one row, shared": lambda x, A: lax.dynamic_index_in_dim(A, jnp.argmax(BIG[0, :3]), 0, False) * x,
    "a ring": lambda x, A: ring_of(x, A),
    "own entry": lambda x, A: lax.dynamic_index_in_dim(A, jnp.abs(x[0]).astype(int), 0, False) * x,
    "scan with rows": lambda x, A: jnp.concatenate(
        [
            lax.scan(lambda c, r: (c + r @ x, (r, c)), 0.0, A)[1][0][1],
            lax.scan(lambda c, r: (c * r[0] + 1, c[0]), x, A)[1],
        ]
    ),
    "in one piece": lambda x, A: vmap_as_unit(lambda y: jnp.linalg.solve(A + 9 * jnp.eye(3), y) + x[0])(x) + A[1],
    "in one piece, many rows": lambda x, A: vmap_as_unit(lambda y: y[:40] * A[0, 0])(
        vmap_as_unit(lambda x: jnp.outer(jnp.arange(50.0), x) + 2 * A[:1])(x)
    )[7:9],
    "in one piece, many numbers": lambda x, A: vmap_as_unit(lambda y: jnp.cumsum(y) * A[1, 2])(
        vmap_as_unit(lambda x: jnp.arange(40.0) * x[1])(x)
    )[7:9],
    "scan that leaves a ring at every step": lambda x, A: lax.scan(
        lambda ring, r: (lax.dynamic_update_index_in_dim(ring, r @ x + ring[1], 1, 0), ring), jnp.zeros((4, 1)), A
    )[1][2, :3, 0],
    "transposed": lambda x, A: A.T @ x - jnp.trace(A),
}


@pytest.mark.ci
@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("shared", [False, True], ids=["both differ", "matrix shared"])
def test_over_equals_vmap(name, shared):
    f, x = FUNCTIONS[name], jnp.asarray(RNG.normal(size=(3, L)))
    A = jnp.asarray(RNG.normal(size=(3, 3) if shared else (3, 3, L)))
    got = jax.jit(
        lambda x, A: lane_array.join(vmap_entrywise(f)(lane_array.split(x), A if shared else lane_array.split(A)))
    )(x, A)
    want = jax.vmap(f, (-1, None if shared else -1), -1)(x, A)
    np.testing.assert_allclose(got, want, rtol=1e-13, atol=1e-13)


def forms_of_the_program_and_of_its_numbers(f, *given):
    """What is read from the program, and what is found where it is evaluated."""
    closed, forms, _ = lane_forms.trace_lane(f, *given)
    found = jax.eval_shape(vmap_entrywise(f), *given)
    leaves = jax.tree.leaves(found, is_leaf=lane_array.is_lanes)
    return lane_forms.forms_of(closed, forms), list(map(lane_array.form_of, leaves))


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("shared", [False, True], ids=["both differ", "matrix shared"])
def test_forms_are_those_of_the_numbers(name, shared):
    x, A = jnp.asarray(RNG.normal(size=(3, L))), jnp.asarray(RNG.normal(size=(3, 3) if shared else (3, 3, L)))
    given = lane_array.split(x), A if shared else lane_array.split(A)
    read, found = forms_of_the_program_and_of_its_numbers(lambda x, A: (FUNCTIONS[name](x, A), A, 2 * M, x), *given)
    assert read == found


def test_lanes_without_numbers_have_none_in_their_forms_either():
    empty = lambda x: (x[:0], jnp.sin(x[:0]), jnp.append(x[:0], x[1]))  # noqa: E731
    read, found = forms_of_the_program_and_of_its_numbers(empty, lane_array.split(jnp.ones((2, L))))
    assert read == found == [lane_array.SAME, lane_array.SAME, lane_array.ENTRIES]


@pytest.mark.parametrize("axes", [0, 1, 2, (0, 2), (2, 1), (0, 1, 2)])
@pytest.mark.parametrize("fold", [jnp.sum, jnp.prod, jnp.max, jnp.min, jnp.any, jnp.all])
def test_folds_go_over_the_axes_that_are_named(fold, axes):
    """No two axes of one length, so that a fold over others has another shape or other entries."""
    x = RNG.normal(size=(2, 3, 4, L))
    x = x > 0.3 if fold in (jnp.any, jnp.all) else x
    got = vmap_entrywise(lambda a: fold(a, axis=axes))(lane_array.split(jnp.asarray(x)))
    want = getattr(np, fold.__name__)(x, axis=axes)
    np.testing.assert_allclose(np.asarray(lane_array.join(got), float), want.astype(float), rtol=1e-13)


class Tree:
    """A scan's operands as jax has them from 0.11 on: parts that can be gone over, and no more is asked of them."""

    def __init__(self, *parts):
        self.parts = parts

    def unpack(self):
        return tuple(iter(part) for part in self.parts)


def in_form(form, params):
    """The parameters of a scan as another release of jax has them."""
    consts, carry = jaxpr_compat.scan(params)[1:3]
    rest = {k: v for k, v in params.items() if k not in ("num_consts", "num_carry", "ft_in", "ft_out")}
    rows = len(params["jaxpr"].in_avals) - consts - carry
    said = {"ft_in": Tree(*([None] * n for n in (consts, carry, rows))), "ft_out": Tree([None] * carry, ())}
    return rest | (said if form == "trees" else {"num_consts": consts, "num_carry": carry})


@pytest.mark.ci
@pytest.mark.parametrize("form", ["counts", "trees"])
@pytest.mark.parametrize("name", ["scan with rows", "a ring", "loop"])
def test_a_scan_is_read_in_the_form_of_any_release_of_jax(name, form):
    """Up to 0.10 constants and carries are counted, from 0.11 on they are parts of a tree."""
    f, x, A = FUNCTIONS[name], jnp.asarray(RNG.normal(size=(3, L))), jnp.asarray(RNG.normal(size=(3, 3, L)))
    closed = jax.make_jaxpr(f)(x[..., 0], A[..., 0])
    eqns = [e.replace(params=in_form(form, e.params)) if e.primitive.name == "scan" else e for e in closed.jaxpr.eqns]
    assert any(e.primitive.name == "scan" for e in eqns)
    (got,) = interpreter._evaluate(
        closed.jaxpr.replace(eqns=eqns), closed.consts, [lane_array.split(x), lane_array.split(A)]
    )
    np.testing.assert_allclose(lane_array.join(got), jax.vmap(f, (-1, -1), -1)(x, A), rtol=1e-13, atol=1e-13)


def test_a_scan_of_no_known_form_is_one_sentence():
    with pytest.raises(UserError, match=r"got a scan with the parameters jaxpr, length, .*install that"):
        jaxpr_compat.scan({"jaxpr": None, "length": 3})


@pytest.mark.parametrize("index", [0, 1])
@pytest.mark.parametrize("differs", [False, True], ids=["common", "of each lane"])
def test_a_choice_equals_vmap_and_stays_one_if_it_is_common(index, differs):
    """A branch may return what is common to all lanes where the other does not."""

    def choose(i, x):
        return lax.cond(i == 1, lambda: (x + 1, jnp.ones(3), 2 * i), lambda: (2 * x, x, 3 * i))

    x, i = jnp.asarray(RNG.normal(size=(3, L))), jnp.asarray([(index + k) % 2 for k in range(L)] if differs else index)
    given = lane_array.split(i.reshape(1, L)) if differs else i
    f = (lambda i, x: choose(i[0], x)) if differs else choose
    read, found = forms_of_the_program_and_of_its_numbers(f, given, lane_array.split(x))
    got = vmap_entrywise(f)(given, lane_array.split(x))
    want = jax.vmap(choose, (0 if differs else None, -1), -1)(i, x)
    for a, b in zip(got, want, strict=True):
        a = lane_array.join(a) if lane_array.is_lanes(a) else jnp.broadcast_to(a[..., None], b.shape)
        np.testing.assert_array_equal(a, b)
    assert read == found
    assert (found[2] == lane_array.SAME) == (not differs)


# linear algebra, and products with more than kernels.MOST_PRODUCTS terms
WITHOUT_RULE = {"custom_linear_solve", "dot_general", "dynamic_slice", "eigh", "gather", "lu"}
STUDIES = {  # with changes
    "cart": {},
    "unequal-delays": {},
    "helicopter": {"observers": ["high-gain", "ekf"]},
    "unknown-input": {},
    "quadruple-tank": {},
    "camera-target": {},
    "growth-model": {},
}


@pytest.mark.ci
@pytest.mark.parametrize("study", STUDIES)
def test_every_primitive_of_plants_and_observers_has_a_rule(study, monkeypatch):
    """jax 0.10.2 replaced the concatenation in `jnp.stack` by a primitive of its own, and every tick took twice as long."""
    names, fallback = set(), interpreter._fallback
    monkeypatch.setattr(interpreter, "_fallback", lambda *a: names.add(a[1].primitive.name) or fallback(*a))
    for p in {p.layout: p for p in planning.plan(parse.grid_of(study, STUDIES[study], []).study)}.values():
        args = runner.arguments(runner.Job(p.problem, 0, np.arange(2)), p.layout.width)
        jax.make_jaxpr(lambda *a, layout=p.layout: event_loop.simulate(layout, *a[:3]))(*args)
    assert names <= WITHOUT_RULE


def test_a_primitive_without_a_rule_is_logged_once_by_name(caplog):
    interpreter._log_fallback.cache_clear()
    with caplog.at_level("INFO"):
        for _ in range(2):
            vmap_entrywise(jnp.sort)(lane_array.split(jnp.asarray(RNG.normal(size=(3, L)))))
    assert caplog.messages.count("sort has no rule here: it is applied by vmap") == 1


def test_what_does_not_depend_on_a_lane_is_computed_once():
    out = vmap_entrywise(lambda x, y: (x * 2, y + 1))(lane_array.split(jnp.ones((2, L))), jnp.zeros(3))
    assert lane_array.is_lanes(out[0])
    assert not lane_array.is_lanes(out[1])
    assert out[1].shape == (3,)


def test_a_state_spreads_by_what_becomes_different_and_by_nothing_else():
    v = lane_array.split(jnp.ones((2, L)))
    step = lambda a, b, c, v: (a + v, b + a.sum(), c * 2)  # noqa: E731
    closed, _, _ = lane_forms.trace_lane(step, jnp.zeros(2), jnp.zeros(()), jnp.ones(4), v)
    forms = lane_forms.fixed_point(
        lambda f: lane_forms.forms_of(closed, [*f, lane_array.ENTRIES]), [lane_array.SAME] * 3
    )
    assert forms == [lane_array.ENTRIES, lane_array.ENTRIES, lane_array.SAME], (
        "b depends on a only from the second step on"
    )


def test_split_and_join_are_inverse():
    x = jnp.arange(24.0).reshape(2, 3, 4)
    np.testing.assert_array_equal(lane_array.join(lane_array.split(x)), x)


@pytest.mark.ci
def test_a_table_keeps_its_rows_together_and_is_the_same_array():
    x = jnp.arange(24.0).reshape(3, 2, 4)
    whole = lane_array.table(lane_array.split(x))
    assert (whole.rows, whole.parts.shape, whole.shape) == (3, (2,), (3, 2))
    np.testing.assert_array_equal(lane_array.join(whole), x)
    np.testing.assert_array_equal(lane_array.join(lane_array.pick(whole, jnp.array([2, 0]))), x[..., jnp.array([2, 0])])
    back = lane_array.put_back(whole, lane_array.pick(whole, jnp.array([1])), jnp.array([3]))
    np.testing.assert_array_equal(lane_array.join(back)[..., 3], x[..., 1])


def test_a_packed_memory_with_a_table_is_the_memory():
    memory = {
        "ring": lane_array.table(lane_array.split(jnp.arange(24.0).reshape(3, 2, 4))),
        "flag": lane_array.split(jnp.ones((2, 4), bool)),
        "moved": lane_array.split(jnp.zeros((1, 4))),
    }
    form = packing.find_packing(lambda m: m | {"moved": vmap_entrywise(lambda v: v + 1)(m["moved"])}, memory)
    back = form.unpack(form.pack(memory))
    assert back["ring"].rows == 3
    for name in memory:
        np.testing.assert_array_equal(lane_array.join(back[name]), lane_array.join(memory[name]))


def test_a_packed_memory_keeps_the_kind_and_the_place_of_every_entry():
    """A table with other entries before and behind it, whole numbers, truth values; what moves is kept as it is."""
    memory = {
        "a": lane_array.split(jnp.arange(8).reshape(2, 4)),
        "b": lane_array.table(lane_array.split(jnp.arange(24.0).reshape(3, 2, 4) + 100)),
        "c": lane_array.split(jnp.array([[True, False, True, True], [False, True, False, False]])),
        "d": lane_array.split(jnp.arange(4.0).reshape(1, 4) - 50),
        "moved": lane_array.split(jnp.zeros((1, 4))),
    }
    form = packing.find_packing(lambda m: m | {"moved": vmap_entrywise(lambda v: v + 1)(m["moved"])}, memory)
    kept = form.pack(memory)
    assert kept.matrix.shape == (2 + 6 + 2 + 1, 4)
    assert len(kept.leaves) == 1
    back = form.unpack(kept)
    for name, entry in memory.items():
        assert (back[name].dtype, back[name].shape, back[name].rows) == (entry.dtype, entry.shape, entry.rows), name
        np.testing.assert_array_equal(lane_array.join(back[name]), lane_array.join(entry))


@pytest.mark.ci
@pytest.mark.parametrize("mode", ["fill", "clip", "wrap"])
def test_rows_from_beyond_a_table_are_what_their_gather_says(mode):
    index = jnp.array([[0, 5, 11, 12, 30], [-1, 3, 40, -20, 2]])
    got = vmap_entrywise(lambda i: jnp.take(jnp.asarray(BIG), i, 0, mode=mode))(lane_array.split(index))
    want = jax.vmap(lambda i: jnp.take(jnp.asarray(BIG), i, 0, mode=mode), -1, -1)(index)
    np.testing.assert_array_equal(lane_array.join(got), want)


@pytest.mark.ci
def test_in_one_piece_what_is_the_same_in_all_lanes_stays_so_and_many_rows_lie_together():
    f = vmap_as_unit(lambda x, k: (jnp.outer(jnp.arange(50.0), x), k + 1, x + k))
    found = vmap_entrywise(f)(lane_array.split(jnp.ones((3, L))), jnp.asarray(4))
    assert [lane_array.is_lanes(each) for each in found] == [True, False, True]
    assert (found[0].rows, found[0].parts.shape) == (50, (3,))
    assert (found[1], found[2].rows) == (5, None)
    assert found[0].parts[1].shape == (50, L)


def test_a_function_of_a_user_called_together_is_one_like_any_other(monkeypatch):
    @jax.jit
    def together(x):
        return x * 2.0

    def refused(*given):
        raise AssertionError

    x = lane_array.split(jnp.ones((3, L)))
    monkeypatch.setattr(interpreter, "_apply_vmap", refused)
    np.testing.assert_array_equal(lane_array.join(vmap_entrywise(together)(x)), 2 * np.ones((3, L)))
    with pytest.raises(AssertionError):
        vmap_entrywise(protocols.vmap_as_unit(lambda x: x * 2.0))(x)


def test_numbers_among_the_results_are_arrays_of_their_type():
    """A newer jax keeps them as numbers of Python in the jaxpr."""
    found = vmap_entrywise(lambda x: (x[0], True, 2.0, 3))(lane_array.split(jnp.ones((2, L))))
    assert [np.asarray(x).dtype for x in found[1:]] == [bool, float, jnp.asarray(3).dtype]
    assert all(isinstance(x, np.ndarray | jax.Array) for x in found[1:])
