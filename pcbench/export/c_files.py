"""The C99 files of an observer: a header with structs, units and the order of calls, the functions, and the gains.

The code allocates no memory and needs only the C mathematics library. `OBSERVER_FLOAT` selects single precision.
`OBSERVER_COUNT` counts the multiplications of floats, as the column `multiplications` does.
"""

import re
from typing import NamedTuple

from jaxtyping import PyTree

from pcbench.errors import printable
from pcbench.export import observer_to_c, structs
from pcbench.export.observer_to_c import Source

PRELUDE = """#include <math.h>

#define real {label}_real
#ifdef OBSERVER_FLOAT
#define R(x) x##f
#define F(name) name##f
#else
#define R(x) x
#define F(name) name
#endif
#ifdef OBSERVER_COUNT
long {label}_products = 0;
#define PRODUCTS(n) ({label}_products += (n))
#else
#define PRODUCTS(n) ((void)0)
#endif
/* what is no number stays none */
#define LARGER(a, b) ((a) != (a) || (a) > (b) ? (a) : (b))
#define SMALLER(a, b) ((a) != (a) || (a) < (b) ? (a) : (b))
#define CLAMPED(low, x, high) ((x) < (low) ? (low) : (x) > (high) ? (high) : (x))
#define SIGN(x) ((x) != (x) ? (x) : ((x) > 0) - ((x) < 0))
"""
ORDER = """   At tick k, in this order:
     1. where a sample is taken now: {label}_snapshot (keep what it writes with the sample){sampled};
     2. for each sample that arrives now, the oldest first: {label}_jump, with the snapshot of its own tick;
     3. {label}_estimate: the estimate of now;
     4. decide the input, and {label}_hold(&now, u);
     5. {label}_flow; then {label}_next(&now).

   {label}_jump returns 0; or 1, with the memory unchanged, for a measurement outside its room. The oldest admissible age is
   {macro} = {oldest} ticks ({seconds:g} s), and no measurement may be from before tick 0 or after now. A
   measurement may arrive after at most {macro_newer} = {newer} newer ones; after more of them {label}_jump may return 1. It
   returns 1 if the inputs since the last measurement are no longer stored: begin again with {label}_begin and {label}_init.
   A value that is not finite makes the estimates so for good: set mask to 0 for it."""
OLDEST, NEWER = "{macro}_OLDEST_AGE", "{macro}_MAX_NEWER"
ADMITTED = """    for (int j = 0; j < {outputs}; j++) {{
        if (a->mask[j] && (a->age[j] < 0 || a->age[j] > {macro} || a->age[j] > now->tick)) {{
            return 1;
        }}
    }}"""
SAMPLED = ", then {label}_sampled"
HELPERS = """
/* Begin at tick 0, every input before it zero. */
static inline void {label}_begin({label}_now *now)
{{
    static const {label}_now start = {{.dt = {dt!r}}};
    *now = start;
}}

/* Hold an input over the tick that begins now. */
static inline void {label}_hold({label}_now *now, const {label}_real *u)
{{
    for (int i = 0; i < {inputs}; i++) {{
        now->u[i] = u[i];{past}
    }}
}}

/* Go on to the next tick. */
static inline void {label}_next({label}_now *now)
{{
    now->tick += 1;
    now->t = ({label}_real)now->tick * now->dt;
}}
"""
PAST = "\n        now->past[(now->tick % {rows}) * {inputs} + i] = u[i];"


class About(NamedTuple):
    """The origin of the files, for their comments."""

    label: str  # as C has it
    observer: str
    scenario: str
    dt: float  # [s]
    signals: tuple[tuple[str, str], ...]  # name and unit of what is estimated
    inputs: int
    outputs: int
    rows: int  # of past inputs
    oldest: int  # [ticks] the greatest age that a measurement may have
    newer: int  # how many newer measurements may arrive before one


def comment(text: str) -> str:
    """Return a text that is safe in a C comment: it does not open or end a comment, or join two lines."""
    for sequence in ("*/", "/*", "??/"):
        text = text.replace(sequence, f"{sequence[:-1]} {sequence[-1]}")
    text = printable(text)
    return f"{text}." if text.endswith("\\") else text


def identifier(label: str) -> str:
    """Return a label as a C identifier."""
    text = re.sub(r"\W", "_", label)
    return f"o_{text}" if text[0].isdigit() or text in structs.RESERVED else text


