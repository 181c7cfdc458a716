# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The world around a robot: obstacles made of shapes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..arrays import as_list, check_type, set_frozen, unique_names
from ..exceptions import WorldError, quote_names, shown, unknown_name
from ..files import as_path
from ..input_limits import INPUT_LIMITS
from .shapes import Box as Box
from .shapes import Capsule as Capsule
from .shapes import Cylinder as Cylinder
from .shapes import Mesh as Mesh
from .shapes import Shape as Shape
from .shapes import Sphere as Sphere

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
        parts: tuple[Shape, ...]
        if isinstance(shapes, Shape):
            parts = (shapes,)
        else:
            needed = f"obstacle '{name}': one or several shapes are needed"
            parts = tuple(as_list(shapes, needed, WorldError))
        if not parts or not all(isinstance(part, Shape) for part in parts):
            raise WorldError(
                f"obstacle '{name}' must have one or several shapes (Box, Sphere, Cylinder, "
                f"Capsule, Mesh), got {shown(parts)}"
            )
        check_type(frame, f"frame of obstacle '{name}'", WorldError, str)
        touched = as_list(touch_links, f"links of obstacle '{name}': a list is needed", WorldError)
        for link in touched:
            check_type(link, f"a link of obstacle '{name}'", WorldError, str)
        set_frozen(self, name=name, shapes=parts, frame=frame, touch_links=tuple(touched))

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
        needed = "the obstacles of a world must be a list"
        bodies = tuple(as_list(obstacles, needed, WorldError))
        for one in bodies:
            check_type(one, "each obstacle of a world", WorldError, Obstacle)
        if bodies:
            unique_names([one.name for one in bodies], "obstacles", WorldError)
        shapes = [shape for one in bodies for shape in one.shapes]
        n_triangles = sum(len(one.triangles) for one in shapes if isinstance(one, Mesh))
        for count, most, kind in (
            (len(shapes), INPUT_LIMITS.shapes, "shapes"),
            (n_triangles, INPUT_LIMITS.triangles, "triangles"),
        ):
            if count > most:
                raise WorldError(f"a world of {count} {kind} is too large: at most {most} are used")
        needed = "allowed contacts must be pairs of names"
        couples = [as_list(x, needed, WorldError) for x in as_list(allowed, needed, WorldError)]
        for pair in couples:
            if len(pair) != 2 or not all(isinstance(one, str) for one in pair):
                raise WorldError(f"{needed}, got {shown(pair)}")
        pairs = frozenset((min(pair), max(pair)) for pair in couples)
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
        return tuple(one.name for one in self.obstacles)

    @property
    def notes(self) -> tuple[str, ...]:
        """What is unusual about obstacles, a sentence for each of these."""
        found = [
            f"obstacle '{one.name}': {shape.note}"
            for one in self.obstacles
            for shape in one.shapes
            if isinstance(shape, Mesh) and shape.note
        ]
        return tuple(dict.fromkeys(found))

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

        return read_scene(as_path(path, WorldError))

    def with_obstacles(self, *obstacles: Obstacle) -> World:
        """The world with further obstacles; those of the same name are replaced.

        Raises
        ------
        WorldError
            If one is no obstacle.
        """
        for one in obstacles:
            check_type(one, "an obstacle", WorldError, Obstacle)
        new = {one.name for one in obstacles}
        kept = [one for one in self.obstacles if one.name not in new]
        return World([*kept, *obstacles], self.allowed)

    def without(self, names: Iterable[str]) -> World:
        """The world without some obstacles.

        Raises
        ------
        WorldError
            If there is no such obstacle, or the names are no list of strings.
        """
        removed = as_list(names, "a list of names of obstacles is needed", WorldError)
        for name in removed:
            if not isinstance(name, str) or name not in self.names:
                raise WorldError(unknown_name("obstacle", name, self.names))
        return World([one for one in self.obstacles if one.name not in removed], self.allowed)

    def allows(self, first: str, second: str) -> bool:
        """Whether two bodies, by their names, are not checked for contact.

        Raises
        ------
        WorldError
            If a name is no string.
        """
        for name in (first, second):
            check_type(name, "the name of a body", WorldError, str)
        pairs = ((first, second), (first, ANY), (second, ANY))
        return any((min(pair), max(pair)) in self.allowed for pair in pairs)
