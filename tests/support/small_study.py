"""A small study, and what it leaves in a folder."""

import hashlib
import json

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


def reseal(out, **said):
    """Let a folder say of itself what `said` says, with the digests of its tables as they are: as another release might."""
    path = out / "provenance.json"
    about = json.loads(path.read_text()) | said
    about["digests"] = {name: hashlib.sha256((out / name).read_bytes()).hexdigest()[:32] for name in about["digests"]}
    text = json.dumps({k: v for k, v in about.items() if k != "digest"}, sort_keys=True)
    path.write_text(json.dumps(about | {"digest": hashlib.sha256(text.encode()).hexdigest()[:32]}))


def rows(out):
    """The runs of a folder in one order."""
    return pd.read_parquet(out / "runs").sort_values(KEY, ignore_index=True)


def same(a, b):
    """The same runs and the same closing tables, however cut."""
    pd.testing.assert_frame_equal(rows(a), rows(b), check_exact=True)
    for name in ("stats.parquet", "pairs.parquet"):
        assert (a / name).read_bytes() == (b / name).read_bytes(), name
