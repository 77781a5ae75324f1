"""Values as JSON and TOML have them."""

import json

import numpy as np

from pcbench.json_values import json_values


def test_each_kind_of_value_has_one_form():
    given = {"a": np.array([[1.0, np.nan]]), 2: (np.int64(3), True, "x", None), "c": 1 + 2j, "d": np.float64(-np.inf)}
    assert json_values(given) == {
        "a": [[1.0, None]],
        "2": [3, True, "x", None],
        "c": {"real": 1.0, "imag": 2.0},
        "d": "-inf",
    }
    json.dumps(json_values(given), allow_nan=False)


def test_without_nulls_entries_that_are_unknown_are_left_out():
    assert json_values({"a": np.nan, "b": {"c": None, "d": [None, 1]}}, nulls=False) == {"b": {"d": [None, 1]}}
