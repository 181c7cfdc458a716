# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes of obstacles and links: boxes, spheres, cylinders, capsules and meshes."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from ..arrays import FloatArray, frozen_array, set_frozen
from ..exceptions import WorldError
from ..files import as_path
from ..input_limits import INPUT_LIMITS
from .mesh_pieces import THICKNESS, Piece, is_point, pieces_of

NO_VOLUME = f"a mesh has no volume: it is used as a surface {1e3 * THICKNESS:g} mm thick"
"""Note on a flat or needle-thin mesh."""

_ORIGIN, _UPRIGHT = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 1.0)
# Deviation of a quaternion's length from 1: files often hold few digits.
_QUATERNION_TOLERANCE = 1e-3


@dataclass(frozen=True, eq=False, repr=False)
class Shape:
    """A body in space; the base class of all shapes.

    Attributes
    ----------
    position : array, shape (3,)
        Position of its origin in the frame of its obstacle [m].
    orientation : array, shape (4,)
        Its orientation there, a unit quaternion (x, y, z, w).

    Raises
    ------
    WorldError
        If a size is not positive, a number not finite or too large, or the quaternion not of
        length 1.
    """

    position: FloatArray
    orientation: FloatArray

    def _place(self, position: ArrayLike, orientation: ArrayLike) -> None:
        what = f"of a {type(self).__name__.lower()}"
        position = _coordinates(position, (3,), f"position {what}")
        set_frozen(self, position=position, orientation=_unit(orientation, f"orientation {what}"))

    @property
    def pose(self) -> FloatArray:
        """Position and orientation, shape (7,)."""
        return np.concatenate([self.position, self.orientation])

    def moved(self, pose: FloatArray) -> Self:
        """The same shape in a frame in which its present one has a pose, shape (7,)."""
        position = _coordinates(pose[:3], (3,), "position")
        frame = np.concatenate([position, _unit(pose[3:], "orientation")])
        placed = pin.XYZQUATToSE3(frame) * pin.XYZQUATToSE3(self.pose)
        found = np.array(pin.SE3ToXYZQUAT(placed))
        other = object.__new__(type(self))
        set_frozen(other, **vars(self))
        other._place(found[:3], found[3:])
        return other

    def __repr__(self) -> str:
        x, y, z = self.position
        return f"{type(self).__name__}({self._dimensions()}) at ({x:.4g}, {y:.4g}, {z:.4g})"

    def _dimensions(self) -> str:
        """The sizes as text."""
        raise NotImplementedError


@dataclass(frozen=True, eq=False, repr=False)
class Box(Shape):
    """A box centred at its origin.

    Attributes
    ----------
    size : array, shape (3,)
        Lengths of its edges along x, y and z [m].

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Box([0.6, 0.8, 0.02], position=[0.5, 0.0, 0.2])
    Box(0.6 × 0.8 × 0.02) at (0.5, 0, 0.2)
    """

    size: FloatArray

    def __init__(
        self, size: ArrayLike, position: ArrayLike = _ORIGIN, orientation: ArrayLike = _UPRIGHT
    ) -> None:
        sizes = _coordinates(size, (3,), "size of a box")
        for length in sizes:
            _positive(length, "size of a box")
        set_frozen(self, size=sizes)
        self._place(position, orientation)

    def _dimensions(self) -> str:
        return " × ".join(f"{length:.4g}" for length in self.size)


@dataclass(frozen=True, eq=False, repr=False)
class Sphere(Shape):
    """A sphere centred at its origin.

    Attributes
    ----------
    radius : float
        Its radius [m].

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Sphere(0.05, position=[0.4, 0.0, 0.5])
    Sphere(radius 0.05) at (0.4, 0, 0.5)
    """

    radius: float

    def __init__(
        self, radius: float, position: ArrayLike = _ORIGIN, orientation: ArrayLike = _UPRIGHT
    ) -> None:
        set_frozen(self, radius=_positive(radius, "radius of a sphere"))
        self._place(position, orientation)

    def _dimensions(self) -> str:
        return f"radius {self.radius:.4g}"


@dataclass(frozen=True, eq=False, repr=False)
class Cylinder(Shape):
    """A cylinder about its z axis, centred at its origin.

    Attributes
    ----------
    radius : float
        Its radius [m].
    height : float
        Its length along z [m].

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Cylinder(0.03, 0.2, position=[0.4, 0.0, 0.1])
    Cylinder(radius 0.03, height 0.2) at (0.4, 0, 0.1)
    """

    radius: float
    height: float

    def __init__(
        self,
        radius: float,
        height: float,
        position: ArrayLike = _ORIGIN,
        orientation: ArrayLike = _UPRIGHT,
    ) -> None:
        what = type(self).__name__.lower()
        set_frozen(self, radius=_positive(radius, f"radius of a {what}"))
        set_frozen(self, height=_positive(height, f"height of a {what}"))
        self._place(position, orientation)

    def _dimensions(self) -> str:
        return f"radius {self.radius:.4g}, height {self.height:.4g}"


