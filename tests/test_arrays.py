"""Sums at places of an array."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vergence.arrays import scatter_add


@given(st.integers(0, 2**31), st.integers(0, 12), st.integers(1, 4), st.integers(1, 5))
def test_values_at_the_same_place_add_up(seed, rows, columns, size):
    rng = np.random.default_rng(seed)
    block, index = rng.integers(0, 3, rows), rng.integers(0, size, (rows, columns))
    values = rng.normal(size=(rows, columns, 2))
    wanted = np.zeros((3, size, 2))
    np.add.at(wanted, (block[:, None], index), values)
    places = (block[:, None, None], index[:, :, None], np.arange(2))
    np.testing.assert_array_equal(scatter_add(values, places, (3, size, 2)), wanted)
