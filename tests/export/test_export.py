"""An exported observer, compiled, does what the simulation does: on whole runs, whatever is late, lost or overtakes."""

import io
import json
import re
import subprocess

import exports
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from commands import call
from scipy.io import loadmat

import pcbench
from pcbench.errors import UserError
from pcbench.export import c_files, files, jaxpr_to_c
from pcbench.export.terms import Writer, array_entries
from pcbench.observers import OBSERVERS

DOUBLE = 1e-12  # of the signal's size: sums of a few products, in another order
EXPORTED = [name for name in OBSERVERS if name not in exports.REFUSED]
QUICK = ("kf",)


def _once(names):
    return [pytest.param(name, marks=() if name in QUICK else pytest.mark.nightly) for name in names]


@pytest.mark.ci
@pytest.mark.parametrize("name", _once(name for name in EXPORTED if name not in exports.REGULAR))
def test_late_lost_and_out_of_sequence_samples_are_used_as_in_the_simulation(name):
    found = exports.of(name, True)
    events = re.findall(r"^    \{(\d+), 2, (\d+),", found.files["vector.h"], re.M)
    packets = [int(packet) for _, packet in events]
    assert packets != sorted(packets), "some samples overtake others"
    assert set(range(max(packets))) - set(packets), "some are lost"
    assert exports.off(found, exports.program_output(found)) < DOUBLE


@pytest.mark.nightly  # and .ci/smoke runs it with the newest and the lowest versions
@pytest.mark.parametrize("name", EXPORTED)
def test_a_published_scenario_is_replayed_to_rounding(name):
    found = exports.of(name)
    assert exports.off(found, exports.program_output(found)) < DOUBLE
    single = files.parse_replay(exports.program_output(found, single=True))
    assert all(np.isfinite(line.differs) and line.differs > 0 for line in single.values()), "float is not double"


@pytest.mark.nightly
@pytest.mark.parametrize("name", [*EXPORTED, "mhe-bounded"])
def test_products_and_bytes_are_those_of_the_cost_column(name):
    found = exports.of(name)
    cost = pcbench.operation_counts(exports.HOMES.get(name, "cart/white"), observers=[name]).iloc[0]
    numbers = [int(n) for n in re.findall(r"\d+", exports.program_output(found).splitlines()[-1])]
    products = numbers[3:] or [0, 0]
    assert (products[0], products[1]) == (cost["sample"], cost["tick"])
    assert 0 <= numbers[0] - cost["memory"] < 24, "numbers, and what is put behind flags to align those that follow"