@dataclass(frozen=True, eq=False, repr=False, init=False)
class Capsule(Cylinder):
    """A cylinder with a half sphere at each end; `height` is that of the cylinder alone [m].

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Capsule(0.03, 0.2, position=[0.4, 0.0, 0.1])
    Capsule(radius 0.03, height 0.2) at (0.4, 0, 0.1)
    """


@dataclass(frozen=True, eq=False, repr=False)
class Mesh(Shape):
    """A surface of triangles.

    A convex closed surface is a solid body. Any other one is a surface: what lies inside it
    without touching it is not in collision. A flat or needle-thin mesh gets a thickness of 0.1 mm.

    Attributes
    ----------
    vertices : array, shape (n_vertices, 3)
        Coordinates [m].
    triangles : array of int, shape (n_triangles, 3)
        Indices of the vertices of each triangle.

    Raises
    ------
    WorldError
        If there are no triangles or too many, an index is wrong, or all vertices are at one point.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> corners = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.1, 0.0], [0.0, 0.0, 0.1]]
    >>> mp.Mesh(corners, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    Mesh(4 triangles) at (0, 0, 0)
    """

    vertices: FloatArray
    triangles: NDArray[np.intp]

    def __init__(
        self,
        vertices: ArrayLike,
        triangles: ArrayLike,
        position: ArrayLike = _ORIGIN,
        orientation: ArrayLike = _UPRIGHT,
    ) -> None:
        points = _coordinates(vertices, (None, 3), "vertices of a mesh")
        indices = frozen_array(triangles, (None, 3), "triangles of a mesh", WorldError)
        most = INPUT_LIMITS.mesh_triangles
        if not 1 <= len(indices) <= most:
            raise WorldError(f"a mesh must have 1 to {most} triangles, got {len(indices)}")
        if np.any(indices != np.round(indices)) or not (
            indices.min() >= 0 and indices.max() < len(points)
        ):
            raise WorldError(
                f"triangles of a mesh must be indices of its {len(points)} vertices, from 0 to "
                f"{len(points) - 1}"
            )
        whole = indices.astype(np.intp)
        if is_point(points[whole.ravel()]):
            raise WorldError("a mesh must have an extent, but all its vertices are at one point")
        whole.setflags(write=False)
        set_frozen(self, vertices=points, triangles=whole)
        self._place(position, orientation)

    @classmethod
    def from_file(
        cls,
        path: str | Path,
        scale: float = 1.0,
        position: ArrayLike = _ORIGIN,
        orientation: ArrayLike = _UPRIGHT,
    ) -> Mesh:
        """Read a mesh file, STL, OBJ or COLLADA (.dae), with coordinates times a scale.

        Raises
        ------
        WorldError
            If the file can't be read.
        """
        from .mesh_files import read_mesh

        size, found = _positive(scale, "scale of a mesh"), read_mesh(as_path(path, WorldError))
        return cls(size * found.vertices, found.triangles, position, orientation)

    @cached_property
    def pieces(self) -> tuple[Piece, ...]:
        """The mesh, cut into pieces if it is large, with convex hulls; copies share them."""
        return pieces_of(self.vertices, self.triangles)

    @property
    def note(self) -> str:
        """What is unusual about it; empty for a mesh with a volume."""
        if not all(piece.is_thin for piece in self.pieces):
            return ""
        return NO_VOLUME

    def _dimensions(self) -> str:
        return f"{len(self.triangles)} triangles"


def _unit(quaternion: ArrayLike, what: str) -> FloatArray:
    values = frozen_array(quaternion, (4,), what, WorldError)
    length = float(np.linalg.norm(values))
    if not abs(length - 1.0) <= _QUATERNION_TOLERANCE:
        raise WorldError(
            f"{what} must be a quaternion (x, y, z, w) of length 1, got one of length {length:.6g}"
        )
    return frozen_array(values / length, (4,), what, WorldError)


def _positive(value: float, what: str) -> float:
    number = float(frozen_array(value, (), what, WorldError))
    most = INPUT_LIMITS.world_length
    if not 0.0 < number <= most:
        raise WorldError(f"{what} must be above 0 and at most {most:g} m, got {number:g}")
    return number


def _coordinates(values: ArrayLike, shape: tuple[int | None, ...], what: str) -> FloatArray:
    array = frozen_array(values, shape, what, WorldError)
    largest, most = np.abs(array).max(initial=0.0), INPUT_LIMITS.world_length
    if largest > most:
        raise WorldError(f"{what} must be at most {most:g} m, got {largest:g}")
    return array
