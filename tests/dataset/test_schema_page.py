"""The written schema of the tables is the one that a study leaves: names, order and types."""

import re

import pyarrow.parquet as pq
from documents import PAGES
from reference_pages import orders

PAGE = PAGES["columns.md"]
SECTIONS = dict(re.findall(r"^## (.*?)\n(.*?)(?=^## |\Z)", PAGE, re.S | re.M))
TYPES = dict(re.findall(r"^- `([\w.]+)` \((.*?)(?:, in .*?)?\): ", PAGE, re.M))
AXES = re.findall(r"^- `(\w+)`", SECTIONS["Axes"], re.M)


def test_tables_have_the_columns_of_the_page_in_their_order(whole):
    for name, order in orders().items():
        file = next((whole / "runs").rglob("*.parquet")) if name == "runs/" else whole / name
        schema = pq.ParquetFile(file).schema_arrow
        there = [column for column in schema.names if column not in AXES]
        asked = (
            "lq_cost",
            "input_rms",
            "nees",
            "nees_dof",
            "nis",
            "nis_dof",
            "signal_nees",
            "interval_width",
            "interval_coverage",
            "sent_fraction",
        )
        loops = {m for m in order if m.removeprefix("steady_") in asked}  # of closed loops, or of who asks for it
        assert there == [c for c in order if c not in loops and (name != "runs/" or c not in ("scenario", "observer"))]
        at = schema.names.index("cell") + 1
        axes = [c for c in schema.names if c in AXES]
        assert schema.names[at : at + len(axes)] == axes == [a for a in AXES if a in axes]
        for field in schema:
            assert str(field.type) in TYPES[field.name], field.name


def test_every_meaning_in_the_metadata_stands_on_the_page(whole):
    for field in pq.ParquetFile(whole / "stats.parquet").schema_arrow:
        assert field.metadata[b"meaning"].decode() in PAGE
