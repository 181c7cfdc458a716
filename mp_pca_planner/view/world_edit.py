# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A world that is changed obstacle by obstacle."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..robot.world import Box, Cylinder, Obstacle, Shape, Sphere, World

KINDS = ("Box", "Sphere", "Cylinder")
"""Shapes of new obstacles."""


class WorldEditor:
    """Adds, moves, resizes and removes obstacles.

    Parameters
    ----------
    world : World
        The world at the beginning.

    Attributes
    ----------
    world : World
        The present world.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self._places: dict[str, FloatArray] = {}

    def __getitem__(self, name: str) -> Obstacle:
        return next(one for one in self.world if one.name == name)

    def place(self, name: str) -> FloatArray:
        """Position and orientation (x, y, z, w) of an obstacle, shape (7,).

        An obstacle of one shape has the pose of that; another one is upright in the middle of its
        shapes at the beginning.
        """
        obstacle = self[name]
        if len(obstacle.shapes) == 1:
            return obstacle.shapes[0].pose
        if name not in self._places:
            middle = np.mean([shape.position for shape in obstacle.shapes], axis=0)
            self._places[name] = np.append(middle, [0.0, 0.0, 0.0, 1.0])
        return self._places[name]

    def parts(self, name: str) -> list[Shape]:
        """The shapes of an obstacle relative to its place."""
        back = np.array(pin.SE3ToXYZQUAT(pin.XYZQUATToSE3(self.place(name)).inverse()))
        return [shape.moved(back) for shape in self[name].shapes]

    def add(self, kind: str, position: ArrayLike, size: float) -> str:
        """Add an obstacle of a kind at a position [m] with a size [m]; returns its name."""
        name = next(
            name
            for number in range(1, len(self.world) + 2)
            if (name := f"{kind.lower()} {number}") not in self.world.names
        )
        shapes: Mapping[str, Shape] = {
            "Box": Box((size, size, size), position),
            "Sphere": Sphere(0.5 * size, position),
            "Cylinder": Cylinder(0.4 * size, 1.5 * size, position),
        }
        self._replace(Obstacle(name, shapes[kind]))
        return name

    def move(self, name: str, pose: FloatArray) -> None:
        """Move an obstacle to a pose, shape (7,); see :meth:`place`."""
        shapes = tuple(shape.moved(pose) for shape in self.parts(name))
        self._places[name] = np.array(pose)
        self._replace(replace(self[name], shapes=shapes))

    def resize(self, name: str, sizes: Iterable[float]) -> None:
        """Give the sizes of :meth:`sizes` of an obstacle other values [m]."""
        obstacle, values = self[name], tuple(sizes)
        shape: Any = obstacle.shapes[0]
        given = (values,) if isinstance(shape, Box) else values
        new = type(shape)(*given, shape.position, shape.orientation) if values else shape
        self._replace(replace(obstacle, shapes=(new,)))

    def sizes(self, name: str) -> dict[str, float]:
        """The sizes of an obstacle that can be changed [m]; none if it has several shapes."""
        shape, *others = self[name].shapes
        if isinstance(shape, Box) and not others:
            return dict(zip(("Length", "Width", "Height"), map(float, shape.size), strict=True))
        names = () if others else ("radius", "height")
        return {x.capitalize(): getattr(shape, x) for x in names if hasattr(shape, x)}

    def remove(self, name: str) -> None:
        """Remove an obstacle."""
        self.world = self.world.without([name])
        self._places.pop(name, None)

    def _replace(self, obstacle: Obstacle) -> None:
        """Put an obstacle into the place of the one with its name, or at the end."""
        if obstacle.name not in self.world.names:
            self.world = self.world.with_obstacles(obstacle)
            return
        obstacles = [obstacle if one.name == obstacle.name else one for one in self.world]
        self.world = World(obstacles, self.world.allowed)
