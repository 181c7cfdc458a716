# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Meshes of obstacles and links: files of STL, Wavefront OBJ and COLLADA, and convex hulls."""

from __future__ import annotations

import hashlib
import io
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from importlib.util import find_spec
from itertools import product
from pathlib import Path
from typing import Any
from weakref import WeakValueDictionary

import numpy as np
from numpy.typing import NDArray

from ..arrays import FloatArray
from ..exceptions import WorldError, printable
from ..files import read_bytes, read_text, reading
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule

coal = LazyModule("coal")

SUFFIXES = (".stl", ".obj", ".dae")
"""Ends of the names of accepted files."""

THICKNESS = 1e-4
"""Thickness of the hull of a mesh without volume [m]."""

_PLAIN = (194, 201, 212, 255)
# Extent below which a mesh has no volume, relative to its largest extent and in metres.
_THIN, SMALLEST = 1e-6, 1e-7
# Share of its convex hull's volume, or area, from which on a mesh is convex: files hold 6 digits.
# The hull in its place is on the safe side.
_CONVEX_SHARE = 1.0 - 1e-3
# Faces of a hull that may meet in a corner: Coal rejects more.
_MOST_FACES = 255

Triangles = NDArray[np.intp]


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
    triangles: Triangles
    colours: NDArray[np.uint8] | None = None


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
        if path.suffix.lower() not in SUFFIXES:
            raise ValueError(f"accepted are files of the formats {', '.join(SUFFIXES)}")
        status = path.stat()
        return _read(path, status.st_mtime_ns, status.st_size)


@lru_cache(maxsize=INPUT_LIMITS.kept_meshes)
def _read(path: Path, changed: int, size: int) -> MeshContent:
    """The mesh in a file, which is read again when it has changed."""
    import collada
    import trimesh

    content, suffix = read_bytes(path, INPUT_LIMITS.mesh_bytes), path.suffix.lower()
    if suffix == ".dae":
        try:
            surface = _collada(content)
        except collada.common.DaeError as error:
            raise ValueError(str(error)) from None
    else:
        options = {"skip_materials": True, "maintain_order": True} if suffix == ".obj" else {}
        mesh = trimesh.load_mesh(
            io.BytesIO(content), file_type=suffix[1:], process=False, **options
        )
        surface = MeshContent(np.asarray(mesh.vertices), np.asarray(mesh.faces))
    if not len(surface.triangles):
        raise ValueError("it has no triangles")
    _check_count(len(surface.triangles))
    if not np.isfinite(surface.vertices[surface.triangles]).all():
        raise ValueError("it has coordinates that are not finite")
    return surface


def _check_count(n_triangles: int) -> None:
    if n_triangles > (most := INPUT_LIMITS.mesh_triangles):
        raise ValueError(f"it has {n_triangles} triangles, at most {most} are accepted")


def _collada(content: bytes) -> MeshContent:
    """The triangles of the scene of a COLLADA file in metres, with plain colours."""
    # The upward axis of the file is not applied, as in RViz. Textures are not read.
    import collada

    if b"<!DOCTYPE" in content:
        raise ValueError("it has a document type, which is not accepted")
    document = collada.Collada(io.BytesIO(content), ignore=[collada.common.DaeBrokenRefError])
    corners, colours, n_triangles = [np.zeros((0, 3, 3))], [np.zeros((0, 4))], 0
    for geometry in document.scene.objects("geometry") if document.scene else ():
        for part in geometry.primitives():
            part = part.triangleset() if hasattr(part, "triangleset") else part
            if not isinstance(part, collada.triangleset.BoundTriangleSet) or not len(part):
                continue
            corners.append(part.vertex[part.vertex_index])
            n_triangles += len(part)
            _check_count(n_triangles)  # files may double what they hold again and again
            colour = getattr(getattr(part.material, "effect", None), "diffuse", None)
            plain = isinstance(colour, tuple)
            colours.append(np.tile(np.array(colour if plain else [np.nan] * 4), (len(part), 1)))
    points, paint = np.concatenate(corners), np.concatenate(colours)
    is_painted = np.isfinite(paint).all(axis=1, keepdims=True)
    paint = np.where(is_painted, np.rint(255.0 * np.clip(paint, 0.0, 1.0)), _PLAIN)
    unit = document.assetInfo.unitmeter
    return MeshContent(
        (1.0 if unit is None else float(unit)) * points.reshape(-1, 3).astype(np.float64),
        np.arange(3 * len(points)).reshape(-1, 3),
        paint.astype(np.uint8) if is_painted.any() else None,
    )


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
        path = _find_file(resource, folders)
    if path is None:
        advice = _advice(resource, folders)
        raise WorldError(f"mesh '{printable(resource):.200}' was not found: {advice}")
    return read_mesh(path, resource)


