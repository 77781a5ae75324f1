"""Comparison of two results of one study, from two releases or machines: which numbers changed. No jax.

Nothing is written. A row of stats is matched by scenario, cell (the digest of all that determines it, not its number),
observer, signal and metric. If both sides have the same seeds, the numbers should be equal to rounding. If they are
not, or if the seeds differ, means are compared by Welch's t (Biometrika 34 (1947), 28-35) with mean, standard error and
n,

    t = (b - a) / sqrt(va + vb),   df = (va + vb)^2 / (va^2 / (na - 1) + vb^2 / (nb - 1)),   v = se^2,

and with Holm's correction over all these rows. With the same seeds the test is conservative, because it assumes
independence. If only some seeds are common, both sides are computed again over those. A number without spread (no
noise) has changed if it differs by more than rounding, and also if it exists on one side only.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.special import stdtr

from pcbench.dataset import aggregate, block_files, close, manifest, storage
from pcbench.dataset.block_files import Series
from pcbench.dataset.manifest import StudyClaim
from pcbench.dataset.seed_ranges import Seeds, common, merge_ranges
from pcbench.dataset.table_diff import ROUNDING, ZERO
from pcbench.errors import UserError
from pcbench.statistics.comparison import holm
from pcbench.statistics.confidence_intervals import Values
from pcbench.study import Study
from pcbench.study.grid import identity, reseed
from pcbench.study.serialize import to_toml

LEVEL = 0.05
KEY = ["scenario", "digest", "observer", "signal", "metric"]
MADE_BY = ("versions", "compiler", "device", "system", "precision", "engines", "git")  # may affect the last bits
EXACT = "no draws: exact"
Name = tuple[str, str, str]  # scenario, cell's digest, observer


class Comparison(NamedTuple):
    """The differences of two results, b minus a."""

    rows: pd.DataFrame  # matched, the most significantly changed first; columns of `compare_rows`
    only: tuple[int, int]  # number of rows only in a, and only in b
    made_by: list[str]  # differences of versions and machines, one phrase each

    @property
    def changed(self) -> int:
        """Number of rows that changed significantly, or by more than rounding if they have no spread."""
        return int(self.rows.changed.sum())

    @property
    def identical(self) -> bool:
        """Whether all rows with the same seeds have the same bits."""
        return bool(self.rows.identical[self.rows.same_draws].all())

    @property
    def largest(self) -> float:
        """The largest relative difference among rows with the same seeds; 0 without such rows."""
        return float(np.max(self.rows.relative[self.rows.same_draws].to_numpy(), initial=0.0))


def compare(a: str | Path, b: str | Path) -> Comparison:
    """Compare two folders; raise UserError if their studies differ, or one is damaged or has no closing tables.

    Only the footers of the blocks are read; `verify` reads whole blocks.
    """
    targets = storage.target(a), storage.target(b)
    claims = manifest.load_manifest(targets[0]), manifest.load_manifest(targets[1])
    if changes := manifest.differences(claims[0], _with_root_seed(claims[1], claims[0].study)):
        raise UserError(
            f"{targets[1].name}: is of another study than {targets[0].name} ({'; '.join(changes[:3])}), expected the same "
            "study; compare results of one study."
        )
    sides = [_side(target, claim) for target, claim in zip(targets, claims, strict=True)]
    common_seeds = _common_seeds(*sides)
    left, right = (_stats(side, common_seeds) for side in sides)
    joint = left.merge(right, on=KEY, how="outer", suffixes=("_a", "_b"), indicator=True)
    only = int((joint._merge == "left_only").sum()), int((joint._merge == "right_only").sum())
    rows = compare_rows(joint[joint._merge == "both"].drop(columns="_merge"))
    return Comparison(rows, only, made_by(*targets))


def _with_root_seed(claim: StudyClaim, other: Study) -> StudyClaim:
    """A study with the root seed of another, because a different root seed does not make a different study here."""
    if other.root_seed == claim.study.root_seed:  # as it is: options of a user's observer may not be known here
        return claim
    study = claim.study.model_copy(update={"root_seed": other.root_seed})
    cells = reseed(claim.cells, other.root_seed)
    return StudyClaim(study, cells, to_toml(study, cells))


class Side(NamedTuple):
    """One of two results."""

    target: storage.Target
    claim: StudyClaim
    stats: pa.Table
    digests: dict[tuple[str, int], str]  # of each cell by its key, without root seed and number
    blocks: Series

    @property
    def draws(self) -> dict[Name, list[Seeds]]:
        """Return its ranges of seeds by scenario, cell digest and observer."""
        return {
            (s, self.digests[s, cell], observer): merge_ranges(b.seeds for b in group)
            for (s, cell, observer), group in self.blocks.items()
        }


def _side(target: storage.Target, claim: StudyClaim) -> Side:
    """Return a result; raise UserError if it is unfinished or damaged."""
    stats = close.table(target, "stats.parquet")
    if stats is None:
        raise UserError(
            f"{target.name}/stats.parquet: is not there or damaged, expected a finished study; run it again to continue."
        )
    digests = {c.key: identity(c, 0) for c in claim.cells}
    blocks = block_files.drop_overlaps(block_files.present(target))
    for b in blocks:
        if (b.scenario, b.cell) not in digests:
            raise UserError(
                f"{target.name}/{b.name}: is of a cell that {target.name}/study.toml does not have, expected one of its cells; "
                "restore that file, or run the study again."
            )
        if storage.read_footer(target, b.name) is None:
            raise UserError(
                f"{target.name}/{b.name}: is damaged, expected a complete block; run the study again to recompute it."
            )
    if not close.is_closed(target, blocks):
        raise UserError(
            f"{target.name}/stats.parquet: is not of the blocks in {target.name}/runs, expected a finished study; run it again "
            "to continue."
        )
    return Side(target, claim, stats, digests, block_files.series(blocks))


def _common_seeds(a: Side, b: Side) -> dict[Name, Seeds]:
    """Return the longest common range of seeds by cell and observer, if the two sides have different seeds."""
    if a.claim.study.root_seed != b.claim.study.root_seed:
        return {}
    out, draws = {}, b.draws
    for name, ranges in a.draws.items():
        overlaps = [common(i, j) for i in ranges for j in draws.get(name, [])]
        if ranges != draws.get(name) and any(seeds.many for seeds in overlaps):
            out[name] = max(overlaps, key=lambda seeds: seeds.many)
    return out


def _stats(side: Side, common_seeds: dict[Name, Seeds]) -> pd.DataFrame:
    """The rows of stats with the digest of their cell and their seeds; over the `common_seeds`, if there are any."""
    frame, draws, study = _over(side, common_seeds).to_pandas(), side.draws, side.claim.study
    values = {c.key: c.values for c in side.claim.cells}
    keys = list(zip(frame.scenario, frame.cell, strict=True))
    frame["digest"] = [side.digests[key] for key in keys]
    frame["where"] = [", ".join(f"{name}={values[key][name]}" for name in study.axes) for key in keys]
    names = list(zip(frame.scenario, frame.digest, frame.observer, strict=True))
    frame["draws"] = [
        f"{study.root_seed}: {[common_seeds[n]] if n in common_seeds else draws.get(n, EXACT)}" for n in names
    ]
    frame["narrowed"] = [name in common_seeds for name in names]
    numbers = ["n", "diverged", *(c for c in frame.columns[frame.columns.get_loc("mean") :] if frame[c].dtype == float)]
    frame["bits"] = [row.tobytes() for row in frame[numbers].to_numpy(float)]
    return frame[[*KEY, "where", "unit", "certified", "method", "draws", "narrowed", "n", "mean", "se", "bits"]]


def _over(side: Side, common_seeds: dict[Name, Seeds]) -> pa.Table:
    """The table stats, computed again over the common seeds if only some are common."""
    parts = []
    for cell in side.claim.cells if common_seeds else ():
        c = aggregate.of_cell(side.target, cell, side.blocks)
        for observer in c.blocks:
            within = common_seeds.get((cell.scenario.name, side.digests[cell.key], observer))
            single = c._replace(blocks={observer: c.blocks[observer]}, about={observer: c.about[observer]})
            parts.append(aggregate.rows_of(side.claim.study.name, single, within)[0])
    return pa.concat_tables(parts) if parts else side.stats


def compare_rows(joint: pd.DataFrame) -> pd.DataFrame:
    """Return matched rows with the difference, the p-value, Holm's p-value, and whether they changed."""
    a, b = (joint[f"mean_{side}"].to_numpy(float) for side in "ab")
    difference, size = b - a, np.fmax(np.abs(a), np.abs(b))
    relative = np.where(size > ZERO, np.abs(difference) / np.where(size > ZERO, size, 1.0), 0.0)
    same = (relative <= ROUNDING) | (np.abs(difference) <= ZERO)
    p = welch(*(joint[f"{name}_{side}"].to_numpy(float) for side in "ab" for name in ("mean", "se", "n")))
    p = np.where(same, np.nan, p)
    p_holm, same_draws = holm(p), (joint.draws_a == joint.draws_b).to_numpy()
    is_constant = joint.se_a.fillna(0.0).eq(0).to_numpy() & joint.se_b.fillna(0.0).eq(0).to_numpy()
    has_spread = joint.se_a.notna().to_numpy() & joint.se_b.notna().to_numpy()
    is_exact_change = ~same & ~np.isnan(a) & ~np.isnan(b) & is_constant & (has_spread | same_draws)
    is_missing = (np.isnan(a) != np.isnan(b)) & ~(joint.method_a.eq("none") | joint.method_b.eq("none")).to_numpy()
    changed = (p_holm < LEVEL) | is_exact_change | is_missing
    names = {"scenario": "scenario", "where_a": "where", "observer": "observer", "signal": "signal", "metric": "metric"}
    names |= {"unit_a": "unit"}
    columns = ["n_a", "mean_a", "se_a", "n_b", "mean_b", "se_b", "certified_a", "certified_b"]
    out = joint[[*names, *columns]].rename(columns=names)
    out = out.assign(difference=difference, relative=np.nan_to_num(relative), p_value=p, p_holm=p_holm)
    out = out.assign(same_draws=same_draws, changed=changed, identical=(joint.bits_a == joint.bits_b).to_numpy())
    out = out.assign(narrowed=joint.narrowed_a.to_numpy())
    rank_p = np.where(changed & np.isnan(p), 0.0, np.nan_to_num(p, nan=1.0))
    return out.iloc[np.lexsort((-out.relative, rank_p, ~changed))]


