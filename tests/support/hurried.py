"""Compiled in a hurry: in a third of the time, to run several times as long. For short runs whose numbers have a tolerance.

Where a test asks for bits or for what is in a program, it is the one that a user gets (`not_here`); in the slow tests all is
as a user has it.
"""

from contextlib import contextmanager
from functools import cache

import jax
import pytest

OPTIONS = {"xla_backend_optimization_level": 0, "xla_cpu_use_fusion_emitters": False}
LANES = 32  # of a call


@cache
def options():
    """Return those of OPTIONS that this release of jax knows."""
    return {name: value for name, value in OPTIONS.items() if _known({name: value})}


def flags():
    """Return the same for the environment of another process."""
    return " ".join(f"--{name}={str(value).lower()}" for name, value in options().items())


def _known(option):
    try:
        jax.jit(lambda x: -x).lower(0.0).compile(option)
    except jax.errors.JaxRuntimeError:
        return False
    return True


@cache
def recorder():
    """Return `trace.compiled()`, made in a hurry."""
    from pcbench.simulation import trajectory

    return jax.jit(trajectory.record, static_argnums=0, compiler_options=options())


@cache
def step_blocks():
    """Return `playback.step_block.jit_step_block()`, made in a hurry."""
    from pcbench.playback import step_block

    begun = jax.jit(step_block.init_run, static_argnums=(0, 2), compiler_options=options())
    return begun, jax.jit(step_block.run_block, static_argnums=0, compiler_options=options())


@contextmanager
def not_here():
    """Have the programs that a user has, until this is left."""
    from pcbench.engine import runner
    from pcbench.runtime import program_cache

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runner, "OPTIONS", {name: said for name, said in runner.OPTIONS.items() if name not in OPTIONS})
        patch.setattr(runner, "_PROGRAMS", program_cache.Programs())
        patch.delenv("XLA_FLAGS", raising=False)
        yield


@contextmanager
def programs():
    """Have calls of a few lanes, made in a hurry, until this is left; none of them is kept."""
    from pcbench.engine import runner
    from pcbench.moments import programs as of_moments
    from pcbench.runtime import program_cache

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(of_moments, "_PROGRAMS", program_cache.Programs())
        patch.setattr(runner, "WIDTH", LANES)
        patch.setattr(runner, "HEAVY_WIDTH", LANES)
        patch.setattr(runner, "OPTIONS", runner.OPTIONS | options())
        patch.setattr(runner, "_PROGRAMS", program_cache.Programs())
        yield