def package_folders(given: Sequence[Path], urdf: Path | None = None) -> list[Path]:
    """Folders in which packages may be.

    These are those given, those above a URDF file, those of ROS, and that of example-robot-data.
    """
    folders = [*given, *(urdf.resolve().parents if urdf else ())]
    folders += map(Path, filter(None, os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep)))
    prefixes = filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep))
    folders += (Path(prefix) / "share" for prefix in prefixes)
    if (examples := find_spec("example_robot_data")) and examples.origin:
        shares = (folder / "share" for folder in Path(examples.origin).parents)
        folders += (share for share in shares if (share / "example-robot-data").is_dir())
    return folders


def _advice(resource: str, folders: Sequence[Path]) -> str:
    """What to do about a mesh that was not found."""
    scheme, _, rest = resource.rpartition("://")
    rest = rest.lstrip("/") if scheme == "package" else rest
    if Path(rest).is_absolute():
        return "its path is of another machine; write one relative to the URDF, or package://"
    what = "it"
    if scheme == "package":
        package = rest.partition("/")[0]
        of_name = [f / package for f in folders if package and (f / package).is_dir()]
        if found := of_name or [f for f in folders if _is_package(f, package)]:
            return f"the package is in '{found[0]}', which lacks this file"
        what = f"the package '{printable(package):.100}'"
    return (
        f"name the folder that holds {what} by --package-dirs (package_dirs in Python and of the "
        "node)"
    )


def _find_file(resource: str, folders: Sequence[Path]) -> Path | None:
    """The file of a mesh: beside or in a package of that name, or at a path in a folder."""
    scheme, mark, rest = resource.partition("://")
    # Descriptions in circulation also write package:///package/path.
    relative = Path((rest.lstrip("/") if scheme == "package" else rest) if mark else resource)
    if relative.is_absolute():
        return relative if relative.exists() else None
    candidates = [folder / relative for folder in folders]
    if scheme == "package":
        package, *inner = relative.parts
        candidates += [f.joinpath(*inner) for f in folders if _is_package(f, package)]
    return next((path for path in candidates if path.exists()), None)


def _is_package(folder: Path, name: str) -> bool:
    """Whether a folder is a package: the clone of one often has another name."""
    manifest = folder / "package.xml"
    return folder.name == name or (
        manifest.is_file() and f"<name>{name}</name>" in read_text(manifest)
    )


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


@dataclass(frozen=True, eq=False)
class MeshSolid:
    """A mesh, and its convex hull.

    The hull is built by SciPy, which rejects vertices without volume; Coal ends the process on
    them.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates [m].
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    corners, faces : array, shapes (n_corners, 3) and (n_faces, 3)
        The same of the convex hull, whose faces are anticlockwise seen from outside. That of a
        surface without volume has a small thickness.
    is_convex : bool
        Whether the hull is the mesh itself.
    """

    vertices: FloatArray
    triangles: Triangles
    corners: FloatArray
    faces: Triangles
    is_convex: bool

    @cached_property
    def surface(self) -> Any:
        """The triangles for Coal, made once and never changed."""
        surface = coal.BVHModelOBBRSS()
        surface.beginModel(len(self.triangles), len(self.vertices))
        surface.addVertices(self.vertices)
        surface.addTriangles(self.triangles)
        surface.endModel()
        return surface

    @cached_property
    def hull(self) -> Any:
        """The convex hull for Coal, made once and never changed."""
        points, faces = coal.StdVec_Vec3s(), coal.StdVec_Triangle()
        for corner in self.corners:
            points.append(corner)
        for face in zip(*self.faces.T.tolist(), strict=True):
            faces.append(coal.Triangle(*face))
        return coal.Convex(points, faces)


