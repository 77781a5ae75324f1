"""A small study, and what it leaves in a folder."""

import pandas as pd

STUDY = {
    "name": "small",
    "scenarios": ["cart/slow"],
    "observers": ["pccebo", "kfbo"],
    "seeds": 40,
    "axes": {"noise_std": [0.1, 0.5]},
}
KEY = ["scenario", "observer", "cell", "seed", "signal"]


def tables(out):
    """Every table of a folder by name, as bytes."""
    return {str(p.relative_to(out)): p.read_bytes() for p in sorted(out.rglob("*.parquet"))}


def rows(out):
    """The runs of a folder in one order."""
    return pd.read_parquet(out / "runs").sort_values(KEY, ignore_index=True)


def same(a, b):
    """The same runs and the same closing tables, however cut."""
    pd.testing.assert_frame_equal(rows(a), rows(b), check_exact=True)
    for name in ("stats.parquet", "pairs.parquet"):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
