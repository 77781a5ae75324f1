"""The points of a tuning so far, in a Parquet file: all that is needed to go on; and what it has found."""

import hashlib
import json
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache
from importlib.metadata import version
from math import isfinite
from pathlib import Path
from time import monotonic
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import tomli_w

from pcbench import toml_text
from pcbench.dataset import parquet_io, storage, stored_code
from pcbench.dataset.seed_ranges import Seeds, seed_range
from pcbench.dataset.study_diff import changes
from pcbench.errors import UserError
from pcbench.gains.parameters import Vector
from pcbench.runtime import cache
from pcbench.study import Study
from pcbench.study.grid import Cell
from pcbench.study.serialize import resolve_study
from pcbench.toml_text import TomlTable

HISTORY, FOUND = "history.parquet", "tuned.toml"
REFIT = "history-whole.parquet"  # of a second descent, on all data
ABOUT = b"pcbench.tuning"  # the key in the file's metadata: what was tuned for what
BASIS = b"pcbench.study"  # and the study in which, to say what has changed
PAUSE = 2.0  # [s] between two writings


class AnotherTuning(UserError):
    """A folder holds the history of another tuning."""


class Judgement(NamedTuple):
    """An objective's metric (of a pooled one the mean square behind it) over some seeds, diverged runs left out."""

    what: str  # training or validation; or exact: expected values, of no seeds
    seeds: Seeds
    start: float
    start_se: float
    tuned: float
    tuned_se: float
    difference: float  # tuned less start, paired over the same draws
    difference_se: float
    diverged: tuple[int, int]  # runs, of start and tuned


class Evaluation(NamedTuple):
    """One point asked for."""

    at: tuple[float, ...]  # the free parameters
    value: float  # of the objective over the training runs; infinite where the gains are refused or a run diverged
    slope: tuple[float, ...]  # empty where none was asked for
    seconds: float


class History:
    """The points of a tuning in the order in which they were asked for; those of an earlier run are not evaluated again."""

    def __init__(self, target: storage.Target, about: str, names: list[str], basis: TomlTable, file: str = HISTORY):
        self.target, self.about, self.names, self.basis, self.file = target, about, names, basis, file
        self.points: list[Evaluation] = []
        self.before = _read(target, about, basis, file)
        self.written = monotonic()

    def ask(self, at: Vector, evaluate: Callable[[Vector], tuple[float, Vector]]) -> tuple[float, Vector]:
        """Return value and slope at a point: as an earlier run found them, if this was its next point, or else evaluated."""
        key, number = tuple(map(float, at)), len(self.points)
        if number < len(self.before) and self.before[number].at == key:
            point = self.before[number]
        else:
            self.before = self.before[:number]
            start = monotonic()
            value, slope = evaluate(at)
            point = Evaluation(key, value, tuple(map(float, slope)), monotonic() - start)
        self.points.append(point)
        works = isfinite(self.points[0].value)  # a start that fails leaves nothing
        if number >= len(self.before) and works and monotonic() - self.written > PAUSE:
            self.write()
        return point.value, np.array(point.slope)

    @property
    def best(self) -> Evaluation:
        """Return the point of the least value."""
        return min(self.points, key=lambda point: point.value)

    def write(self) -> None:
        """Write the history: the objective is null where the gains were refused."""
        points, float64 = self.points, pa.float64()
        columns: TomlTable = {"point": np.arange(len(points))}
        columns |= {f"free.{name}": np.array([p.at[i] for p in points]) for i, name in enumerate(self.names)}
        columns["objective"] = pa.array([p.value if isfinite(p.value) else None for p in points], float64)
        for i, name in enumerate(self.names):
            slopes = [p.slope[i] if p.slope and isfinite(p.slope[i]) else None for p in points]
            columns[f"slope.{name}"] = pa.array(slopes, float64)
        columns["seconds"] = np.array([p.seconds for p in points])
        metadata = {ABOUT: self.about.encode(), BASIS: json.dumps(self.basis).encode()}
        storage.put_table(self.target, self.file, pa.table(columns).replace_schema_metadata(metadata))
        self.written = monotonic()


def basis_of(study: Study, cell: Cell) -> TomlTable:
    """Return what a tuning depends on: its study with all options, and the digests of the files of users' code."""
    return json.loads(json.dumps({"study": resolve_study(study, [cell]), "files": stored_code.files_of(study)}))


