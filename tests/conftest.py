"""Strict modes for the whole suite: float64, two CPU devices, checked shapes, and gains solved anew."""

import os
import shutil
import tempfile
from pathlib import Path

os.environ.setdefault("JAX_NUM_CPU_DEVICES", "2")
os.environ["PCBENCH_CACHE"] = str(Path(tempfile.gettempdir()) / f"pcbench-tests-{os.getuid()}-{os.getppid()}")

import jax
import pytest
from hypothesis import settings
from jaxtyping import install_import_hook

jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_rank_promotion", "raise")
jax.config.update("jax_compilation_cache_dir", os.environ["PCBENCH_CACHE"] + "/programs")
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.2)

settings.register_profile("house", deadline=None)  # a machine under load is no failure
settings.load_profile("house")
SHAPED = ["dynamics.integrate", "plants", "observers", "controllers", "synthesis", "simulation.actuator"]
install_import_hook([f"pcbench.{name}" for name in SHAPED], "shapes.checked")


@pytest.fixture(scope="session")
def whole(tmp_path_factory):
    """The small study as an undisturbed run leaves it, in blocks of 16 seeds."""
    from small_study import STUDY

    import pcbench

    out = tmp_path_factory.mktemp("whole") / "out"
    pcbench.run(STUDY, out=out, block=16)
    return out


@pytest.fixture
def copy(whole, tmp_path):
    """The same, to be spoilt."""
    return shutil.copytree(whole, tmp_path / "copy")