def header(about: About, s: Source) -> str:
    """Return the text of the header."""
    label = about.label
    u_note = "held over the tick that has begun; in snapshot, sampled and jump that of the tick before"
    past_note = f"inputs of the last {about.rows} ticks, tick n in row n mod {about.rows}"
    now = _with_notes(s.now, ("s", "from 0", "s, of one tick", u_note, past_note))
    notes = ("", "which channels arrive", "ticks since it was taken", "which sample of its channel, from 0")
    since = "ticks since the last tick at which anything arrived, from 0 before the first"
    arrival = _with_notes(s.arrival, (*notes, "of its own tick", since))
    signals = ", ".join(comment(f"{name} [{unit}]") for name, unit in about.signals)
    order = ORDER.format(
        label=label,
        sampled=SAMPLED.format(label=label) if _has(s, "sampled") else "",
        macro=_macro(about),
        oldest=about.oldest,
        macro_newer=NEWER.format(macro=about.label.upper()),
        newer=about.newer,
        seconds=about.oldest * about.dt,
    )
    if not _has(s, "snapshot"):
        order = order.replace(f"{label}_snapshot (keep what it writes with the sample)", "no snapshot to keep")
    past = PAST.format(rows=about.rows, inputs=about.inputs) if s.looks_back else ""
    lines = [
        f"/* {comment(about.observer)}, as {comment(about.scenario)} has it: made by pcbench.",
        "",
        f"   xhat: {signals}; {about.inputs} inputs u, {about.outputs} outputs y, in the scenario's units and order.",
        f"   One tick is {about.dt!r} s. Begin with {label}_begin and {label}_init.",
        "",
        order,
        "",
        f"   Compile: cc -std=c99 -O2 -o replay {label}.c main.c -lm && ./replay",
        "   In single precision: add -DOBSERVER_FLOAT. */",
        f"#ifndef {label.upper()}_H",
        f"#define {label.upper()}_H",
        "",
        "#include <stdbool.h>",
        "#include <stdint.h>",
        "",
        f"#define {_macro(about)} {about.oldest} /* ticks */",
        f"#define {NEWER.format(macro=about.label.upper())} {about.newer} /* newer measurements */",
        "",
        "#ifdef OBSERVER_FLOAT",
        f"typedef float {label}_real;",
        "#else",
        f"typedef double {label}_real;",
        "#endif",
        "",
        *structs.declare_struct(f"{label}_gains", s.gains),
        "",
        *structs.declare_struct(f"{label}_memory", s.memory),
        "",
        *structs.declare_struct(f"{label}_now", now if s.looks_back else now[:-1]),
        "",
        *structs.declare_struct(f"{label}_arrival", arrival),
        HELPERS.format(label=label, dt=about.dt, inputs=about.inputs, past=past),
        *(f"{f.returns} {label}_{f.name}({f.head});" for f in s.functions),
        "",
        "#endif",
    ]
    return re.sub(r"\breal\b", f"{label}_real", "\n".join(lines) + "\n")  # the observer's own floating-point type


def _with_notes(fields: list[structs.Field], notes: tuple[str, ...]) -> list[structs.Field]:
    return [field._replace(note=note) for field, note in zip(fields, notes, strict=True)]


def _macro(about: About) -> str:
    return OLDEST.format(macro=about.label.upper())


def _has(s: Source, name: str) -> bool:
    return any(f.name == name for f in s.functions)


def code(about: About, s: Source) -> str:
    """Return the text of the functions."""
    parts = [f'#include "{about.label}.h"\n', PRELUDE.format(label=about.label)]
    for f in s.functions:
        casts = [f"    (void){x};" for x in ("g", "m", "now", "a") if re.search(rf"\*{x}\b", f.head)]
        checks = [ADMITTED.format(outputs=about.outputs, macro=_macro(about))] if f.name == "jump" else []
        head = f"{f.returns} {about.label}_{f.name}({f.head})"
        parts.append("\n".join([head, "{", *casts, *checks, *f.lines, "}", ""]))
    return "\n".join(parts)


def gains(about: About, s: Source, numbers: PyTree) -> str:
    """Return the gains as a constant initialiser."""
    lines_of_gains = structs.initialiser(s.gains, observer_to_c.numbers(numbers))
    head = f"/* The gains of {comment(about.observer)} in {comment(about.scenario)}. */\n#include <math.h>\n"
    lines = [head + f'#include "{about.label}.h"\n', f"static const {about.label}_gains {about.label}_nominal = {{"]
    return without_casts("\n".join([*lines, *lines_of_gains, "};", ""]))


def without_casts(text: str) -> str:
    """Return initialisers whose numbers are written as double; C rounds such a constant to the type of its variable."""
    return re.sub(r"R\(([^()]*)\)", r"\1", text).replace("(real)", "")
