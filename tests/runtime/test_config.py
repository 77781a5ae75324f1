"""Flags of the compiler: to jax 0.10 several results in one loop."""

import jax
import pytest

from pcbench.runtime import config

WANTED = "--xla_backend_extra_options=xla_cpu_use_multi_output_fusion"


@pytest.mark.parametrize(
    ("version", "flags", "wanted"),
    [
        ((0, 10, 2), "", WANTED),
        ((0, 10, 1), "--a=1", f"--a=1 {WANTED}"),
        ((0, 10, 2), "--xla_backend_extra_options=a", "--xla_backend_extra_options=a"),
        ((0, 12, 0), "", ""),
        ((0, 11, 1), "--a=1", "--a=1"),
    ],
)
def test_flags_follow_the_version_and_keep_what_is_set(version, flags, wanted, monkeypatch):
    monkeypatch.setattr(jax, "__version_info__", version)
    assert config.compiler_flags(flags) == wanted
