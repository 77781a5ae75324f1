"""Two results of one study, of two releases or two machines: what changed beyond its interval. Nothing is written. No jax.

A row of stats is matched by scenario, cell (the digest of all that decides it, whatever its number), observer, signal and
metric. Where both stand on the same draws the numbers should be equal, but for rounding; where they are not equal, or the
draws are others, means are compared by Welch's t (Biometrika 34 (1947), 28-35) on mean, standard error and n,

    t = (b - a) / sqrt(va + vb),   df = (va + vb)^2 / (va^2 / (na - 1) + vb^2 / (nb - 1)),   v = se^2,

with Holm's correction over all rows so tested. On the same draws the test is conservative: it takes them for independent. Where
only some seeds are common, rows are made anew over those: Welch's t supposes that none are.
A number without spread (no noise) has changed where it differs by more than rounding; one that exists on one side only, too.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.special import stdtr

from pcbench.dataset import aggregate, block_files, close, columns, manifest, storage
from pcbench.dataset.block_files import Block
from pcbench.dataset.manifest import Owned
from pcbench.dataset.seed_ranges import Seeds, common, joined
from pcbench.dataset.table_diff import ROUNDING, ZERO
from pcbench.errors import UserError
from pcbench.statistics.comparison import holm
from pcbench.statistics.estimates import Values
from pcbench.study import Study
from pcbench.study.grid import identity, rooted
from pcbench.study.serialize import to_toml

LEVEL = 0.05
KEY = ["scenario", "digest", "observer", "signal", "metric"]
MADE_BY = (
    "versions",
    "compiler",
    "device",
    "system",
    "precision",
    "flow",
    "git",
)  # of a provenance: what may decide the last bits


class Comparison(NamedTuple):
    """What differs between two results, b less a."""

    rows: pd.DataFrame  # matched, the most surely changed first; columns of `judged`
    only: tuple[int, int]  # rows that stand in a alone, and in b alone
    made_by: list[str]  # what differs in versions and machines, a phrase each

    @property
    def changed(self) -> int:
        """How many rows changed beyond their interval."""
        return int(self.rows.changed.sum())

    @property
    def identical(self) -> bool:
        """Whether all that was compared on the same draws is the same to the bit."""
        return bool(self.rows.identical[self.rows.same_draws].all())

    @property
    def largest(self) -> float:
        """The largest relative difference among rows on the same draws; 0 without any."""
        return float(np.max(self.rows.relative[self.rows.same_draws].to_numpy(), initial=0.0))


def compare(a: str | Path, b: str | Path) -> Comparison:
    """Compare two folders; raise UserError where they hold different studies, are damaged, or lack closing tables.

    Of blocks only the footers are read: `verify` reads them whole.
    """
    targets = storage.target(a), storage.target(b)
    holdings = manifest.opened(targets[0]), manifest.opened(targets[1])
    if found := manifest.differences(holdings[0], _rooted(holdings[1], holdings[0].study)):
        raise UserError(
            f"{targets[1].name}: is of another study than {targets[0].name} ({'; '.join(found[:3])}), expected the same study; "
            "compare results of one study."
        )
    sides = [_side(target, owned) for target, owned in zip(targets, holdings, strict=True)]
    shared = _shared(*sides)
    left, right = (_stats(side, shared) for side in sides)
    both = left.merge(right, on=KEY, how="outer", suffixes=("_a", "_b"), indicator=True)
    only = int((both._merge == "left_only").sum()), int((both._merge == "right_only").sum())
    rows = judged(both[both._merge == "both"].drop(columns="_merge"))
    return Comparison(rows, only, made_by(*targets))


def _rooted(owned: Owned, other: Study) -> Owned:
    """A claim as it would be with the root seed of another study: that makes no other study here."""
    if other.root_seed == owned.study.root_seed:  # as it is: options of a user's observer may not be known here
        return owned
    study = owned.study.model_copy(update={"root_seed": other.root_seed})
    every = rooted(owned.cells, other.root_seed)
    return Owned(study, every, to_toml(study, every))


class Side(NamedTuple):
    """One of two results."""

    target: storage.Target
    owned: Owned
    stats: pa.Table
    digests: dict[tuple[str, int], str]  # what tells its cells from all others, whatever their root seed and number
    blocks: dict[tuple[str, int, str], list[Block]]  # by scenario, cell and observer


def _side(target: storage.Target, owned: Owned) -> Side:
    """Return a result; raise UserError where it is not finished or not whole."""
    found = close.table(target, "stats.parquet")
    if found is None:
        raise UserError(
            f"{target.name}/stats.parquet: is not there or damaged, expected a finished study; run it again to go on."
        )
    blocks: dict[tuple[str, int, str], list[Block]] = {}
    digests = {c.key: identity(c, 0) for c in owned.cells}
    there = sorted(block_files.settled(block_files.present(target)))
    for b in there:
        if (b.scenario, b.cell) not in digests:
            raise UserError(
                f"{target.name}/{b.name}: is of a cell that {target.name}/study.toml does not have, expected one of its cells; "
                "restore that file, or run the study again."
            )
        if storage.footer(target, b.name) is None:
            raise UserError(
                f"{target.name}/{b.name}: is damaged, expected a whole block; run the study again to have it redone."
            )
        blocks.setdefault((b.scenario, b.cell, b.observer), []).append(b)
    if not close.is_closed(target, there):
        raise UserError(
            f"{target.name}/stats.parquet: is not of the blocks in {target.name}/runs, expected a finished study; run it again "
            "to go on."
        )
    return Side(target, owned, found, digests, blocks)


EXACT = "no draws: exact"
Draws = dict[tuple[str, str, str], list[Seeds]]  # by scenario, cell's digest and observer, joined
CommonSeeds = dict[tuple[str, str, str], Seeds]  # the same, of the seeds that two sides have in common


def _drawn(side: Side) -> Draws:
    out: Draws = {}
    for (scenario, cell, observer), mine in side.blocks.items():
        out[scenario, side.digests[scenario, cell], observer] = joined(b.seeds for b in mine)
    return out


def _shared(a: Side, b: Side) -> CommonSeeds:
    """Return by cell and observer, where two sides hold different seeds, the longest range that both hold."""
    if a.owned.study.root_seed != b.owned.study.root_seed:
        return {}
    out, here = {}, _drawn(b)
    for key, mine in _drawn(a).items():
        both = [common(i, j) for i in mine for j in here.get(key, [])]
        if here.get(key) not in (None, mine) and any(seeds.many for seeds in both):
            out[key] = max(both, key=lambda seeds: seeds.many)
    return out


def _stats(side: Side, shared: CommonSeeds) -> pd.DataFrame:
    """The rows of stats with their cells' digests and the draws they stand on; over the `shared` seeds, if any."""
    frame, drawn, root = _over(side, shared).to_pandas(), _drawn(side), side.owned.study.root_seed
    cells = {c.key: c for c in side.owned.cells}
    keys = list(zip(frame.scenario, frame.cell, strict=True))
    frame["digest"] = [side.digests[key] for key in keys]
    frame["where"] = [_where(cells[key].values, list(side.owned.study.axes)) for key in keys]
    named = list(zip(frame.scenario, frame.digest, frame.observer, strict=True))
    frame["draws"] = [f"{root}: {[shared[name]] if name in shared else drawn.get(name, EXACT)}" for name in named]
    frame["narrowed"] = [name in shared for name in named]
    numbers = ["n", "diverged", *(c for c in frame.columns[frame.columns.get_loc("mean") :] if frame[c].dtype == float)]
    frame["bits"] = [row.tobytes() for row in frame[numbers].to_numpy(float)]
    return frame[[*KEY, "where", "unit", "certified", "method", "draws", "narrowed", "n", "mean", "se", "bits"]]