def _read(target: storage.Target, about: str, basis: TomlTable, file: str) -> list[Evaluation]:
    """What an earlier run has seen; raise AnotherTuning where that was another tuning."""
    content = storage.get(target, file)
    if content is None:
        if others := [name for name in storage.names(target) if name not in (HISTORY, FOUND)]:
            raise UserError(
                f"{target.name}: holds other files ({others[0]}), expected a new or empty folder; give another one with --out."
            )
        return []
    try:
        table = parquet_io.parse_table(content)
        metadata = table.schema.metadata or {}
        said, before = metadata.get(ABOUT, b"").decode(), json.loads(metadata.get(BASIS, b"{}"))
        free, slopes = ([c for c in table.column_names if c.startswith(k)] for k in ("free.", "slope."))
        points = []
        for row in table.to_pylist():
            value = float("inf") if row["objective"] is None else row["objective"]
            slope = tuple(float("nan") if row[c] is None else row[c] for c in slopes)
            points.append(Evaluation(tuple(row[c] for c in free), value, slope, row["seconds"]))
    except (pa.ArrowException, OSError, ValueError, KeyError):
        raise UserError(
            f"{target.name}/{file}: is damaged, expected a tuning's history; remove it, or give another folder with --out."
        ) from None
    if said != about:
        files = before.get("files", {}), basis["files"]
        changed = list(changes(before["study"], basis["study"], files)) if before else []
        differs = f"{'; '.join(changed)}), expected the same study" if changed else f"{said}), expected {about}"
        raise AnotherTuning(f"{target.name}: holds another tuning ({differs}; give another folder with --out.")
    return points


def finish(target: storage.Target, about: str, tuned: Any) -> None:
    """Write what was found: a study that can be run, and under [resolved.tuning] how it came about."""
    said: TomlTable = {"about": about, "start": tuned.start, "found": tuned.found, "kept_start": tuned.kept_start}
    said |= {"method": tuned.method, "judged": [plain(j) for j in tuned.judged]}
    said |= {"exact": True} if tuned.exact else {}
    said |= {} if tuned.certified is None else {"certified": tuned.certified}
    storage.put(target, FOUND, tomli_w.dumps(tuned.study | {"resolved": {"tuning": said}}).encode())


def load_finished(target: storage.Target, whole: str, about: str, basis: TomlTable) -> TomlTable | None:
    """Return what an earlier run of the same tuning has found; None where there is none.

    `whole` describes the finished tuning, `about` and `basis` its history.
    """
    try:
        study = toml_text.parse(storage.text(target, FOUND) or b"")
        said = study.pop("resolved")["tuning"]
        if said.pop("about") != whole:
            return None
        judged = []
        for each in said.pop("judged"):
            first, many, (start, tuned) = each.pop("first"), each.pop("seeds"), each.pop("diverged")
            judged.append(Judgement(seeds=seed_range(first, many), diverged=(start, tuned), **each))
        return said | {"study": study, "judged": judged, "points": _read(target, about, basis, HISTORY)}
    except (ValueError, KeyError, TypeError, AttributeError):
        return None  # not there, or damaged: the history is read, and it is written anew


def load_kept(target: storage.Target, whole: str, about: str, basis: TomlTable) -> None:
    """Put what the cache has of the same tuning by the same code into a folder that is empty; damaged entries are left."""
    place = _kept(whole, basis)
    kept = storage.target(place)
    with suppress(UserError):
        if not storage.names(target) and load_finished(kept, whole, about, basis):
            storage.make(target)
            for name in (HISTORY, FOUND):  # in this order: a result without its history is none
                storage.put(target, name, (place / name).read_bytes())


def keep_result(target: storage.Target, whole: str, basis: TomlTable) -> None:
    """Keep a finished tuning in the cache, where `load_kept` finds it."""
    for name in (HISTORY, FOUND):
        cache.keep(_kept(whole, basis) / name, storage.get(target, name) or b"")


def _kept(whole: str, basis: TomlTable) -> Path:
    """The folder of a tuning in the cache, named by all that decides its numbers."""
    said = f"{whole} {json.dumps(basis, sort_keys=True)} {_versions()}"
    return cache.folder("gains", f"tuning-{hashlib.sha256(said.encode()).hexdigest()[:32]}")


@lru_cache(maxsize=1)
def _versions() -> str:
    """What decides the bits of an objective besides what is asked: pcbench's own text, and the libraries that compute."""
    root = Path(__file__).parents[1]
    text = b"".join(path.read_bytes() for path in sorted(root.rglob("*.py")))
    return (
        f"{hashlib.sha256(text).hexdigest()} {[version(name) for name in ('jax', 'jaxlib', 'numpy', 'scipy', 'optax')]}"
    )


def plain(judged: Judgement) -> TomlTable:
    """Return a judgement as it is written: of its seeds the first, and how many."""
    said = judged._asdict()
    seeds = said.pop("seeds")
    head = {"what": said.pop("what"), "first": seeds.first, "seeds": seeds.many}
    return head | said | {"diverged": list(judged.diverged)}
