# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries in files against the same primitives in memory."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from arm import arm_demonstrations, arm_primitive, arm_robot

from mp_pca_planner.exceptions import GoalError, PrimitiveError, PrimitiveFileError
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.primitives.file import save_primitive
from mp_pca_planner.primitives.library import library as library_module
from mp_pca_planner.primitives.library.index import INDEX_NAME
from mp_pca_planner.primitives.library.library import (
    LibraryOptions,
    PrimitiveLibrary,
    load_primitives,
)
from mp_pca_planner.primitives.primitive import MovementPrimitive

NAMES = ["a", "b", "c", "d"]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Four primitives in files, which are too many to be read at once."""
    monkeypatch.setattr(library_module, "_OPTIONS", LibraryOptions(max_loaded=2, max_kept=2))
    for i, name in enumerate(NAMES):
        save_primitive(moved(name, 0.1 * i), tmp_path / f"{name}.npz")
    return tmp_path


def moved(name: str, by: float) -> MovementPrimitive:
    """The primitive of the arm for other configurations."""
    primitive = arm_primitive()
    model = replace(primitive.model, requests=primitive.model.requests + by)
    return replace(primitive, name=name, model=model)


def hide_damage(file: Path) -> None:
    """Damage a file so that its size and time stay."""
    status = file.stat()
    file.write_bytes(b"x" * status.st_size)
    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


def test_a_library_in_files_is_that_in_memory(folder: Path) -> None:
    in_memory = PrimitiveLibrary.of([moved(name, 0.1 * i) for i, name in enumerate(NAMES)])
    for library in (load_primitives([folder]), load_primitives([folder])):
        assert list(library.names) == NAMES
        assert library.joint_names == in_memory.joint_names
        np.testing.assert_array_equal(library.means, in_memory.means)
        np.testing.assert_array_equal(library.precisions, in_memory.precisions)
        for own, other in zip(library, in_memory, strict=True):
            for name, array in other.arrays().items():
                np.testing.assert_array_equal(own.arrays()[name], array)


def test_a_plan_is_the_same_from_files_and_from_memory(folder: Path) -> None:
    robot, library = arm_robot(), load_primitives([folder])
    ends = (
        JointState(robot.joint_names, q) for q in arm_demonstrations(1, 9)[0].positions[[0, -1]]
    )
    start, goal = ends
    first, second = (
        Planner(robot, primitives).plan(JointGoal(goal), start)
        for primitives in (library, list(library))
    )
    assert first.primitive == second.primitive
    np.testing.assert_array_equal(first.trajectory.positions, second.trajectory.positions)


def test_only_the_files_that_are_used_are_read_again(folder: Path) -> None:
    load_primitives([folder])
    hide_damage(folder / "b.npz")
    library = load_primitives([folder])
    assert library.named("c").name == "c"
    with pytest.raises(PrimitiveFileError, match=r"b\.npz"):
        library.named("b")


def test_changed_new_and_removed_files_are_noticed(folder: Path) -> None:
    load_primitives([folder])
    save_primitive(moved("b", 0.7), folder / "b.npz", overwrite=True)
    save_primitive(moved("e", 0.5), folder / "e.npz")
    (folder / "a.npz").unlink()
    library = load_primitives([folder])
    assert list(library.names) == ["b", "c", "d", "e"]
    assert library.means[0] == pytest.approx(moved("b", 0.7).model.mean)


def test_a_file_that_changes_after_its_folder_was_read_is_refused(folder: Path) -> None:
    library = load_primitives([folder])
    save_primitive(moved("b", 0.7), folder / "b.npz", overwrite=True)
    (folder / "c.npz").unlink()
    with pytest.raises(PrimitiveFileError, match=r"b\.npz' has changed.*reload_primitives"):
        library.named("b")
    with pytest.raises(PrimitiveFileError, match=r"c\.npz.*No such file"):
        library.named("c")


@pytest.mark.parametrize("content", [b"", b"no archive", None])
def test_an_unusable_index_is_made_anew(folder: Path, content: bytes | None) -> None:
    load_primitives([folder])
    index = folder / INDEX_NAME
    good = index.read_bytes()
    index.write_bytes(good[: len(good) // 2] if content is None else content)
    assert list(load_primitives([folder]).names) == NAMES
    assert index.read_bytes() == good


def test_an_index_of_other_shapes_is_made_anew(folder: Path) -> None:
    load_primitives([folder])
    index = folder / INDEX_NAME
    good = index.read_bytes()
    with np.load(index) as content:
        arrays = dict(content)
    for name, array in arrays.items():
        with index.open("wb") as file:
            np.savez(file, **{**arrays, name: array[:-1]})
        load_primitives([folder])
        assert index.read_bytes() == good


def test_a_folder_that_cannot_hold_an_index_is_read_each_time(folder: Path) -> None:
    (folder / INDEX_NAME).mkdir()
    assert list(load_primitives([folder]).names) == NAMES


def test_files_that_do_not_belong_together_are_refused(folder: Path) -> None:
    save_primitive(moved("a", 0.3), folder / "twin.npz")
    with pytest.raises(PrimitiveError, match=r"twin\.npz' and .*a\.npz' both hold .* 'a'"):
        load_primitives([folder])


def test_an_unknown_name_is_refused_with_the_nearest_one(folder: Path) -> None:
    with pytest.raises(GoalError, match="no primitive is called 'dd' .did you mean 'd'"):
        load_primitives([folder]).named("dd")


def test_names_must_differ_in_memory() -> None:
    with pytest.raises(PrimitiveError, match="several primitives are called 'a'"):
        PrimitiveLibrary.of([moved("a", 0.0), moved("a", 0.1)])
