"""The files of `pcbench export` for one observer of one cell, and the result of compiling and replaying them."""

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd

from pcbench.dataset import storage
from pcbench.errors import UserError
from pcbench.export import c_files, c_replay, numbers, observer_to_c, recording, structs
from pcbench.export.c_files import About
from pcbench.export.structs import RecordedRun
from pcbench.planning import alone, context_of, draft, loop_setup, padding, with_computing_time
from pcbench.plants import estimated_of
from pcbench.playback.replay import replay
from pcbench.playback.setup import PlaybackSetup, open_playback
from pcbench.runtime import config
from pcbench.study.grid import Cell
from pcbench.study.labels import title_of_scenario
from pcbench.study.load import StudyLike
from pcbench.study.parse import one_cell
from pcbench.synthesis.certificate import DesignContext

COMPILERS = ("cc", "gcc", "clang")
FLAGS = ("-std=c99", "-O2")
TIMEOUT = 300  # seconds for a compiler, or a replay
DIFFERENCE = re.compile(r"^(.*): differs by (\S+) rms, (\S+) at most; error (\S+) rms$", re.M)


class SignalDifference(NamedTuple):
    """The result of a replay for one signal, in the signal's unit."""

    differs: float  # rms, from the simulation
    most: float  # at one tick
    error: float  # rms, from what is true


class ExportedObserver(NamedTuple):
    """The files of an exported observer."""

    about: About
    files: dict[str, str | bytes]  # by name
    scale: np.ndarray  # [s] largest size of each signal in the run


def export_observer(
    study: StudyLike,
    observer: str,
    seed: int = 0,
    overrides: list[str] | None = None,
    *,
    log: str | Path | None = None,
    delay: float | None = None,
    start: float | None = None,
) -> ExportedObserver:
    """Return the files of an observer of a study with one cell; raise UserError if C cannot express it.

    With a `log`, the buffers have the size that this recording needs, and the test run is the replay of the recording,
    with `delay` and `start` [s] as in `playback.replay`. Otherwise the test run is run `seed` of the study.
    """
    with config.float64():
        spec, cell = one_cell(study, [observer], overrides or [])
        if cell.scenario.sampling.continuous:
            raise UserError(
                f"{spec.name}: got a scenario that measures continuously, expected samples, which alone come to a program; "
                "use one with a sampling period."
            )
        label = next(iter(cell.options))
        if cell.entry(label).observer.init_random:
            raise UserError(
                f"{observer}: init needs random numbers (erf_inv, random_bits), which cannot be written in C here, expected "
                "an observer that draws none; export another one."
            )
        if cell.entry(label).observer.uses_silence:
            raise UserError(
                f"{observer}: got an observer that uses silence (no sample was sent), which a program in C does not report, "
                "expected one that uses samples alone; export kf."
            )
        title = title_of_scenario(spec, cell.scenario.name)
        if log is None:
            cell = with_computing_time(cell, label)
            (p,) = (alone(plan, spec.root_seed, seed) for plan in padding.fit([draft(cell, cell.options)]))
            ((name, _),), context = p.layout.observers, context_of(p.cell)
            rows = _rows(cell, p.labels[0], context)
            run = structs.recorded_run(p, spec.root_seed, seed, rows)
            return _build_export(title, p.cell, p.labels[0], name, p, context, rows, run)
        return _export_recording(title, log, study, observer, delay, start, overrides or [])


def _export_recording(
    title: str,
    log: str | Path,
    study: StudyLike,
    observer: str,
    delay: float | None,
    start: float | None,
    overrides: list[str],
) -> ExportedObserver:
    playback = open_playback(log, study, [observer], delay=delay, start=start, overrides=overrides)
    label = next(iter(playback.cell.options))
    setup, run = recording.prepare_recording(playback, playback.cell.entry(label).observer.on_sample is not None)
    result = replay(log, study, [observer], delay=delay, start=start, overrides=overrides)
    estimates = cast(pd.DataFrame, result.estimates)
    names = (f"{label}.{signal}" for signal, _ in estimated_of(playback.cell.scenario))
    expected = estimates[[name for name in names if name in estimates]].to_numpy()
    rows = max(_rows(playback.cell, label, setup.context), setup.back)
    run = run._replace(before=np.zeros((rows, setup.m)), truth=run.truth[:, : expected.shape[1]], expected=expected)
    return _build_export(title, playback.cell, label, label, setup, setup.context, rows, run)


