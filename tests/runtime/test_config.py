"""Flags of the compiler: from jax 0.11 on no product and sum in one operation, on x86."""

import jax
import pytest

from pcbench.runtime import config


@pytest.mark.parametrize(
    ("version", "machine", "flags", "wanted"),
    [
        ((0, 12, 0), "x86_64", "", "--xla_cpu_max_isa=AVX"),
        ((0, 11, 1), "AMD64", "--xla_dump_to=a", "--xla_dump_to=a --xla_cpu_max_isa=AVX"),
        ((0, 12, 0), "x86_64", "--xla_cpu_max_isa=AVX512", "--xla_cpu_max_isa=AVX512"),
        ((0, 12, 0), "arm64", "", ""),
        ((0, 10, 2), "x86_64", "", ""),
    ],
)
def test_flags_leave_out_fma_if_bits_would_depend_on_it(version, machine, flags, wanted, monkeypatch):
    monkeypatch.setattr(jax, "__version_info__", version)
    monkeypatch.setattr(config, "machine", lambda: machine)
    assert config.without_fma(flags) == wanted
