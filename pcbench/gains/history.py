"""Evaluated points of a tuning, in a Parquet file from which a stopped tuning continues, and its result."""

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

HISTORY, TUNED = "history.parquet", "tuned.toml"
REFIT = "history-whole.parquet"  # of a second descent, on all data
ABOUT = b"pcbench.tuning"  # metadata key of the description of the tuning
BASIS = b"pcbench.study"  # metadata key of its study, to report changes
PAUSE = 2.0  # [s] least time between two writes


class AnotherTuning(UserError):
    """A folder contains the history of another tuning."""


class Judgement(NamedTuple):
    """A metric of start and tuned gains over some seeds, without diverged runs (for a pooled metric, its mean square)."""

    what: str  # training, validation, or exact (expected values, without seeds)
    seeds: Seeds
    start: float
    start_se: float
    tuned: float
    tuned_se: float
    difference: float  # tuned minus start, paired over the same runs
    difference_se: float
    diverged: tuple[int, int]  # number of diverged runs of start and tuned


class Evaluation(NamedTuple):
    """One evaluated point."""

    parameters: tuple[float, ...]  # the free parameters
    value: float  # objective over the training runs; infinite if the gains are refused or a run diverged
    slope: tuple[float, ...]  # gradient; empty without one
    seconds: float


class History:
    """The points of a tuning in the order of evaluation; points of an earlier run are not evaluated again."""

    def __init__(self, target: storage.Target, about: str, names: list[str], basis: TomlTable, file: str = HISTORY):
        self.target, self.about, self.names, self.basis, self.file = target, about, names, basis, file
        self.points: list[Evaluation] = []
        self.before = _read_points(target, about, basis, file)
        self.written = monotonic()

    def ask(self, at: Vector, evaluate: Callable[[Vector], tuple[float, Vector]]) -> tuple[float, Vector]:
        """Return value and slope at a point: from the earlier run if this was its next point, otherwise evaluated."""
        key, number = tuple(map(float, at)), len(self.points)
        if number < len(self.before) and self.before[number].parameters == key:
            point = self.before[number]
        else:
            self.before = self.before[:number]
            start = monotonic()
            value, slope = evaluate(at)
            point = Evaluation(key, value, tuple(map(float, slope)), monotonic() - start)
        self.points.append(point)
        works = isfinite(self.points[0].value)  # a start without a finite value is not stored
        if number >= len(self.before) and works and monotonic() - self.written > PAUSE:
            self.write()
        return point.value, np.array(point.slope)

    @property
    def best(self) -> Evaluation:
        """Return the point with the least value."""
        return min(self.points, key=lambda point: point.value)

    def write(self) -> None:
        """Write the history; the objective is null if the gains were refused or a run diverged."""
        points, float64 = self.points, pa.float64()
        columns: TomlTable = {"point": np.arange(len(points))}
        columns |= {f"free.{name}": np.array([p.parameters[i] for p in points]) for i, name in enumerate(self.names)}
        columns["objective"] = pa.array([p.value if isfinite(p.value) else None for p in points], float64)
        for i, name in enumerate(self.names):
            slopes = [p.slope[i] if p.slope and isfinite(p.slope[i]) else None for p in points]
            columns[f"slope.{name}"] = pa.array(slopes, float64)
        columns["seconds"] = np.array([p.seconds for p in points])
        metadata = {ABOUT: self.about.encode(), BASIS: json.dumps(self.basis).encode()}
        storage.write_table(self.target, self.file, pa.table(columns).replace_schema_metadata(metadata))
        self.written = monotonic()


def basis_of(study: Study, cell: Cell) -> TomlTable:
    """Return the inputs of a tuning: its study with all options, and digests of the files of users' code."""
    return json.loads(json.dumps({"study": resolve_study(study, [cell]), "files": stored_code.files_of(study)}))


