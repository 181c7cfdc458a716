# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The world around a robot: obstacles made of boxes, spheres, cylinders, capsules and meshes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..arrays import (
    FloatArray,
    check_number,
    check_type,
    frozen_array,
    set_frozen,
    unique_names,
)
from ..exceptions import PlannerError, WorldError, quote_names, shown, unknown_name
from ..input_limits import INPUT_LIMITS
from ..lazy import LazyModule
from .meshes import SMALLEST, MeshSolid, read_mesh, solid_of

pin = LazyModule("pinocchio")

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
        set_frozen(
            self,
            position=position,
            orientation=unit_quaternion(orientation, f"orientation {what}", WorldError),
        )

    @property
    def pose(self) -> FloatArray:
        """Position and orientation, shape (7,)."""
        return np.concatenate([self.position, self.orientation])

    def moved(self, pose: FloatArray) -> Self:
        """The same shape in a frame in which its present one has a pose, shape (7,)."""
        frame = [*pose[:3], *unit_quaternion(pose[3:], "orientation", WorldError)]
        placed = pin.XYZQUATToSE3(np.array(frame)) * pin.XYZQUATToSE3(self.pose)
        place = np.array(pin.SE3ToXYZQUAT(placed))
        other = object.__new__(type(self))
        set_frozen(other, **vars(self))
        other._place(place[:3], place[3:])
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
        whole, what = indices.astype(np.intp), "the number of triangles of a mesh"
        check_number(len(indices), what, WorldError, 1, INPUT_LIMITS.mesh_triangles, is_whole=True)
        if np.any(indices != whole) or whole.min() < 0 or whole.max() >= len(points):
            raise WorldError(
                f"triangles of a mesh must be indices of its {len(points)} vertices, from 0 to "
                f"{len(points) - 1}"
            )
        if np.ptp(points[whole.ravel()], axis=0).max() <= SMALLEST:
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
        size, content = _positive(scale, "scale of a mesh"), read_mesh(Path(path))
        return cls(size * content.vertices, content.triangles, position, orientation)

    @cached_property
    def solid(self) -> MeshSolid:
        """The mesh with its convex hull; copies share it."""
        return solid_of(self.vertices, self.triangles)

    def _dimensions(self) -> str:
        return f"{len(self.triangles)} triangles"


def unit_quaternion(values: ArrayLike, what: str, error: type[PlannerError]) -> FloatArray:
    """A quaternion (x, y, z, w) of length 1 from one of nearly that length, shape (4,).

    Raises
    ------
    PlannerError
        (as `error`) If there are not four finite numbers, or the length is another one.
    """
    given = frozen_array(values, (4,), what, error)
    length = float(np.linalg.norm(given))
    if not abs(length - 1.0) <= _QUATERNION_TOLERANCE:
        raise error(
            f"{what} must be a quaternion (x, y, z, w) of length 1, got one of length {length:.6g}"
        )
    return frozen_array(given / length, (4,), what, error)


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


ANY = "*"
"""Stands for all other bodies in an allowed contact."""


@dataclass(frozen=True, eq=False, repr=False)
class Obstacle:
    """A rigid body of one or several shapes.

    Attributes
    ----------
    name : str
        Its name in messages.
    shapes : tuple of Shape
        Its shapes; poses are relative to `frame`.
    frame : str
        Link of the robot that it moves with; empty for the base of the robot's model. It is not
        checked against that link.
    touch_links : tuple of str
        Further links that it may touch.

    Raises
    ------
    WorldError
        If the name is empty or there is no shape.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.Obstacle("ball", mp.Sphere(0.05, position=[0.4, 0.0, 0.5]))
    Obstacle 'ball': Sphere(radius 0.05) at (0.4, 0, 0.5)
    """

    name: str
    shapes: tuple[Shape, ...]
    frame: str
    touch_links: tuple[str, ...]

    def __init__(
        self,
        name: str,
        shapes: Shape | Iterable[Shape],
        frame: str = "",
        touch_links: Sequence[str] = (),
    ) -> None:
        if not isinstance(name, str) or not name.strip() or name == ANY:
            raise WorldError(f"an obstacle must have a name, got {shown(name)}")
        parts = (shapes,) if isinstance(shapes, Shape) else tuple(shapes)
        if not parts or not all(isinstance(part, Shape) for part in parts):
            raise WorldError(
                f"obstacle '{name}' must have one or several shapes (Box, Sphere, Cylinder, "
                f"Capsule, Mesh), got {shown(parts)}"
            )
        set_frozen(self, name=name, shapes=parts, frame=frame, touch_links=tuple(touch_links))

    def __repr__(self) -> str:
        frame = f" on '{self.frame}'" if self.frame else ""
        return f"Obstacle '{self.name}'{frame}: {', '.join(map(repr, self.shapes))}"