def _over(side: Side, shared: CommonSeeds) -> pa.Table:
    """The table stats, made anew of the runs where only some of the seeds are common."""
    axes = columns.axes_of(dict.fromkeys(side.stats.column_names))
    parts = []
    for cell in side.owned.cells if shared else ():
        found = aggregate.observed(side.target, cell, side.blocks)
        for observer, each in found.items():
            within = shared.get((cell.scenario.name, side.digests[cell.key], observer))
            rows, _ = aggregate.rows_of(side.target, side.owned.study.name, cell, {observer: each}, within)
            parts.append(rows.table(columns.stats_order(axes)))
    return pa.concat_tables(parts) if parts else side.stats


def _where(values: dict[str, Any], axes: list[str]) -> str:
    return ", ".join(f"{name}={values[name]}" for name in axes)


def judged(both: pd.DataFrame) -> pd.DataFrame:
    """Return matched rows with what came of them: difference, p-value, Holm's, and whether they changed."""
    a, b = (both[f"mean_{side}"].to_numpy(float) for side in "ab")
    difference, size = b - a, np.fmax(np.abs(a), np.abs(b))
    relative = np.where(size > ZERO, np.abs(difference) / np.where(size > ZERO, size, 1.0), 0.0)
    same = (relative <= ROUNDING) | (np.abs(difference) <= ZERO)
    here = ~np.isnan(a), ~np.isnan(b)
    p = welch(*(both[f"{what}_{side}"].to_numpy(float) for side in "ab" for what in ("mean", "se", "n")))
    p = np.where(same, np.nan, p)
    adjusted = holm(p)
    same_draws = (both.draws_a == both.draws_b).to_numpy()
    still = both.se_a.fillna(0.0).eq(0).to_numpy() & both.se_b.fillna(0.0).eq(0).to_numpy()
    spread = both.se_a.notna().to_numpy() & both.se_b.notna().to_numpy()
    without = ~same & here[0] & here[1] & still & (spread | same_draws)
    lost = (here[0] != here[1]) & ~(both.method_a.eq("none") | both.method_b.eq("none")).to_numpy()
    changed = (adjusted < LEVEL) | without | lost
    out = both[["scenario", "where_a", "observer", "signal", "metric", "unit_a"]].copy()
    out.columns = pd.Index(["scenario", "where", "observer", "signal", "metric", "unit"])
    names = ["n_a", "mean_a", "se_a", "n_b", "mean_b", "se_b"]
    names += ["certified_a", "certified_b"]
    out = out.assign(**{name: both[name] for name in names}, difference=difference, relative=np.nan_to_num(relative))
    out = out.assign(p_value=p, p_holm=adjusted, same_draws=same_draws, changed=changed)
    out = out.assign(identical=(both.bits_a == both.bits_b).to_numpy(), narrowed=both.narrowed_a.to_numpy())
    order = out.assign(sure=np.where(changed & np.isnan(p), 0.0, np.nan_to_num(p, nan=1.0)))
    return order.sort_values(["changed", "sure", "relative"], ascending=[False, True, False], kind="stable").drop(
        columns="sure"
    )


