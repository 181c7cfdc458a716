# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The number of threads of BLAS during and after a block."""

import pytest
import scipy.linalg  # noqa: F401  (loads the BLAS of SciPy)
from threadpoolctl import threadpool_info, threadpool_limits

from mp_pca_planner.planning.context import one_blas_thread


def blas_threads() -> set[int]:
    return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}


@pytest.fixture(autouse=True)
def two_threads():
    with threadpool_limits(limits=2, user_api="blas"):
        if blas_threads() != {2}:
            pytest.skip(f"the BLAS of this machine uses {blas_threads()} threads, not 2")
        yield


def test_one_thread_within_a_block_and_the_former_number_after_it_even_after_an_error():
    with one_blas_thread(), one_blas_thread():
        assert blas_threads() == {1}
    assert blas_threads() == {2}
    with pytest.raises(ValueError, match="inside"), one_blas_thread():
        raise ValueError("inside")
    assert blas_threads() == {2}