@dataclass(frozen=True, eq=False, repr=False)
class World:
    """The obstacles around a robot, and the contacts that are allowed.

    Attributes
    ----------
    obstacles : tuple of Obstacle
        Obstacles with different names.
    allowed : frozenset of (str, str)
        Pairs of bodies, links or obstacles, that are not checked, each in alphabetical order; `ANY`
        stands for all other bodies.

    Raises
    ------
    WorldError
        If two obstacles have the same name, or there are too many shapes or triangles.

    Examples
    --------
    >>> import mp_pca_planner as mp
    >>> mp.World([mp.Obstacle("table", mp.Box([0.6, 0.8, 0.02], position=[0.5, 0.0, 0.2]))])
    World of 'table'
    """

    obstacles: tuple[Obstacle, ...]
    allowed: frozenset[tuple[str, str]]

    def __init__(
        self, obstacles: Iterable[Obstacle] = (), allowed: Iterable[tuple[str, str]] = ()
    ) -> None:
        bodies = tuple(obstacles)
        for obstacle in bodies:
            check_type(obstacle, "each obstacle of a world", WorldError, Obstacle)
        if bodies:
            unique_names([obstacle.name for obstacle in bodies], "obstacles", WorldError)
        shapes = [shape for obstacle in bodies for shape in obstacle.shapes]
        n_triangles = sum(len(shape.triangles) for shape in shapes if isinstance(shape, Mesh))
        for count, kind, most in (
            (len(shapes), "shapes", INPUT_LIMITS.shapes),
            (n_triangles, "triangles", INPUT_LIMITS.triangles),
        ):
            what = f"the number of {kind} of a world"
            check_number(count, what, WorldError, 0, most, is_whole=True)
        pairs = frozenset((min(pair), max(pair)) for pair in allowed)
        set_frozen(self, obstacles=bodies, allowed=pairs)

    def __repr__(self) -> str:
        return f"World of {quote_names(self.names)}"

    def __iter__(self) -> Iterator[Obstacle]:
        return iter(self.obstacles)

    def __len__(self) -> int:
        return len(self.obstacles)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the obstacles."""
        return tuple(obstacle.name for obstacle in self.obstacles)

    @classmethod
    def from_file(cls, path: str | Path) -> World:
        """Read a planning scene of MoveIt.

        Parameters
        ----------
        path : str or Path
            A ``.scene`` file of text, or a moveit_msgs/PlanningScene as YAML.

        Raises
        ------
        WorldError
            If the file can't be read, or has a shape that is not supported.
        """
        from .scene_files import read_scene

        return read_scene(Path(path))

    def with_obstacles(self, *obstacles: Obstacle) -> World:
        """The world with further obstacles; those of the same name are replaced."""
        new = {obstacle.name for obstacle in obstacles}
        kept = [obstacle for obstacle in self.obstacles if obstacle.name not in new]
        return World([*kept, *obstacles], self.allowed)

    def without(self, names: Iterable[str]) -> World:
        """The world without some obstacles.

        Raises
        ------
        WorldError
            If there is no such obstacle.
        """
        removed = set(names)
        for name in removed:
            if name not in self.names:
                raise WorldError(unknown_name("obstacle", name, self.names))
        return World(
            [obstacle for obstacle in self.obstacles if obstacle.name not in removed], self.allowed
        )

    def allows(self, first: str, second: str) -> bool:
        """Whether two bodies, by their names, are not checked for contact."""
        pairs = ((first, second), (first, ANY), (second, ANY))
        return any((min(pair), max(pair)) in self.allowed for pair in pairs)
