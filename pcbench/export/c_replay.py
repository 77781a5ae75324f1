"""The test vector in C, and the program that replays it and prints its difference from the simulation, by signal."""

import numpy as np
from numpy.typing import ArrayLike

from pcbench.export import c_files
from pcbench.export.c_files import About, without_casts
from pcbench.export.observer_to_c import Source
from pcbench.export.structs import RecordedRun
from pcbench.export.terms import as_c, number_entries

MAIN = """/* Replays the run of vector.h and prints how far the estimates are from those of the simulation.
   With the argument `estimates` it prints them instead, a line a tick. */
#include <math.h>
#include <stdio.h>
#include "{label}.h"
#include "{label}_gains.h"
#include "vector.h"

#ifdef OBSERVER_COUNT
extern long {label}_products;
#else
static long {label}_products = 0;
#endif
static {label}_real snapshots[RING][SNAPSHOT_SIZE];

int main(int argc, char **argv)
{{
    static {label}_memory memory;
    static {label}_now now;
    double largest[SIGNALS] = {{0}}, square[SIGNALS] = {{0}}, error[SIGNALS] = {{0}};
    long known[SIGNALS] = {{0}}, refused = 0;
    long sample[3] = {{0}}, tick = 0, e = 0; /* products: of a snapshot, of telling, of a jump */
    (void)argv;
    {label}_begin(&now);
{before}    {label}_init(&{label}_nominal, first, &memory);
    for (long k = 0; k < TICKS; k++) {{
        long start;
        for (; e < EVENTS && events[e].tick <= k; e++) {{
            const event *v = &events[e];
            start = {label}_products;
{snapshot}{sampled}            if (v->what == 2) {{
                {label}_arrival a;
                for (int j = 0; j < OUTPUTS; j++) {{
                    a.value[j] = ({label}_real)v->value[j];
                    a.mask[j] = v->mask[j];
                    a.age[j] = v->age[j];
                    a.index[j] = v->index[j];
                }}
{carry}                a.ticks_since_arrival = v->ticks_since_arrival;
                refused += {label}_jump(&{label}_nominal, &memory, &now, &a);
            }}
            sample[v->what] = {label}_products - start;
        }}
        {label}_real xhat[SIGNALS];
        start = {label}_products;
        {label}_estimate(&{label}_nominal, &memory, xhat);
        for (int i = 0; i < SIGNALS; i++) {{
            double off = fabs((double)xhat[i] - expected[k][i]), wrong = (double)xhat[i] - truth[k][i];
            largest[i] = off <= largest[i] ? largest[i] : off;
            square[i] += off * off;
            if (!isnan(wrong) || isnan((double)xhat[i])) {{
                error[i] += wrong * wrong;
                known[i]++;
            }}
            if (argc > 1) {{
                printf("%.17g%c", (double)xhat[i], i < SIGNALS - 1 ? ' ' : '\\n');
            }}
        }}
        {label}_real u[INPUTS];
        for (int i = 0; i < INPUTS; i++) {{
            u[i] = ({label}_real)inputs[k][i];
        }}
        {label}_hold(&now, u);
        {label}_flow(&{label}_nominal, &memory, &now);
        tick = {label}_products - start;
        {label}_next(&now);
    }}
    for (int i = 0; i < SIGNALS && argc < 2; i++) {{
        printf("%s: differs by %.3g rms, %.3g at most; error %.6g rms\\n", names[i], sqrt(square[i] / TICKS), largest[i],
               known[i] ? sqrt(error[i] / known[i]) : (double)NAN);
    }}
    if (argc < 2) {{
        printf("bytes: %lu memory, %lu gains, %lu inputs and times", (unsigned long)sizeof memory,
               (unsigned long)sizeof {label}_nominal, (unsigned long)sizeof now);
        if ({label}_products) {{
            printf("; multiplications: %ld for the last sample, %ld per tick", sample[0] + sample[1] + sample[2], tick);
        }}
        printf("\\n");
    }}
    if (refused) {{
        fprintf(stderr, "%ld measurements are older than the room of {label}\\n", refused);
    }}
    return refused > 0;
}}
"""
SNAPSHOT = """            if (v->what == 0) {{
                {label}_snapshot(&{label}_nominal, &memory, &now, snapshots[v->packet % RING]);
            }}
"""
SAMPLED = """            if (v->what == 1) {{
                {label}_sampled(&{label}_nominal, &memory, &now, v->mask);
            }}
"""
CARRY = """                for (int j = 0; j < SNAPSHOT_SIZE; j++) {{
                    a.snapshot[j] = snapshots[v->packet % RING][j];
                }}
"""
BEFORE = """    for (long i = 0; i < BEFORE; i++) {{
        for (int j = 0; j < INPUTS; j++) {{
            if (i == 0) {{
                now.u[j] = ({label}_real)before[i][j];
            }}{past}
        }}
    }}
"""
PAST = "\n            now.past[(BEFORE - 1 - i) * INPUTS + j] = ({label}_real)before[i][j];"


