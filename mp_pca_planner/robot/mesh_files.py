# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files of obstacles and links."""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..arrays import FloatArray
from ..exceptions import WorldError, printable, quote_names
from ..files import read_bytes, reading
from ..input_limits import INPUT_LIMITS
from .mesh_formats import PARSERS, MeshContent
from .mesh_process import MeshProcess


class MeshFiles:
    """Mesh files that were read, by their content.

    A file is parsed once in a process of its own, whether it is accepted or not. The least recently
    used ones are forgotten.
    """

    def __init__(self) -> None:
        self._process, self._lock = MeshProcess(), threading.Lock()
        self._parsed: dict[tuple[bytes, str], MeshContent | str] = {}

    def parsed(self, content: bytes, suffix: str) -> MeshContent:
        """The mesh in the content of a file; ValueError or RuntimeError with the reason if none."""
        key = hashlib.sha256(content).digest(), suffix
        with self._lock:
            found = self._parsed.pop(key, None)
        if found is None:
            try:
                found = self._process.parse(content, suffix)
            except (ValueError, RuntimeError) as error:
                found = str(error)
        with self._lock:
            self._parsed[key] = found
            while len(self._parsed) > 1 and (
                len(self._parsed) > INPUT_LIMITS.kept_meshes
                or sum(map(_size, self._parsed.values())) > INPUT_LIMITS.mesh_triangles
            ):
                del self._parsed[next(iter(self._parsed))]
        if isinstance(found, str):
            raise ValueError(found)
        return found


def _size(parsed: MeshContent | str) -> int:
    return 0 if isinstance(parsed, str) else len(parsed.triangles)


_FILES = MeshFiles()


def read_mesh(path: Path, resource: str = "") -> MeshContent:
    """Read a mesh file, STL, OBJ or COLLADA (.dae).

    Parameters
    ----------
    path : Path
        The file.
    resource : str
        Its name in messages; the path by default.

    Raises
    ------
    WorldError
        If it can't be read, is of another format, or is too large.
    """
    with reading(f"mesh '{printable(resource or str(path))}'", WorldError):
        suffix = path.suffix.lower()
        if suffix not in PARSERS:
            raise ValueError(f"accepted are files of the formats {', '.join(PARSERS)}")
        return _FILES.parsed(read_bytes(path, INPUT_LIMITS.mesh_bytes), suffix)


def find_mesh(resource: str, folders: Sequence[Path]) -> MeshContent:
    """Read the mesh file that a URDF or a marker names.

    Parameters
    ----------
    resource : str
        ``package://package/path``, ``file:///path`` or a path.
    folders : sequence of Path
        Folders of packages, and of relative paths.

    Raises
    ------
    WorldError
        If the file can't be found or read.
    """
    with reading(f"mesh '{printable(resource):.200}'", WorldError):
        path = find_file(resource, folders)
    if path is None:
        raise WorldError(
            f"mesh '{printable(resource):.200}' was not found, searched in "
            f"{quote_names(map(str, folders))} (package_dirs); accepted are "
            "package://package/path, file:///path and a path"
        )
    return read_mesh(path, resource)


def scaled(vertices: FloatArray, scale: FloatArray) -> FloatArray:
    """Vertices times the scale of a mesh along x, y and z.

    Raises
    ------
    WorldError
        If a scale is 0: the mesh would have no extent there.
    """
    if not np.all(scale):
        numbers = ", ".join(f"{number:g}" for number in scale)
        raise WorldError(f"scale of a mesh must not be 0, got {numbers}")
    with np.errstate(over="ignore"):
        return np.asarray(vertices * scale)


def find_file(resource: str, folders: Sequence[Path]) -> Path | None:
    """The file of a mesh: ``package://package/path``, ``file:///path``, or a path.

    Relative paths, and packages by their names, are searched in some folders; a folder may be the
    package itself, as the URDF reader accepts it.
    """
    scheme, mark, rest = resource.partition("://")
    relative = Path(rest if mark else resource)
    if relative.is_absolute():
        return relative if relative.exists() else None
    candidates = [folder / relative for folder in folders]
    if scheme == "package":
        package, *inner = relative.parts
        candidates += [folder.joinpath(*inner) for folder in folders if folder.name == package]
    return next((path for path in candidates if path.exists()), None)
