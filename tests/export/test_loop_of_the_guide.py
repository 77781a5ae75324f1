"""The loop of the guide around exported code: compiled as it stands, it estimates what the simulation estimates."""

import subprocess

import exports
import pytest
from documents import blocks

from pcbench.export import files

HARDWARE = """
#include <math.h>
#include <stdio.h>
#include "kf.h"
#include "vector.h"

static long k = -1, e = 0;
static double worst = 0.0;

static int wait_for_tick(void)
{
    if (++k < TICKS)
        return 1;
    printf("%.17g", worst);
    return 0;
}

static int camera_arrived(kf_real *value, int64_t *age)
{
    for (; e < EVENTS && events[e].tick <= k; e++)
        if (events[e].what == 2) {
            *value = events[e].value[0];
            *age = events[e++].age[0];
            return 1;
        }
    return 0;
}

static void decide(const kf_real *xhat, kf_real *u)
{
    for (int i = 0; i < SIGNALS; i++)
        worst = fmax(worst, fabs(xhat[i] - expected[k][i]) / fmax(1.0, fabs(expected[k][i])));
    u[0] = inputs[k][0];
}
"""  # measurements of the exported run arrive at their ticks


@pytest.mark.ci
@pytest.mark.parametrize("late_and_lost", [False, True])
def test_estimates_are_those_of_the_simulation(late_and_lost, tmp_path):
    if files.compiler() is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    found = exports.of("kf", late_and_lost)
    (loop,) = blocks("c", "export_to_c.md")
    for name in ("kf.h", "kf.c", "kf_gains.h", "vector.h"):
        (tmp_path / name).write_text(found.files[name])
    (tmp_path / "hardware.h").write_text(HARDWARE)
    (tmp_path / "loop.c").write_text(loop)
    strict = ["cc", "-std=c99", "-pedantic-errors", "-Wall", "-Wno-unused", "-Werror", "-include", "hardware.h"]
    subprocess.run([*strict, "-o", "loop", "kf.c", "loop.c", "-lm"], cwd=tmp_path, check=True)
    printed = subprocess.run(["./loop"], cwd=tmp_path, capture_output=True, text=True, check=True).stdout
    assert float(printed) < 1e-12
