"""Programs that outlive their process: found again by what would be traced, and never by less."""

import os
import subprocess
import sys
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from pcbench.machine import process
from pcbench.simulation import compiling, events_shared, kept_programs, metrics
from pcbench.simulation.kept_programs import asked

OPTIONS = {"xla_cpu_multi_thread_eigen": False}


@pytest.fixture
def where(tmp_path, monkeypatch):
    """A cache of its own, as `setup` gives one."""
    monkeypatch.setenv("PCBENCH_CACHE", str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR", raising=False)
    kept = {
        name: getattr(jax.config, name)
        for name in ("jax_compilation_cache_dir", "jax_persistent_cache_min_compile_time_secs")
    }
    process.setup()
    yield kept_programs.folder()
    for name, value in kept.items():
        jax.config.update(name, value)


def test_nothing_is_kept_where_jax_keeps_its_own_elsewhere(tmp_path):
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", str(tmp_path))
    try:
        assert kept_programs.folder() is None
    finally:
        jax.config.update("jax_compilation_cache_dir", before)


def test_a_program_comes_back_with_its_bits(where):
    device = jax.devices()[0]
    made = jax.jit(lambda x: {"a": x * 1.1 + 0.3}).lower(np.arange(9.0)).compile(OPTIONS)
    kept_programs.keep(where, "text", "asked", made)
    assert kept_programs.known(where, "asked") == "text"
    back = kept_programs.load(where, "text", device)
    assert back(np.arange(9.0))["a"].tobytes() == made(np.arange(9.0))["a"].tobytes()
    assert kept_programs.known(where, "other") is None
    (where / "text.program").write_bytes(b"damaged")
    assert kept_programs.load(where, "text", device) is None


def test_what_is_asked_for_differs_with_functions_numbers_shapes_and_settings():
    """Functions of `simulation`: those of observers are wrapped here, to have their shapes checked."""
    name, a = partial(asked, device=None, options=OPTIONS), {"a": "float64(3,)"}
    one = name((metrics.update, 3), a)
    assert one == name((metrics.update, 3), {"a": "float64(3,)"})
    seen = [events_shared.where_any(p, metrics.update) for p in (1, 2)]  # closures
    others = [
        name((metrics.update, 4), a),
        name((metrics.look, 3), a),
        name((metrics.update, 3), {"a": "float64(4,)"}),
        name((metrics.update, 3), {"b": "float64(3,)"}),
        name((metrics.update, 3), {"a": partial(metrics.update, 1)}),
        *(name((each, 3), a) for each in seen),
        asked((metrics.update, 3), a, None, {}),
    ]
    with jax.numpy_dtype_promotion("strict"):
        others.append(name((metrics.update, 3), a))
    assert None not in others
    assert len({one, *others}) == len(others) + 1


def test_a_function_that_is_not_ours_has_no_name():
    """Its source is not in the digest, nor what it closes over."""

    def mine(x):
        return x

    for what in (mine, partial(mine, 1), np.sin, np.zeros(3), events_shared.where_any(1, mine)):
        assert asked((what,), {}, None, OPTIONS) is None
    mine.__module__, mine.__qualname__ = "pcbench.simulation.metrics", "update"
    assert asked((mine,), {}, None, OPTIONS) is None


def test_a_program_of_the_same_text_for_arguments_of_other_names_is_another(where):
    device, number = jax.devices()[0], jax.ShapeDtypeStruct((3,), float)

    def total(given):
        return sum(given.values())

    for name in ("dkf", "observer", "dkf"):
        made = compiling.compiled(total, lambda name=name: ({name: number},), device, None, None)
        assert np.asarray(made({name: np.arange(3.0)})).tolist() == [0.0, 1.0, 2.0]
    assert len(list(where.glob("*.program"))) == 2


def test_a_program_of_the_same_text_for_an_unused_argument_of_another_shape_is_another(where):
    device = jax.devices()[0]

    def first(a, unused):
        return a * 2.0

    for many in (2, 0, 2):
        given = (np.arange(3.0), np.zeros(many))
        made = compiling.compiled(first, lambda given=given: shapes(*given), device, None, None)
        assert np.asarray(made(*given)).tolist() == [0.0, 2.0, 4.0]
    assert len(list(where.glob("*.program"))) == 2


def test_a_program_of_the_same_text_for_a_function_that_is_not_equal_is_compiled_again(where):
    """`functools.partial` compares identities: a copy from another process is another argument."""
    device, x = jax.devices()[0], np.arange(3.0)

    def apply(function):
        return function.args[0] * 2.0

    for _ in range(2):
        given = jax.tree_util.Partial(partial(np.multiply, 3.0), x)
        kinds = jax.tree_util.Partial(given.func, *shapes(x))
        made = compiling.compiled(apply, lambda kinds=kinds: (kinds,), device, None, None)
        assert np.asarray(made(given)).tolist() == [0.0, 2.0, 4.0]


def test_a_plants_function_is_equal_to_its_copy_and_to_no_other_plants():
    import pickle
    from dataclasses import replace

    from pcbench.plants.nonlinear import Equations, PlantFunction

    one = PlantFunction(metrics.update, Equations(None, metrics.look, metrics.look, 0.1, tuple, (), (), (0.0,), (), ()))
    copy = pickle.loads(pickle.dumps(one))
    assert copy is not one
    assert (copy, hash(copy)) == (one, hash(one))
    assert copy != replace(one, equations=one.equations._replace(tick=0.2))


def shapes(*arrays):
    place = jax.sharding.SingleDeviceSharding(jax.devices()[0])
    return tuple(jax.ShapeDtypeStruct(np.shape(a), np.asarray(a).dtype, sharding=place) for a in arrays)


@pytest.mark.parametrize(
    ("what", "stays"),
    [(lambda A: A @ A.T, True), (jnp.linalg.cholesky, False), (lambda A: jnp.linalg.solve(A, A[0]), False)],
    ids=["product", "cholesky", "solve"],
)
def test_what_calls_lapack_is_not_kept(where, what, stays):
    """Loaded by a process that has not traced it, it ended that process: LAPACK is looked up while tracing."""
    A = np.eye(3) * 2.0

    def mine(A):
        return what(A)

    made = compiling.compiled(mine, lambda: shapes(A), jax.devices()[0], OPTIONS, "asked")
    assert kept_programs.whole(jax.jit(mine).lower(A).as_text()) is stays
    assert (kept_programs.known(where, "asked") is not None) is stays
    assert bool(list(where.glob("*.program"))) is stays
    np.testing.assert_allclose(made(A), what(A), rtol=1e-15)


@pytest.mark.nightly
@pytest.mark.parametrize("way", ["run", "exact"])
def test_a_second_process_runs_what_calls_lapack(way, tmp_path):
    """`oosm-lag` inverts a covariance at a jump, a study with `consistency` solves for it."""
    (tmp_path / "again.py").write_text(AGAIN)
    said = [
        subprocess.run(
            [sys.executable, tmp_path / "again.py", way], env=os.environ | {"PCBENCH_CACHE": str(tmp_path / "cache")},
            check=True, capture_output=True, text=True, timeout=300,
        ).stdout
        for _ in range(2)
    ]  # fmt: skip
    assert said[0] == said[1] != ""


AGAIN = """
import sys
import pcbench
pcbench.setup()
study = {
    "name": "again", "observers": ["oosm-lag"], "options": {"scenario": {"random_start": True, "consistency": True}},
    "lti": {
        "A": [[-0.5]], "B": [[1.0]], "C": [[1.0]], "x0": [1.0], "xhat0": [0.5], "prior_std": [0.3], "tick": 0.1, "horizon": 3.0,
        "tail": 1.0, "noise_std": 0.3, "sampling_period": 0.4, "delay": 0.2, "states": ["a"], "input": "sine",
    },
}
found = pcbench.exact(study) if sys.argv[1] == "exact" else pcbench.run(study, seeds=8)
print(found.stats[found.stats.metric.isin(["mse", "nees"])]["mean"].to_list())
"""