@pytest.mark.nightly
def test_a_command_leaves_files_that_compile_as_its_line_says(tmp_path):
    done = call("export", "cart/slow", "kf", "--out", "c", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    if files.compiler() is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    assert "multiplications: 99 for the last sample, 10 per tick" in done.stdout
    assert re.search(r"position \[m\] +\d", done.stdout)
    line = re.search(r"Compile: (cc .*)$", done.stdout, re.M)[1]
    ran = subprocess.run(line, shell=True, cwd=tmp_path / "c", capture_output=True, text=True, check=True)
    assert "position: differs by" in ran.stdout
    strict = ["cc", "-std=c99", "-pedantic-errors", "-Wall", "-Wno-unused", "-Werror", "-c", "kf.c"]
    subprocess.run(strict, cwd=tmp_path / "c", check=True)
    text = "".join((tmp_path / "c" / name).read_text() for name in ("kf.c", "kf.h", "kf_gains.h"))
    assert set(re.findall(r"#include <(.*)>", text)) == {"math.h", "stdbool.h", "stdint.h"}
    assert not re.search(r"alloc|free\(", text)
    assert "position [m], velocity [m/s]" in text


@pytest.mark.ci
def test_gains_and_model_are_the_designs_in_json_and_mat():
    found = exports.of("kf", True)
    exported, mat = (
        json.loads(found.files["gains.json"]),
        loadmat(io.BytesIO(found.files["gains.mat"]), simplify_cells=True),
    )
    gains = pcbench.design(dict(exports.WILD), "kf").gains
    np.testing.assert_array_equal(exported["gains"]["P0"], gains.P0)
    np.testing.assert_array_equal(mat["gains"]["motion_powers"], gains.motion.powers)
    np.testing.assert_array_equal(np.squeeze(exported["model"]["A"]), mat["model"]["A"])
    assert exported["options"] == OBSERVERS["kf"].options().model_dump(mode="json")
    assert exported["signals"] == ["position", "velocity"]
    assert exported["units"] == ["m", "m/s"]


@pytest.mark.ci
@pytest.mark.parametrize(
    ("study", "observer", "words"),
    [
        ("cart/white", "particle", ["particle: init needs", "erf_inv", "cannot be written in C"]),
        ("cart/white", "oosm-lag", ["oosm_lag: jump needs lu", "export another observer"]),
        ("arm/sine", "pio", ["measures continuously", "use one with a sampling period"]),
        (
            {"name": "two", "scenarios": ["cart/white"], "axes": {"noise_std": [0.1, 0.2]}},
            "kf",
            ["two: got 2 grid points"],
        ),
    ],
)
def test_what_cannot_be_exported_says_what_stands_in_the_way(study, observer, words):
    with pytest.raises(UserError) as error:
        files.export_observer(study, observer)
    assert all(word in str(error.value) for word in words)


@pytest.mark.parametrize(
    "text",
    [
        "*/ int x; /*",
        "*/*/*",
        "/*/",
        "end \\",
        "end *\\",
        "??/",
        "a *??/",
        "\x1b]0;title\x07",
        "line\n*/ two",
        "\u202e",
        "*",
        "/",
    ],
)
def test_a_text_in_a_comment_of_c_stays_in_it(text):
    """A scanner of C99, in the order of its phases: trigraphs, joined lines, then comments."""
    lines = f"/* {c_files.comment(text)} */\n/* {c_files.comment(text)}\n   next */\nint end;"
    joined = re.sub(r"\\[ \t]*\n", "", lines.replace("??/", "\\"))
    assert re.sub(r"/\*.*?\*/", "", joined, flags=re.S).split() == ["int", "end;"]
    assert "/*" not in c_files.comment(text)
    assert "".join(c_files.comment(text).split("\n")).isprintable()


@jax.custom_vjp
def _with_own_slope(x):
    """A call that pcbench has no name for, with its program among its parameters."""
    return jnp.square(x) + 1


_with_own_slope.defvjp(lambda x: (_with_own_slope(x), x), lambda x, g: (2 * x * g,))


@pytest.mark.ci
def test_a_primitive_of_another_form_is_named_with_its_observer(monkeypatch):
    monkeypatch.setitem(jaxpr_to_c.RULES, "dot_general", lambda w, eqn, args: eqn.params["renamed"])
    with pytest.raises(UserError, match=r"^kf: \w+ needs dot_general in a form that is not read here \('renamed'\)"):
        files.export_observer("cart/white", "kf")


def _compile(f, *given):
    """A function of float vectors as C, called at some of them."""
    w = Writer()
    args = [array_entries(f"x{i}", np.shape(a)) for i, a in enumerate(given)]
    closed = jax.make_jaxpr(f)(*given)
    (out,) = jaxpr_to_c.write(w, closed, args)
    jaxpr_to_c.assign(w, [("real", array_entries("out", out.shape), out)])
    return w, out.size


@pytest.mark.parametrize(
    "f",
    [
        lambda x: jax.lax.fori_loop(0, (x[0] * 5).astype(int), lambda i, s: s + x[i % 4] * s, x),
        lambda x: jax.lax.scan(lambda c, r: (c * r, c + r), x[0], x, reverse=True)[1],
        lambda x: jax.lax.cond(x[1] > x[2], lambda: x * 2, lambda: -x),
        lambda x: x.at[(x[3] * 9).astype(int)].set(7.0, mode="drop").at[(x[0] * 3).astype(int)].add(1.0),
        lambda x: jnp.take(x.reshape(2, 2), (x * 3).astype(int), axis=0, mode="fill").ravel(),
        lambda x: jax.lax.dynamic_slice(x, ((x[0] * 3).astype(int),), (3,)),
        lambda x: jax.lax.dynamic_update_slice(x, x[:2] + 1, ((x[3] * 4).astype(int),)),
        lambda x: jnp.stack([x[jnp.argmax(x)], jnp.sum(x), jnp.max(x), jnp.cumsum(x)[2], jnp.sign(-x[1]), x[0] // 0.2]),
        lambda x: jnp.stack([jnp.arctan2(x[0], -x[1]), jnp.round(x[2] * 5), x[3] ** -3, jnp.hypot(x[0], x[1]), x[0] % -0.3]),
        lambda x: jax.lax.while_loop(lambda s: s[1][0] < 9, lambda s: (s[1], s[0] + s[1]), (x, x[::-1]))[0],
        lambda x: jnp.stack(jax.lax.fori_loop(0, (x[0] * 5).astype(int), lambda i, s: (s[1], s[0]), (x, -x))).ravel(),
        lambda x: jnp.stack([*jnp.unstack(x.reshape(2, 2), axis=1), *jnp.split(2 * x, 2)]).ravel(),
        lambda x: jnp.tile(_with_own_slope(x)[:3], 2),
    ],
)  # fmt: skip
def test_a_program_of_jax_is_the_same_in_c(f, tmp_path):
    """Loops whose state is exchanged, choices, indices that fall outside: each as jax has it, to rounding."""
    if files.compiler() is None:
        pytest.skip("there is no C compiler here: install one, for this to be tested")
    x = np.array([0.61, 0.37, 0.83, 0.29])
    w, size = _compile(f, x)
    from pcbench.export.c_files import PRELUDE

    lines = "\n".join(w.lines)
    text = f"""#include <stdio.h>
#include <stdint.h>
#include <stdbool.h>
typedef double t_real;
{PRELUDE.format(label="t")}
int main(void) {{
    static const real x0[4] = {{{", ".join(map(repr, x.tolist()))}}};
    real out[{size}];
{lines}
    for (int i = 0; i < {size}; i++) printf("%.17g\\n", out[i]);
}}
"""
    (tmp_path / "f.c").write_text(text)
    subprocess.run(
        [files.compiler(), "-std=c99", "f.c", "-o", "f", "-lm"], cwd=tmp_path, check=True, capture_output=True
    )
    printed = subprocess.run([tmp_path / "f"], capture_output=True, text=True, check=True).stdout
    np.testing.assert_allclose([float(v) for v in printed.split()], np.ravel(f(jnp.asarray(x))), rtol=1e-14, atol=1e-15)