def welch(ma: Values, sa: Values, na: Values, mb: Values, sb: Values, nb: Values) -> Values:
    """Return Welch's two-sided p-values; NaN if a side has fewer than two runs, or neither varies.

    If one side is exact (no runs, standard error 0), it is Student's test of the other side.
    """
    va, vb = sa**2, sb**2
    usable = [(n > 1) | ((n == 0) & (s == 0)) for n, s in ((na, sa), (nb, sb))]
    comparable = usable[0] & usable[1] & (va + vb > 0)
    na, nb = np.maximum(na, 2), np.maximum(nb, 2)
    va, vb = np.where(comparable, va, 1.0), np.where(comparable, vb, 1.0)
    a, b = va / (va + vb), vb / (va + vb)  # variances may be so small that their squares are zero
    df = 1 / (a**2 / np.where(comparable, na - 1, 1) + b**2 / np.where(comparable, nb - 1, 1))
    return np.where(comparable, 2 * stdtr(df, -np.abs(mb - ma) / np.sqrt(va + vb)), np.nan)


def made_by(a: storage.Target, b: storage.Target) -> list[str]:
    """Return the differences of two provenances in libraries and machines, one phrase each."""
    records = [close.record(target) or {} for target in (a, b)]
    old, new = (_flat({k: r.get(k) for k in MADE_BY}) for r in records)
    keys = [k for k in dict.fromkeys([*old, *new]) if old.get(k) != new.get(k)]
    return [f"{k}: {old.get(k, 'nothing')} there, {new.get(k, 'nothing')} here" for k in keys]


def _flat(record: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    out: dict[str, object] = {}
    for key, value in record.items():
        out |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return out
