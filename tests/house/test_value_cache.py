"""A function with its results kept by value: once for equal arguments, again for others, in the arrays' own bits."""

import numpy as np
import pytest

from pcbench.value_cache import cached_by_value, key_of


@pytest.fixture
def asked():
    calls = []

    @cached_by_value
    def function(A, scale=1.0, where=""):
        assert A.flags.c_contiguous
        calls.append((A.copy(), scale))
        return scale * A

    return function, calls


def test_equal_arguments_are_computed_once(asked):
    function, calls = asked
    A = np.arange(6.0).reshape(2, 3)
    first = function(A, 2.0)
    assert function(A.copy(), 2.0) is first
    assert function(np.asfortranarray(A), 2.0) is first
    assert len(calls) == 1


@pytest.mark.parametrize("change", [{"scale": 3.0}, {"where": "there"}, {"scale": -0.0}])
def test_another_argument_is_another_call(asked, change):
    function, calls = asked
    A = np.arange(6.0).reshape(2, 3)
    function(A, scale=0.0)
    given = {"scale": 0.0} | change
    np.testing.assert_array_equal(function(A, **given), given["scale"] * A)
    function(A.reshape(3, 2), scale=0.0)
    assert len(calls) == 3


def test_arrays_differ_by_bits_and_shapes():
    arrays = [np.zeros(2), -np.zeros(2), np.zeros((2, 1)), np.array([0.0, np.nextafter(0, 1)]), np.zeros(2, int)]
    assert len({key_of(a) for a in arrays}) == len(arrays)
    assert key_of(np.array([np.nan])) == key_of(np.array([np.nan]))


def test_a_mistake_is_made_again():
    @cached_by_value
    def fails(A):
        raise ValueError(str(len(A)))

    for _ in range(2):
        with pytest.raises(ValueError, match="2"):
            fails(np.zeros(2))