def welch(ma: Values, sa: Values, na: Values, mb: Values, sb: Values, nb: Values) -> Values:
    """Return Welch's two-sided p-values; NaN where a side has fewer than two runs, or neither varies.

    Of a side that is exact (no runs, no error) it is Student's of the other.
    """
    va, vb = sa**2, sb**2
    enough = [(n > 1) | ((n == 0) & (s == 0)) for n, s in ((na, sa), (nb, sb))]
    known = enough[0] & enough[1] & (va + vb > 0)
    na, nb = np.maximum(na, 2), np.maximum(nb, 2)
    va, vb = np.where(known, va, 1.0), np.where(known, vb, 1.0)
    a, b = va / (va + vb), vb / (va + vb)  # variances may be so small that their squares are zero
    df = 1 / (a**2 / np.where(known, na - 1, 1) + b**2 / np.where(known, nb - 1, 1))
    return np.where(known, 2 * stdtr(df, -np.abs(mb - ma) / np.sqrt(va + vb)), np.nan)


def made_by(a: storage.Target, b: storage.Target) -> list[str]:
    """Return how two provenances differ in libraries and machines, a phrase each."""
    there, here = (close.record(target) or {} for target in (a, b))
    exact = 0 in (there.get("blocks"), here.get("blocks"))  # no runs there, so none went any way
    old, new = (_flat({k: each.get(k) for k in MADE_BY if not (exact and k == "flow")}) for each in (there, here))
    keys = [k for k in dict.fromkeys([*old, *new]) if old.get(k) != new.get(k)]
    return [f"{k}: {old.get(k, 'nothing')} there, {new.get(k, 'nothing')} here" for k in keys]


def _flat(said: dict[str, Any], under: str = "") -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in said.items():
        out |= _flat(value, f"{under}{key}.") if isinstance(value, dict) else {f"{under}{key}": value}
    return out
