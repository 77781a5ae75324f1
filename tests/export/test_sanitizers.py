"""Exported observers under the address and undefined-behaviour sanitizers: no arrival makes C do what it does not define."""

import subprocess

import exports
import pytest

from pcbench.export import files
from pcbench.observers import OBSERVERS

EXPORTED = [name for name in OBSERVERS if name not in exports.REFUSED]
FLAGS = ["-std=c99", "-O0", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
QUICK = ("kf",)
HARNESS = """#include <stdio.h>
#include <stdlib.h>
#include "{label}.h"
#include "{label}_gains.h"
#define INPUTS {inputs}
#define OUTPUTS {outputs}
static uint64_t state = {seed}u;
static uint64_t draw(void)
{{
    state = state * 6364136223846793005u + 1442695040888963407u;
    return state >> 20;
}}
static double value(void)
{{
    static const double odd[] = {{0.0, -0.0, 1e300, -1e300, 1e-300, HUGE_VAL, NAN}};
    return draw() % 200 ? (double)(draw() % 2000) / 1000.0 - 1.0 : odd[draw() % 7];
}}
static int64_t age(int64_t k)
{{
    static const int64_t odd[] = {{INT64_MIN, INT64_MIN + 1, INT64_MAX, INT64_MAX - 1, -1, INT32_MIN, INT32_MAX, 1LL << 62}};
    switch (draw() % 4) {{
    case 0: return odd[draw() % 8];
    case 1: return k + (int64_t)(draw() % 5) - 2;
    case 2: return {oldest} + (int64_t)(draw() % 5) - 2;
    default: return (int64_t)(draw() % 30);
    }}
}}
int main(void)
{{
    long used = 0, refused = 0;
    for (int run = 0; run < {runs}; run++) {{
        {label}_memory *m = malloc(sizeof *m); /* so that what lies beside it is watched */
        {label}_now *now = malloc(sizeof *now);
        {label}_real x0[16] = {{0}}, u[INPUTS + 1], xhat[16], note[64] = {{0}};
        (void)note;
        {label}_begin(now);
        {label}_init(&{label}_nominal, x0, m);
        for (int64_t k = 0; k < {ticks}; k++) {{
{note}{sampled}            for (uint64_t i = draw() % 3; i; i--) {{
                {label}_arrival a = {{.ticks_since_arrival = age(k)}};
                for (int j = 0; j < OUTPUTS; j++) {{
                    a.value[j] = ({label}_real)value();
                    a.mask[j] = draw() % 4 != 0;
                    a.age[j] = age(k);
                    a.index[j] = age(k);
                }}
{carry}                if ({label}_jump(&{label}_nominal, m, now, &a)) refused++; else used++;
            }}
            {label}_estimate(&{label}_nominal, m, xhat);
            for (int j = 0; j < INPUTS; j++) u[j] = ({label}_real)value();
            {label}_hold(now, u);
            {label}_flow(&{label}_nominal, m, now);
            {label}_next(now);
        }}
        free(m);
        free(now);
    }}
    printf("%ld %ld\\n", used, refused);
    return 0;
}}
"""


def harness(found, ticks, runs, seed):
    """The program that feeds an exported observer arrivals of any age, order and value."""
    label, text = found.about.label, found.files[f"{found.about.label}.h"]
    note = f"            {label}_snapshot(&{label}_nominal, m, now, note);\n"
    sampled = (
        "            bool fresh[OUTPUTS];\n            for (int j = 0; j < OUTPUTS; j++) fresh[j] = draw() % 2;\n"
        f"            {label}_sampled(&{label}_nominal, m, now, fresh);\n"
    )
    carry = "                for (unsigned j = 0; j < sizeof a.snapshot / sizeof *a.snapshot; j++) a.snapshot[j] = note[j];\n"
    has = {name: f"{label}_{name}(" in text for name in ("snapshot", "sampled")}
    return HARNESS.format(
        label=label, inputs=found.about.inputs, outputs=found.about.outputs, seed=seed, oldest=found.about.oldest, ticks=ticks,
        runs=runs, note=note * has["snapshot"], sampled=sampled * has["sampled"], carry=carry * has["snapshot"],
    )  # fmt: skip


@pytest.mark.parametrize("name", [pytest.param(n, marks=() if n in QUICK else pytest.mark.ci) for n in EXPORTED])
def test_no_arrival_is_undefined_behaviour(name, tmp_path):
    """Ages beside the integer limits, NaN and infinite values, any order: it ends, and no sanitizer reports anything."""
    if files.compiler() is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    found = exports.of(name, wild=name not in exports.REGULAR)
    files.write(found, tmp_path)
    (tmp_path / "harness.c").write_text("#include <math.h>\n" + harness(found, ticks=300, runs=2, seed=1))
    label = found.about.label
    built = subprocess.run(
        [files.compiler(), *FLAGS, "harness.c", f"{label}.c", "-lm", "-o", "harness"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300,
    )  # fmt: skip
    assert built.returncode == 0, built.stderr
    ran = subprocess.run([tmp_path / "harness"], capture_output=True, text=True, timeout=120)
    assert ran.returncode == 0, ran.stderr[-2000:]
    used, refused = map(int, ran.stdout.split())
    assert used > 50
    assert refused > 50