def _build_export(
    title: str,
    cell: Cell,
    label: str,
    name: str,
    p: padding.Plan | PlaybackSetup,
    context: DesignContext,
    rows: int,
    run: RecordedRun,
) -> ExportedObserver:
    """Return the files of an observer, called `name` in the problem, with `rows` of past inputs and the test run.

    `title` is the name of the scenario in the files.
    """
    o = dict(p.layout.observers)[name]
    gains, xhat0 = jax.tree.map(jnp.asarray, p.problem.gains[name]), jnp.asarray(p.problem.xhat0)
    m, q, zero = context.model.B.shape[1], len(context.noise_std), jnp.asarray(0)
    now = observer_to_c.present(
        jnp.asarray(0.0), zero, jnp.asarray(context.dt), jnp.zeros(m), jnp.zeros((1, m)), decided=False
    )
    snapshot_size = jax.eval_shape(lambda: o.snapshot(gains, o.init(gains, xhat0), now)).shape[0]
    s = observer_to_c.source(
        c_files.identifier(label), o, gains, xhat0, observer_to_c.Shapes(m, q, snapshot_size, rows)
    )
    oldest = context.ticks  # largest age in ticks of a measurement that is used
    if s.jump_looks_back == "in a loop":  # reads inputs since the measurement before, of at most the expected age
        oldest = min(context.latest, rows)
    elif s.jump_looks_back == "once":
        oldest = min(rows, context.ticks)
    about = About(
        label=c_files.identifier(label),
        observer=label,
        scenario=title,
        dt=cell.scenario.dt,
        signals=estimated_of(cell.scenario)[: s.estimates],
        inputs=m,
        outputs=q,
        rows=rows,
        oldest=oldest,
        newer=context.oosm_lag,
    )
    description = numbers.describe_gains(about, context, p.certificates[label], cell.options[label].model_dump(), gains)
    files: dict[str, str | bytes] = {
        f"{about.label}.h": c_files.header(about, s),
        f"{about.label}.c": c_files.code(about, s),
        f"{about.label}_gains.h": c_files.gains(about, s, gains),
        "vector.h": c_replay.header(about, run, snapshot_size, p.layout.ring),
        "main.c": c_replay.main(about, s, snapshot_size),
        "gains.json": numbers.as_json(description),
        "gains.mat": numbers.as_mat(description),
    }
    return ExportedObserver(about, files, np.abs(run.expected).max(0))


def _rows(cell: Cell, label: str, context: DesignContext) -> int:
    """Return the number of past inputs that an observer may use: those since the oldest sample that can still arrive."""
    ticks, entry = cell.times.ticks, cell.entry(label)
    if not entry.loops:  # it looks back further than a loop keeps its inputs
        return ticks + 1
    return min(loop_setup.oldest(cell, context.oosm_lag, ticks) + 2, ticks + 1)


def require_place(out: str | Path) -> None:
    """Raise UserError if the folder cannot be created, before the computation starts; creates nothing."""
    root = Path(storage.target(Path(out).expanduser()).root)
    ancestor = next(p for p in (root, *root.parents) if os.path.lexists(p))
    if not ancestor.is_dir():
        raise UserError(
            f"--out {out}: got {ancestor}, which is no folder, expected a folder or a new name; give another."
        )
    if not os.access(ancestor, os.W_OK | os.X_OK):
        raise UserError(
            f"--out {out}: got {ancestor}, which you may not write, expected a folder that you may; give another."
        )


def write(export: ExportedObserver, out: str | Path) -> list[Path]:
    """Write the files into a new or existing folder, all or none; raise UserError if that fails."""
    target = storage.target(Path(out).expanduser())
    storage.create_folder(target)
    files = export.files.items()
    storage.write_files(target, {name: file if isinstance(file, bytes) else file.encode() for name, file in files})
    return [Path(target.root) / name for name in export.files]


def compiler() -> str | None:
    """Return the C compiler of this machine, or None."""
    return next((path for compiler in COMPILERS if (path := shutil.which(compiler))), None)


def run_compiled(
    export: ExportedObserver, single: bool = False, arguments: tuple[str, ...] = (), count: bool = True
) -> str | None:
    """Return the output of the compiled program, in double or `single` precision; None without a compiler.

    Raises UserError with the compiler's message if it fails.
    """
    cc = compiler()
    if cc is None:
        return None
    with tempfile.TemporaryDirectory(prefix="pcbench-export-") as folder:
        write(export, folder)
        flags = [*FLAGS, *(["-DOBSERVER_FLOAT"] if single else []), *(["-DOBSERVER_COUNT"] if count else [])]
        files = [f"{export.about.label}.c", "main.c"]
        compilation = subprocess.run(
            [cc, *flags, "-o", "replay", *files, "-lm"], cwd=folder, capture_output=True, text=True, timeout=TIMEOUT
        )
        if compilation.returncode:
            line = (compilation.stderr.strip().splitlines() or ["no reason"])[0]
            raise UserError(f"{cc}: refused {files[0]} ({line}), expected it to compile as C99; look at that line.")
        execution = subprocess.run([f"{folder}/replay", *arguments], capture_output=True, text=True, timeout=TIMEOUT)
        if execution.returncode:
            raise UserError(
                f"{export.about.observer}: {execution.stderr.strip()}, expected room for the whole run; export it again."
            )
        return execution.stdout


def parse_replay(output: str) -> dict[str, SignalDifference]:
    """Return the output of a replay by signal."""
    return {name: SignalDifference(float(a), float(b), float(c)) for name, a, b, c in DIFFERENCE.findall(output)}