def main(about: About, s: Source, snapshot_size: int) -> str:
    """Return the program that replays the test vector."""
    label, has = about.label, {f.name for f in s.functions}
    return MAIN.format(
        label=label,
        before=BEFORE.format(label=label, past=PAST.format(label=label) if s.looks_back else ""),
        snapshot=SNAPSHOT.format(label=label) if "snapshot" in has else "",
        sampled=SAMPLED.format(label=label) if "sampled" in has else "",
        carry=CARRY.format() if snapshot_size else "",
    )


def header(about: About, v: RecordedRun, snapshot_size: int, ring: int) -> str:
    """Return the test vector as constants; at most `ring` packets are in transit at a time."""
    q, m, s = about.outputs, about.inputs, v.expected.shape[1]
    sizes = {
        "TICKS": len(v.expected), "EVENTS": len(v.events), "SIGNALS": s, "INPUTS": m, "OUTPUTS": q, "BEFORE": len(v.before),
        "SNAPSHOT_SIZE": max(snapshot_size, 1), "RING": max(ring, 1),
    }  # fmt: skip
    lines = [
        f"/* A run of {c_files.comment(about.scenario)} with {c_files.comment(about.observer)}. */",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
    ]
    lines += [f"#define {name} {value}" for name, value in sizes.items()]
    lines += [
        "",
        "typedef struct {",
        "    int64_t tick;",
        "    int what; /* 0 snapshot, 1 sampled, 2 jump */",
        "    int64_t packet;",
        f"    double value[{q}];",
        f"    bool mask[{q}];",
        f"    int64_t age[{q}], index[{q}], ticks_since_arrival;",
        "} event;",
        "",
        f"static const char *const names[] = {{{', '.join(_quote_name(name) for name, _ in about.signals[:s])}}};",
        f"static const {about.label}_real first[] = {{{_row(v.xhat0)}}};",
        f"static const double before[][{m}] = {{{', '.join(f'{{{_row(u)}}}' for u in v.before)}}};",
        *_table("inputs", m, v.inputs),
        *_table("truth", s, v.truth),
        *_table("expected", s, v.expected),
        "static const event events[] = {",
        *(
            f"    {{{e.tick}, {e.what}, {e.packet}, {{{_row(e.value)}}}, {{{_row(e.mask)}}}, {{{_row(e.age)}}}, "
            f"{{{_row(e.number)}}}, {e.ticks_since_arrival}}},"
            for e in v.events
        ),
        *([] if v.events else ["    {0}"]),
        "};",
        "",
    ]
    return without_casts("\n".join(lines))


def _quote_name(name: str) -> str:
    return '"' + name.replace('"', "'") + '"'


def _row(values: ArrayLike) -> str:
    return ", ".join(as_c(x) for x in number_entries(values).flat)


def _table(name: str, many: int, rows: np.ndarray) -> list[str]:
    return [f"static const double {name}[][{many}] = {{", *(f"    {{{_row(row)}}}," for row in rows), "};"]
