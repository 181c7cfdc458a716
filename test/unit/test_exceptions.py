# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Errors on their way out of worker processes."""

import pytest

from mp_pca_planner.exceptions import MissingDependencyError
from mp_pca_planner.recordings.workers import process_pool


def read_without_its_library(_: int) -> str:
    raise MissingDependencyError("pyarrow", "lerobot", "reading a LeRobot dataset")


def test_library_that_is_missing_in_a_worker_process_is_named() -> None:
    with (
        pytest.raises(MissingDependencyError, match=r"'pyarrow'.*\[lerobot\]") as caught,
        process_pool(2) as pool,
    ):
        list(pool.map(read_without_its_library, [1, 2]))
    assert (caught.value.module, caught.value.extra) == ("pyarrow", "lerobot")
