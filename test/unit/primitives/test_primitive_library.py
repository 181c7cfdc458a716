# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Libraries in files against the same primitives in memory."""

from dataclasses import replace

import pytest
from support.arm import arm_primitive, file_bytes

from mp_pca_planner.exceptions import GoalError, PrimitiveError
from mp_pca_planner.primitives.library import PrimitiveLibrary, load_primitives


def moved(name, by):
    """The primitive of the arm for other configurations."""
    primitive = arm_primitive()
    model = replace(primitive.model, requests=primitive.model.requests + by)
    return replace(primitive, name=name, model=model)


def test_files_and_folders_make_the_library_that_they_make_in_memory(tmp_path):
    primitives = [moved(name, 0.1 * i) for i, name in enumerate("dabc")]
    in_memory, folder = PrimitiveLibrary.of(primitives), tmp_path / "more"
    folder.mkdir()
    (folder / "notes.txt").write_text("no primitive")
    for primitive in primitives:
        place = tmp_path if primitive.name == "d" else folder
        primitive.save(place / f"{primitive.name}.npz")
    library = load_primitives([tmp_path / "d.npz", folder])
    assert list(library.names) == list("dabc") and library.joint_names == in_memory.joint_names
    assert list(map(file_bytes, library)) == list(map(file_bytes, primitives))
    assert library.named("a") is library[1]
    with pytest.raises(GoalError, match="no primitive is called 'dd' .did you mean 'd'"):
        library.named("dd")


def test_what_makes_no_library_is_refused(tmp_path):
    for name in ("primitive", "twin"):
        arm_primitive().save(tmp_path / f"{name}.npz")
    (tmp_path / "empty").mkdir()
    for paths, message in (
        ([], "no primitive file was named"),
        ([tmp_path / "empty"], "empty' holds no primitive file"),
        ([tmp_path], r"twin\.npz.*primitive\.npz.*'arm_arm_4'"),
    ):
        with pytest.raises(PrimitiveError, match=message):
            load_primitives(paths)
    other = replace(moved("b", 0.0), joint_names=tuple("abcd"))
    for primitives, message in (
        ([moved("a", 0.0), moved("a", 0.1)], "are both called 'a'"),
        ([moved("a", 0.0), other], "'b' moves 'a', .* can't be used together"),
        ([tmp_path], "is not a movement primitive"),
    ):
        with pytest.raises(PrimitiveError, match=message):
            PrimitiveLibrary.of(primitives)
