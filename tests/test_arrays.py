"""Sums at places of an array, and the limit on the threads of BLAS."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from threadpoolctl import ThreadpoolController

from vergence.arrays import scatter_add, single_blas_thread


@given(st.integers(0, 2**31), st.integers(0, 12), st.integers(1, 4), st.integers(1, 5))
def test_values_at_the_same_place_add_up(seed, rows, columns, size):
    rng = np.random.default_rng(seed)
    block, index = rng.integers(0, 3, rows), rng.integers(0, size, (rows, columns))
    values = rng.normal(size=(rows, columns, 2))
    wanted = np.zeros((3, size, 2))
    np.add.at(wanted, (block[:, None], index), values)
    places = (block[:, None, None], index[:, :, None], np.arange(2))
    np.testing.assert_array_equal(scatter_add(values, places, (3, size, 2)), wanted)


def blas_threads() -> list[int]:
    found = ThreadpoolController().select(user_api="blas").lib_controllers
    return [library.get_num_threads() for library in found]


def test_blas_has_one_thread_until_the_last_user_is_done(monkeypatch: pytest.MonkeyPatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.delenv(name, raising=False)
    with ThreadpoolController().limit(limits=2, user_api="blas"):
        with single_blas_thread():
            with pytest.raises(ValueError, match="an error within"), single_blas_thread():
                raise ValueError("an error within")
            assert set(blas_threads()) == {1}
        assert set(blas_threads()) == {2}


def test_a_number_of_threads_in_the_environment_is_respected(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("OPENBLAS_NUM_THREADS", "2")
    with ThreadpoolController().limit(limits=2, user_api="blas"), single_blas_thread():
        assert set(blas_threads()) == {2}
