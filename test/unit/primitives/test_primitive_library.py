# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries in files against the same primitives in memory."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.arm import arm_primitive, file_bytes

from mp_pca_planner.exceptions import GoalError, PrimitiveError
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.library import PrimitiveLibrary, load_primitives
from mp_pca_planner.primitives.primitive import MovementPrimitive

NAMES = ["a", "b", "c", "d"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Four primitives in files."""
    for i, name in enumerate(NAMES):
        save_primitive(moved(name, 0.1 * i), tmp_path / f"{name}.npz")
    return tmp_path


def moved(name: str, by: float) -> MovementPrimitive:
    """The primitive of the arm for other configurations."""
    primitive = arm_primitive()
    model = replace(primitive.model, requests=primitive.model.requests + by)
    return replace(primitive, name=name, model=model)


def test_a_library_in_files_is_that_in_memory(folder: Path) -> None:
    in_memory = PrimitiveLibrary.of([moved(name, 0.1 * i) for i, name in enumerate(NAMES)])
    library = load_primitives([folder])
    assert list(library.names) == NAMES
    assert library.joint_names == in_memory.joint_names
    np.testing.assert_array_equal(library.means, in_memory.means)
    np.testing.assert_array_equal(library.precisions, in_memory.precisions)
    for own, other in zip(library, in_memory, strict=True):
        assert file_bytes(own) == file_bytes(other)


def test_an_unknown_name_is_refused_with_the_nearest_one(folder: Path) -> None:
    with pytest.raises(GoalError, match="no primitive is called 'dd' .did you mean 'd'"):
        load_primitives([folder]).named("dd")


def test_names_must_differ_in_memory() -> None:
    with pytest.raises(PrimitiveError, match="are both called 'a'"):
        PrimitiveLibrary.of([moved("a", 0.0), moved("a", 0.1)])
