# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Arrays in temporary files, against the same arrays in memory."""

import tempfile
from pathlib import Path

import numpy as np
import pytest

from mp_pca_planner.arrays import (
    BLOCK,
    empty_rows,
    file_of,
    frozen_array,
    release,
    row_blocks,
    row_mean,
)
from mp_pca_planner.exceptions import PlannerError

KINDS = {"a": (float, (3, 2)), "b": (float, ()), "c": (float, (0,)), "d": ("S3", ())}


@pytest.mark.parametrize("n_rows", [1, BLOCK, 20 * BLOCK + 3])
def test_rows_are_kept_and_come_in_blocks(n_rows):
    rng = np.random.default_rng(0)
    shapes = {"a": (3, 2), "b": (), "c": (0,)}
    expected = {name: rng.normal(size=(n_rows, *shape)) for name, shape in shapes.items()}
    expected["d"] = rng.integers(1000, size=n_rows).astype("S3")
    found = empty_rows(n_rows, KINDS)
    for name, array in found.items():
        array[:] = expected[name]
        release(array)
    for array in (found["a"], found["b"][1:]):
        assert (file_of(array) is not None) == (n_rows > BLOCK)
    blocks = list(row_blocks(*found.values()))
    assert len(blocks) == -(-n_rows // BLOCK)
    for array, parts in zip(expected.values(), zip(*blocks, strict=True), strict=True):
        np.testing.assert_array_equal(np.concatenate(parts), array)
    np.testing.assert_allclose(row_mean(found["a"]), expected["a"].mean(axis=0), atol=1e-12)


def test_released_rows_take_no_memory():
    def resident() -> int:
        """Memory of this process in files [kB]."""
        lines = Path("/proc/self/status").read_text().splitlines()
        return sum(int(x.split()[1]) for x in lines if x.startswith(("RssFile", "RssShmem")))

    array = empty_rows(4_000_000, {"x": (float, ())})["x"]
    array[:] = 1.0
    used = resident()
    release(array)
    assert used - resident() > 25_000
    assert array.sum() == array.size


def test_a_frozen_array_in_a_file_is_no_copy_and_is_checked():
    array = empty_rows(100_000, {"x": (float, (1,))})["x"]
    array[:] = 0.0
    array[70_000] = np.nan
    with pytest.raises(PlannerError, match=r"x\[70000, 0\] is nan"):
        frozen_array(array, (None, 1), "x", PlannerError)
    array[70_000] = 2.0
    frozen = frozen_array(array, (None, 1), "x", PlannerError)
    assert np.shares_memory(frozen, array) and not frozen.flags.writeable


def test_a_full_disk_is_one_sentence():
    with pytest.raises(PlannerError, match="set TMPDIR to a folder with more space") as refusal:
        empty_rows(1 << 50, {"x": (float, ())})
    assert tempfile.gettempdir() in str(refusal.value)
