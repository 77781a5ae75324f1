"""Strict modes for the whole suite: float64, two CPU devices, checked shapes, and gains solved anew."""

import os
import shutil
import tempfile
from contextlib import nullcontext
from pathlib import Path

os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ["PCBENCH_CACHE"] = os.environ.get("PCBENCH_TESTS_CACHE") or str(  # the first: shared with other runs
    Path(tempfile.gettempdir()) / f"pcbench-tests-{os.getuid()}-{os.getppid()}"
)

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

os.makedirs(os.environ["PCBENCH_CACHE"], mode=0o700, exist_ok=True)  # jax would make it as the umask says
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", os.environ["PCBENCH_CACHE"] + "/jax")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

settings.register_profile("house", deadline=None)  # a machine under load is no failure
settings.load_profile("house")
SHAPED = ["dynamics.integrate", "plants", "observers", "controllers", "synthesis", "simulation.command_network"]
# Checks take a fifth to a half of the time of a test, so .ci/run leaves them out where the same functions are called again.
if os.environ.get("PCBENCH_TESTS_SHAPES") != "0":
    install_import_hook([f"pcbench.{name}" for name in SHAPED], "shapes.check_types")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark nightly tests as slow, so that the default run leaves them out as well."""
    for item in items:
        if item.get_closest_marker("nightly"):
            item.add_marker("slow")


PERMITTED_SKIPS = (  # in CI, by the reason that they give; any other skipped test is a failure there
    "only root may mount",
    "no mount here",
)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item, call):
    """Turn a skipped test into a failure in CI, where every tool that a test needs is installed."""
    report = yield
    skipped = report.skipped and not hasattr(report, "wasxfail")
    if skipped and os.environ.get("CI") and not any(reason in str(report.longrepr) for reason in PERMITTED_SKIPS):
        report.outcome = "failed"
        report.longrepr = f"skipped in CI, where it must run: {report.longrepr}"
    return report


def in_a_hurry_here(request):
    """Whether no slow test is asked for."""
    return "not slow" in request.config.option.markexpr


@pytest.fixture(scope="session", autouse=True)
def _in_a_hurry(request):
    """Compile everything in a hurry, in other processes too, but for the slow tests, which have it as a user has.

    A test that asks for bits, or for what is in a program, asks for `as_users_have_it`.
    """
    import hurried

    from pcbench.engine import runner
    from pcbench.playback import step_block
    from pcbench.simulation import trajectory

    with pytest.MonkeyPatch.context() as patch:
        if in_a_hurry_here(request):
            patch.setattr(trajectory, "jit_record", hurried.recorder)
            patch.setattr(step_block, "jit_step_block", hurried.step_blocks)
            patch.setattr(runner, "OPTIONS", runner.OPTIONS | hurried.options())
            patch.setenv("XLA_FLAGS", hurried.flags())
        yield


MAPPINGS = 20_000  # of memory, of the 65,530 that Linux allows a process; beyond, the compiler crashes


@pytest.fixture(scope="module", autouse=True)
def _few_mappings():
    """Drop jax's compiled programs after a module where the process has many: each small one has 14 mappings."""
    yield
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > MAPPINGS:
        jax.clear_caches()


@pytest.fixture(scope="session", autouse=True)
def _no_kept_tunings():
    """Tune whatever is to be tuned, instead of finding it in the cache; the test of the cache asks for it again."""
    from pcbench.gains import history

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(history, "copy_from_cache", lambda *_: None)
        yield


@pytest.fixture(scope="session", autouse=True)
def _no_stored_programs():
    """Trace every program: a test may have replaced a function. Tests of the store ask for it again."""
    from pcbench.runtime import program_store

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(program_store, "allow", lambda: None)
        yield


@pytest.fixture(scope="module")
def as_users_have_it():
    """Have batches compiled as a user has them, where a module asks for it."""
    import hurried

    with hurried.not_here():
        yield


@pytest.fixture(scope="module")
def in_a_hurry(request):
    """Have batches of a few lanes too, where a module asks for it; the slow tests have them as a user has."""
    import hurried

    with hurried.programs() if in_a_hurry_here(request) else nullcontext():
        yield


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The small study as an undisturbed run leaves it, in blocks of 16 seeds."""
    from small_study import STUDY

    import pcbench

    out = tmp_path_factory.mktemp("whole") / "out"
    pcbench.run(STUDY, out=out, block_size=16)
    return out


@pytest.fixture
def copy(whole, tmp_path):
    """The same, to be spoilt."""
    return shutil.copytree(whole, tmp_path / "copy")
