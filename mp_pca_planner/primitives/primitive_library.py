# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sets of primitive files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from ..exceptions import PrimitiveError
from .file import load_primitive
from .primitive import MovementPrimitive


def load_primitives(paths: Sequence[str | Path]) -> tuple[MovementPrimitive, ...]:
    """Read primitive files that are to be used together.

    Parameters
    ----------
    paths :
        Files, and folders of .npz files in the order of their names.

    Raises
    ------
    PrimitiveError
        If there is none, a file is rejected, two primitives have the same name, or they move
        different joints.
    """
    files: list[Path] = []
    for path in map(Path, paths):
        found = sorted(path.glob("*.npz")) if path.is_dir() else [path]
        if not found:
            raise PrimitiveError(f"the folder '{path}' holds no primitive file (.npz)")
        files += found
    if not files:
        raise PrimitiveError("no primitive file was named")
    primitives = [load_primitive(file) for file in files]
    origin: dict[str, Path] = {}
    for file, primitive in zip(files, primitives, strict=True):
        other = origin.setdefault(primitive.name, file)
        if other is not file:
            raise PrimitiveError(
                f"'{file}' and '{other}' both hold a primitive called '{primitive.name}': build "
                "one of them again with another --name"
            )
        if primitive.joint_names != primitives[0].joint_names:
            raise PrimitiveError(
                f"'{file}' moves {primitive.joint_names}, but '{files[0]}' moves "
                f"{primitives[0].joint_names}: they can't be used together"
            )
    return tuple(primitives)
