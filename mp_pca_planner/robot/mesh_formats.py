# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Mesh files as arrays: STL, Wavefront OBJ without materials, and COLLADA.

Other parsers accept dozens of formats, follow references to other files, and take minutes or
gigabytes for small files. These ones read bytes that are in memory, and nothing else.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..input_limits import INPUT_LIMITS

_STL_HEADER = 84  # bytes: a comment, then the number of triangles
_STL_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("colour", "<u2")])


@dataclass(frozen=True, eq=False)
class MeshContent:
    """The surface in a mesh file.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates: those of the file, in metres if it states a unit.
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    colours : array of uint8, shape (n_triangles, 4), or None
        Red, green, blue and opacity of each triangle, if the file states any.
    """

    vertices: FloatArray
    triangles: NDArray[np.int32]
    colours: NDArray[np.uint8] | None = None


def parse_mesh(content: bytes, suffix: str) -> MeshContent:
    """Parse a mesh file.

    Parameters
    ----------
    content : bytes
        The file.
    suffix : str
        End of its name: ``.stl``, ``.obj`` or ``.dae``, as in `PARSERS`.

    Raises
    ------
    ValueError, LookupError, SyntaxError, …
        If the content is malformed, is of another format, or has no or too many triangles: call it
        within :func:`.files.reading`.
    """
    found = PARSERS[suffix](content)
    check_count(len(found.triangles))
    if not len(found.triangles):
        raise ValueError("it has no triangles")
    used = found.vertices[found.triangles.ravel()]
    if not np.isfinite(used).all():
        raise ValueError("it has coordinates that are not finite")
    if np.abs(used).max() > (most := INPUT_LIMITS.description_value):
        raise ValueError(f"it has coordinates above {most:g}")
    return found


def check_count(n_triangles: int) -> None:
    """Reject too many triangles, as soon as their number is known."""
    if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
        raise ValueError(f"it has {n_triangles} triangles, at most {most} are accepted")


def fans(corners: NDArray[np.int64], counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """The triangles of polygons, from their first corners to each of their edges.

    They cover a polygon that is not convex, and a little more.

    Parameters
    ----------
    corners : array of int, shape (n_corners,)
        The corners of all polygons, one after the other.
    counts : array of int, shape (n_polygons,)
        Number of corners of each; polygons of fewer than 3 have no triangles.

    Returns
    -------
    triangles : array of int, shape (n_triangles, 3)
        The corners of the triangles.
    """
    if np.any(counts < 0) or counts.sum() > len(corners):
        raise ValueError("its polygons have more corners than there are")
    n_triangles = np.maximum(counts - 2, 0)
    check_count(int(n_triangles.sum()))
    starts = np.repeat(np.cumsum(counts) - counts, n_triangles)
    # 0, 1, … within each polygon.
    steps = np.arange(len(starts)) - np.repeat(np.cumsum(n_triangles) - n_triangles, n_triangles)
    places = np.stack([starts, starts + steps + 1, starts + steps + 2], axis=1)
    return np.asarray(corners[places])


def _stl(content: bytes) -> MeshContent:
    """An STL file; binary ones may begin like one of text."""
    count = int.from_bytes(content[80:_STL_HEADER], "little")
    if len(content) == _STL_HEADER + count * _STL_TRIANGLE.itemsize and content[80:]:
        check_count(count)
        found = np.frombuffer(content, _STL_TRIANGLE, offset=_STL_HEADER)["corners"]
        return _soup(found.reshape(-1, 3).astype(np.float64))
    if not content[:80].lstrip().lower().startswith(b"solid") or b"\0" in content:
        raise ValueError(
            f"it is not an STL file: one of {count} triangles has "
            f"{_STL_HEADER + count * _STL_TRIANGLE.itemsize} bytes, this one has {len(content)}"
        )
    words = content.lower().split()
    at = [i for i, word in enumerate(words) if word == b"vertex"]
    if len(at) % 3 or words.count(b"facet") * 3 != len(at):
        raise ValueError(f"it has {len(at)} vertices of {words.count(b'facet')} triangles")
    check_count(len(at) // 3)
    numbers = [word for i in at for word in words[i + 1 : i + 4]]
    return _soup(np.array(numbers, dtype=np.float64).reshape(-1, 3))


def _soup(corners: FloatArray) -> MeshContent:
    """Triangles that don't share vertices."""
    return MeshContent(corners, np.arange(len(corners), dtype=np.int32).reshape(-1, 3))


def _obj(content: bytes) -> MeshContent:
    """The vertices and faces of an OBJ file; normals, textures and materials are skipped."""
    if b"\0" in content:
        raise ValueError("it is not an OBJ file, which is text")
    vertices: list[list[bytes]] = []
    corners: list[int] = []
    counts: list[int] = []
    n_triangles = 0
    for line in content.replace(b"\\\r\n", b" ").replace(b"\\\n", b" ").splitlines():
        word, *values = line.split() or [b""]
        if word == b"v":
            if len(values) < 3:
                raise ValueError(f"a vertex has {len(values)} coordinates, expected 3")
            vertices.append(values[:3])
        elif word == b"f":
            for value in values:
                # Negative numbers count from the last vertex before the face.
                index = int(value.split(b"/", 1)[0])
                corners.append(index - 1 if index > 0 else len(vertices) + index)
            counts.append(len(values))
            n_triangles += max(len(values) - 2, 0)
            check_count(n_triangles)
    if not counts:
        raise ValueError("it has no faces")
    points = np.array(vertices or np.zeros((0, 3)), dtype=np.float64)
    return indexed(points, fans(np.array(corners, dtype=np.int64), np.array(counts)))


def indexed(
    points: FloatArray, triangles: NDArray[np.int64], colours: NDArray[np.uint8] | None = None
) -> MeshContent:
    """A mesh of checked indices.

    Raises
    ------
    ValueError
        If a triangle has a vertex that does not exist.
    """
    wrong = triangles[(triangles < 0) | (triangles >= len(points))]
    if wrong.size:
        raise ValueError(f"a triangle has the vertex {wrong[0] + 1}, but there are {len(points)}")
    used, indices = np.unique(triangles, return_inverse=True)
    return MeshContent(points[used], indices.reshape(-1, 3).astype(np.int32), colours)


def _collada(content: bytes) -> MeshContent:
    from .collada import parse_collada

    return parse_collada(content)


PARSERS: dict[str, Callable[[bytes], MeshContent]] = {
    ".stl": _stl,
    ".obj": _obj,
    ".dae": _collada,
}
"""The parser of each accepted suffix."""