# A robot is built anew for each change of a parameter or of the primitives, and building the tree
# of a mesh takes time: equal meshes share theirs.
_SOLIDS: WeakValueDictionary[bytes, MeshSolid] = WeakValueDictionary()


def solid_of(vertices: FloatArray, triangles: Triangles) -> MeshSolid:
    """The solid of a mesh, or that of an equal mesh as long as it is used.

    Parameters
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates [m].
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.
    """
    used = vertices[triangles.ravel()]
    # Sorted by z, then y, then x.
    points, indices = np.unique(used[:, ::-1], axis=0, return_inverse=True)
    points, faces = np.ascontiguousarray(points[:, ::-1]), indices.reshape(-1, 3)
    key = hashlib.sha256(points.tobytes() + faces.tobytes()).digest()
    known = _SOLIDS.get(key)
    return _SOLIDS.setdefault(key, _solid(points, faces)) if known is None else known


def _solid(vertices: FloatArray, triangles: Triangles) -> MeshSolid:
    """A mesh with its convex hull; a surface without volume gets a small thickness."""
    axes = _axes(vertices)
    local = vertices @ axes
    low, high = local.min(axis=0), local.max(axis=0)
    is_flat = high - low <= max(_THIN * (high[0] - low[0]), SMALLEST)
    middle = 0.5 * (low + high)
    low = np.where(is_flat, middle - 0.5 * THICKNESS, low)
    high = np.where(is_flat, middle + 0.5 * THICKNESS, high)
    box, points = np.array(list(product(*zip(low, high, strict=True)))), local
    if is_flat[1]:
        points = box
    elif is_flat[2]:
        points = np.concatenate([local, local])
        points[: len(local), 2], points[len(local) :, 2] = low[2], high[2]
    # Where there is no hull that Coal accepts, the box around it takes its place.
    hull = _hull(points) or _hull(box)
    assert hull is not None  # a box has a volume
    corners, faces, volume = hull
    size = _area(local, triangles) * THICKNESS if is_flat[2] else _volume(local, triangles)
    is_convex = bool(is_flat[1] or size >= _CONVEX_SHARE * volume)
    return MeshSolid(vertices, triangles, corners @ axes.T, faces, is_convex)


def _hull(points: FloatArray) -> tuple[FloatArray, Triangles, float] | None:
    """Corners, faces and volume of the convex hull of points; None if they are nearly flat."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull = ConvexHull(points)
    except QhullError:
        return None
    if np.bincount(hull.simplices.ravel()).max() > _MOST_FACES:
        return None
    used, indices = np.unique(hull.simplices, return_inverse=True)
    corners, faces = points[used], indices.reshape(-1, 3).astype(np.intp)
    a, b, c = np.moveaxis(corners[faces], 1, 0)
    inward = np.einsum("fi,fi->f", np.cross(b - a, c - a), hull.equations[:, :3]) < 0.0
    faces[inward] = faces[inward, ::-1]
    return corners, faces, float(hull.volume)


def _axes(vertices: FloatArray) -> FloatArray:
    """Principal axes of points as right-handed columns, that of the largest extent first."""
    off = vertices - vertices.mean(axis=0)
    off /= np.abs(off).max(initial=0.0) or 1.0
    axes = np.linalg.eigh(off.T @ off)[1]
    axes = axes[:, np.argsort(-np.ptp(off @ axes, axis=0), kind="stable")]
    return np.asarray(axes * [1.0, 1.0, np.sign(np.linalg.det(axes))])


def _volume(vertices: FloatArray, triangles: Triangles) -> float:
    a, b, c = np.moveaxis(vertices[triangles], 1, 0) - vertices.mean(axis=0)
    return abs(float(np.einsum("ti,ti->", a, np.cross(b, c)))) / 6.0


def _area(vertices: FloatArray, triangles: Triangles) -> float:
    """Area of different triangles."""
    a, b, c = np.moveaxis(vertices[np.unique(np.sort(triangles, axis=1), axis=0)], 1, 0)
    return 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
