"""The digest of a table is of what stands in it, however its columns are kept."""

import hashlib

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from pcbench.dataset import parquet_io

WORDS = st.lists(
    st.none() | st.sampled_from(["position", "it's", 'so "called"', "two\nlines", "größer", ""]), max_size=40
)


def by_definition(table):
    """Names, types, how many are null, and values: numbers as bytes, all else as Python writes a list of it."""
    out = hashlib.sha256()
    for name, column in zip(table.column_names, table.columns, strict=True):
        out.update(f"{name}:{column.type}:{column.null_count}".encode())
        values = column.to_pylist()
        number = pa.types.is_floating(column.type) or pa.types.is_integer(column.type)
        out.update(np.asarray(values).tobytes() if number else repr(values).encode())
    return out.hexdigest()[:32].encode()


@given(WORDS, st.integers(0, 40))
def test_a_digest_is_that_of_the_words_themselves_in_whatever_pieces_they_are(words, at):
    column = pa.chunked_array([pa.array(part, pa.string()) for part in (words[:at], words[at:])])
    table = pa.table({"signal": column, "mean": np.arange(len(words)) / 3, "certified": pa.array([True] * len(words))})
    assert parquet_io.seal_table(table).schema.metadata[parquet_io.SEAL] == by_definition(table)


@pytest.mark.parametrize("change", [{"signal": ["b", "a"]}, {"signal": ["a", None]}, {"mean": [1.0, 2.5]}])
def test_any_other_word_or_number_is_another_digest(change):
    columns = {"signal": ["a", "b"], "mean": [1.0, 2.0]}
    digests = {
        parquet_io.seal_table(pa.table(each)).schema.metadata[parquet_io.SEAL] for each in (columns, columns | change)
    }
    assert len(digests) == 2
