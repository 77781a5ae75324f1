"""`pcbench export`: the files of one observer of one cell, and what comes of compiling and replaying them."""

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from pcbench.dataset import store, together
from pcbench.errors import UserError
from pcbench.export import functions, library, numbers, replay, vector
from pcbench.export.library import About
from pcbench.machine import process
from pcbench.planning import alone, controller, drafts, padding, setting
from pcbench.plants import signals_of
from pcbench.simulation.problem import present
from pcbench.study.raw import Described
from pcbench.study.read import one_cell

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")
PATIENCE = 300  # seconds for a compiler, or a replay


SAID = re.compile(r"^(.*): differs by (\S+) rms, (\S+) at most; error (\S+) rms$", re.M)


class Line(NamedTuple):
    """What a replay says of one signal, in the signal's unit."""

    differs: float  # rms, from the simulation
    most: float  # at one tick
    error: float  # rms, from what is true


class Exported(NamedTuple):
    """What an observer is exported as."""

    about: About
    files: dict[str, str | bytes]  # by name
    scale: np.ndarray  # [s] the largest that each signal is in the run


def exported(study: Described, observer: str, seed: int = 0, overrides: list[str] | None = None) -> Exported:
    """Return an observer of a study of one cell as files; raise UserError where it cannot be written in C."""
    with process.float64():
        asked, cell = one_cell(study, [observer], overrides or [])
        if cell.scenario.sampling.continuous:
            raise UserError(
                f"{asked.name}: got a scenario that measures continuously, expected samples, which alone come to a program; "
                "take one with a sampling period."
            )
        if cell.entry(observer).observer.seeded:
            raise UserError(
                f"{observer}: init needs random numbers (erf_inv, random_bits), which cannot be written in C here, expected "
                "an observer that draws none; export another one."
            )
        (p,) = (alone(planned, asked.root_seed, seed) for planned in padding.fit(list(drafts([cell]))))
        return _exported(p, asked.root_seed, seed)


def _exported(p: padding.Plan, root_seed: int, seed: int) -> Exported:
    ((name, o),), label = p.layout.observers, p.labels[0]
    rows, problem = _rows(p), jax.tree.map(jnp.asarray, p.problem._replace(schedule=()))
    gains = problem.gains[name]
    m, q = setting(p.cell).model.B.shape[1], len(problem.noise_std)
    still = problem._replace(inputs=jnp.zeros((1, m)))
    note = jax.eval_shape(lambda: o.note(gains, o.init(gains, problem.xhat0), present(still, jnp.asarray(0), False)))
    noted = note.shape[0]
    shapes = functions.Shapes(len(problem.x0), m, q, noted, rows)
    s = functions.source(library.identifier(label), o, gains, problem.xhat0, shapes)
    v, signals = vector.vector(p, root_seed, seed, rows), signals_of(p.cell.scenario)[: s.estimates]
    about = About(
        label=library.identifier(label),
        observer=label,
        scenario=p.cell.scenario.name,
        dt=p.cell.scenario.dt,
        signals=signals,
        inputs=m,
        outputs=q,
        rows=rows,
    )
    found = numbers.described(about, p, gains)
    files: dict[str, str | bytes] = {
        f"{about.label}.h": library.header(about, s),
        f"{about.label}.c": library.code(about, s),
        f"{about.label}_gains.h": library.gains(about, s, gains),
        "vector.h": replay.header(about, v, noted, p.layout.ring),
        "main.c": replay.main(about, s, noted),
        "gains.json": numbers.as_json(found),
        "gains.mat": numbers.as_mat(found),
    }
    return Exported(about, files, np.abs(v.expected).max(0))


def _rows(p: padding.Plan) -> int:
    """How many past inputs an observer may ask for: those since the oldest sample that it may still use."""
    ticks, entry = p.cell.times.ticks, p.cell.entry(p.labels[0])
    if not entry.loops:  # it looks back further than a loop keeps its inputs
        return ticks + 1
    return min(controller.oldest(p.cell, setting(p.cell).overtaking, ticks) + 2, ticks + 1)


def require_place(out: str | Path) -> None:
    """Raise UserError where no folder can be, before anything is computed for it; nothing is made."""
    root = Path(store.target(Path(out).expanduser()).root)
    there = next(p for p in (root, *root.parents) if os.path.lexists(p))
    if not there.is_dir():
        raise UserError(f"--out {out}: got {there}, which is no folder, expected a folder or a new name; give another.")
    if not os.access(there, os.W_OK | os.X_OK):
        raise UserError(
            f"--out {out}: got {there}, which you may not write, expected a folder that you may; give another."
        )


def write(found: Exported, out: str | Path) -> list[Path]:
    """Write the files into a folder, which may be there: all or none; raise UserError where that cannot be done."""
    target = store.target(Path(out).expanduser())
    store.make(target)
    each = {name: content if isinstance(content, bytes) else content.encode() for name, content in found.files.items()}
    together.put_all(target, each)
    return [Path(target.root) / name for name in found.files]


def compiler() -> str | None:
    """Return the compiler of this machine; None where there is none."""
    return next((found for each in COMPILERS if (found := shutil.which(each))), None)


def replayed(found: Exported, single: bool = False, arguments: tuple[str, ...] = (), count: bool = True) -> str | None:
    """Return what the compiled program prints, in double or in `single` precision; None where there is no compiler.

    Raises UserError with what the compiler says where it refuses.
    """
    cc = compiler()
    if cc is None:
        return None
    with tempfile.TemporaryDirectory(prefix="pcbench-export-") as folder:
        write(found, folder)
        flags = [*FLAGS, *(["-DOBSERVER_FLOAT"] if single else []), *(["-DOBSERVER_COUNT"] if count else [])]
        files = [f"{found.about.label}.c", "main.c"]
        done = subprocess.run(
            [cc, *flags, "-o", "replay", *files, "-lm"], cwd=folder, capture_output=True, text=True, timeout=PATIENCE
        )
        if done.returncode:
            line = (done.stderr.strip().splitlines() or ["no reason"])[0]
            raise UserError(f"{cc}: refused {files[0]} ({line}), expected it to compile as C99; look at that line.")
        ran = subprocess.run([f"{folder}/replay", *arguments], capture_output=True, text=True, timeout=PATIENCE)
        return ran.stdout


def said(printed: str) -> dict[str, Line]:
    """Return what a replay has printed, by signal."""
    return {name: Line(float(a), float(b), float(c)) for name, a, b, c in SAID.findall(printed)}
