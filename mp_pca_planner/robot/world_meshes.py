# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files of obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import WorldError, printable, quote_names
from ..files import open_regular, reading
from ..input_limits import INPUT_LIMITS
from .bodies import coal


def read_mesh(resource: str, package_dirs: Sequence[Path]) -> tuple[FloatArray, NDArray[np.intp]]:
    """Read a mesh file, such as STL, OBJ or COLLADA.

    Parameters
    ----------
    resource : str
        ``package://package/path``, ``file:///path`` or a path.
    package_dirs : sequence of Path
        Folders of packages.

    Returns
    -------
    vertices : array, shape (n_vertices, 3)
        Coordinates in the units of the file.
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.

    Raises
    ------
    WorldError
        If the file can't be found or read.
    """
    path = find_file(resource, package_dirs) if "://" in resource else Path(resource)
    if path is None:
        raise WorldError(
            f"mesh '{printable(resource)}' was not found in the packages of "
            f"{quote_names(map(str, package_dirs))} (package_dirs); accepted are "
            "package://package/path and file:///path"
        )
    with reading(f"mesh '{printable(resource)}'", WorldError):
        with open_regular(path) as file:
            if file.seek(0, 2) > INPUT_LIMITS.mesh_bytes:
                raise ValueError(f"it is larger than {INPUT_LIMITS.mesh_bytes:,} bytes")
        found = coal.MeshLoader().load(str(path), np.ones(3))
        if not 1 <= found.num_tris <= INPUT_LIMITS.triangles:
            raise ValueError(
                f"it has {found.num_tris} triangles, 1 to {INPUT_LIMITS.triangles} are accepted"
            )
        vertices = np.array(found.vertices())
        triangles = [[t[0], t[1], t[2]] for t in map(found.tri_indices, range(found.num_tris))]
    return vertices, np.array(triangles, dtype=np.intp)


def find_file(resource: str, folders: Sequence[Path]) -> Path | None:
    """The file of a mesh: ``package://package/path``, ``file:///path``, or a path.

    Relative paths, and packages by their names, are searched in some folders; a folder may be the
    package itself, as the URDF reader accepts it.
    """
    scheme, mark, rest = resource.partition("://")
    relative = Path(rest if mark else resource)
    if relative.is_absolute():
        return relative if relative.is_file() else None
    candidates = [folder / relative for folder in folders]
    if scheme == "package":
        package, *inner = relative.parts
        candidates += [folder.joinpath(*inner) for folder in folders if folder.name == package]
    return next((path for path in candidates if path.is_file()), None)