def _read_points(target: storage.Target, about: str, basis: TomlTable, file: str) -> list[Evaluation]:
    """Return the points of an earlier run; raise AnotherTuning if they are those of another tuning."""
    content = storage.read_buffer(target, file)
    if content is None:
        if other_files := [name for name in storage.file_names(target) if name not in (HISTORY, TUNED)]:
            raise UserError(
                f"{target.name}: contains other files ({other_files[0]}), expected a new or empty folder; give another one "
                "with --out."
            )
        return []
    try:
        table = parquet_io.parse_table(content)
        metadata = table.schema.metadata or {}
        stored_about, before = metadata.get(ABOUT, b"").decode(), json.loads(metadata.get(BASIS, b"{}"))
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
    if stored_about != about:
        files = before.get("files", {}), basis["files"]
        differences = list(changes(before["study"], basis["study"], files)) if before else []
        text = "; ".join(differences) or stored_about
        expected = "the same study" if differences else about
        raise AnotherTuning(
            f"{target.name}: contains another tuning ({text}), expected {expected}; give another folder with --out."
        )
    return points


def finish(target: storage.Target, about: str, tuned: Any) -> None:
    """Write the result: a study that can be run, with the record of the tuning under [resolved.tuning]."""
    record: TomlTable = {"about": about, "start": tuned.start, "best": tuned.best, "kept_start": tuned.kept_start}
    record |= {"method": tuned.method, "judgements": [as_record(j) for j in tuned.judgements]}
    record |= {"exact": True} if tuned.exact else {}
    record |= {} if tuned.certified is None else {"certified": tuned.certified}
    storage.write_file(target, TUNED, tomli_w.dumps(tuned.study | {"resolved": {"tuning": record}}).encode())


def load_finished(target: storage.Target, task: str, about: str, basis: TomlTable) -> TomlTable | None:
    """Return the result of an earlier run of the same tuning, or None without one.

    `task` describes the finished tuning, `about` and `basis` its history.
    """
    try:
        study = toml_text.parse(storage.read_bytes(target, TUNED) or b"")
        record = study.pop("resolved")["tuning"]
        if record.pop("about") != task:
            return None
        judgements = []
        for row in record.pop("judgements"):
            first, count, (start, tuned) = row.pop("first"), row.pop("seeds"), row.pop("diverged")
            judgements.append(Judgement(seeds=seed_range(first, count), diverged=(start, tuned), **row))
        return record | {
            "study": study,
            "judgements": judgements,
            "points": _read_points(target, about, basis, HISTORY),
        }
    except (ValueError, KeyError, TypeError, AttributeError):
        return None  # missing or damaged: the tuning continues from its history, and writes the result again


def copy_from_cache(target: storage.Target, task: str, about: str, basis: TomlTable) -> None:
    """Copy the cached result of the same tuning by the same code into an empty folder; ignore damaged entries."""
    place = _cache_folder(task, basis)
    source = storage.target(place)
    with suppress(UserError):
        if not storage.file_names(target) and load_finished(source, task, about, basis):
            storage.create_folder(target)
            for name in (HISTORY, TUNED):  # in this order, because a result without its history is invalid
                storage.write_file(target, name, (place / name).read_bytes())


def keep_result(target: storage.Target, task: str, basis: TomlTable) -> None:
    """Store a finished tuning in the cache for `copy_from_cache`."""
    for name in (HISTORY, TUNED):
        cache.keep(_cache_folder(task, basis) / name, storage.read_buffer(target, name) or b"")


def _cache_folder(task: str, basis: TomlTable) -> Path:
    """Return the cache folder of a tuning, named by the hash of all inputs that determine its numbers."""
    record = f"{task} {json.dumps(basis, sort_keys=True)} {_versions()}"
    return cache.folder("gains", f"tuning-{hashlib.sha256(record.encode()).hexdigest()[:32]}")


@lru_cache(maxsize=1)
def _versions() -> str:
    """Return a digest of pcbench's source and the versions of numerical libraries, which affect the bits of an objective."""
    root = Path(__file__).parents[1]
    text = b"".join(path.read_bytes() for path in sorted(root.rglob("*.py")))
    return (
        f"{hashlib.sha256(text).hexdigest()} {[version(name) for name in ('jax', 'jaxlib', 'numpy', 'scipy', 'optax')]}"
    )


def as_record(judgement: Judgement) -> TomlTable:
    """Return a judgement as it is written, with the first seed and the number of seeds."""
    record = judgement._asdict()
    seeds = record.pop("seeds")
    head = {"what": record.pop("what"), "first": seeds.first, "seeds": seeds.many}
    return head | record | {"diverged": list(judgement.diverged)}
