# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles in the scene of the page."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from ..arrays import FloatArray
from ..robot.world import Box, Capsule, Cylinder, Mesh, Obstacle, Shape, Sphere
from .stage import Stage

_PLAIN, _CHOSEN = (150, 128, 104), (230, 159, 0)


@dataclass(frozen=True, eq=False)
class _DrawnObstacle:
    """The node of an obstacle and its parts."""

    root: Any
    parts: list[Any]


class DrawnWorld:
    """The obstacles in the scene; those attached to a link move with it.

    Parameters
    ----------
    stage : Stage
        The scene.
    pick : callable
        Called with the name of an obstacle that a person clicks.
    robot : str
        Node of the robot whose links obstacles are attached to.
    """

    def __init__(self, stage: Stage, pick: Callable[[str], None], robot: str = "/robot") -> None:
        self._stage, self._pick, self._robot = stage, pick, robot
        self._drawn: dict[str, _DrawnObstacle] = {}
        self._n_drawn = 0

    def draw(self, obstacle: Obstacle, pose: FloatArray, parts: Sequence[Shape]) -> None:
        """Draw an obstacle in the place of the one with its name.

        Parameters
        ----------
        obstacle : Obstacle
            The obstacle.
        pose : array, shape (7,)
            Its place.
        parts : sequence of Shape
            Its shapes relative to that.
        """
        self.remove(obstacle.name)
        self._n_drawn += 1
        scene = self._stage.server.scene
        node = f"{self._parent(obstacle.frame)}/obstacle{self._n_drawn}"
        root = scene.add_frame(node, show_axes=False)
        nodes = [self._add_shape(f"{node}/{i}", shape) for i, shape in enumerate(parts)]
        for part in nodes:
            part.on_click(lambda _: self._pick(obstacle.name))
        self._drawn[obstacle.name] = _DrawnObstacle(root, nodes)
        self.place(obstacle.name, pose)

    def place(self, name: str, pose: FloatArray) -> None:
        """Move an obstacle to a pose, shape (7,)."""
        root = self._drawn[name].root
        root.position, root.wxyz = pose[:3], np.roll(pose[3:], 1)

    def remove(self, name: str) -> None:
        """Remove an obstacle, if it is drawn."""
        if name in self._drawn:
            self._drawn.pop(name).root.remove()

    def mark(self, chosen: str) -> None:
        """Draw one obstacle in another colour than the others."""
        for name, one in self._drawn.items():
            for part in one.parts:
                part.color = _CHOSEN if name == chosen else _PLAIN

    def _parent(self, frame: str) -> str:
        """The node of a link of the robot; that of the world for an empty name."""
        if not frame:
            return f"/world{self._robot}"
        joint, position, orientation = self._stage.shapes.link_place(frame)
        node = f"{self._robot}/{joint}/{frame}"
        self._stage.server.scene.add_frame(
            node, show_axes=False, position=position, wxyz=orientation
        )
        return node

    def _add_shape(self, node: str, shape: Shape) -> Any:
        scene = self._stage.server.scene
        place: Any = {"position": shape.position, "wxyz": np.roll(shape.orientation, 1)}
        if isinstance(shape, Box):
            return scene.add_box(node, _PLAIN, tuple(shape.size), **place)
        if isinstance(shape, Sphere):
            return scene.add_icosphere(node, shape.radius, _PLAIN, **place)
        if isinstance(shape, Capsule):
            mesh = trimesh.creation.capsule(shape.height, shape.radius)
            return scene.add_mesh_simple(node, mesh.vertices, mesh.faces, color=_PLAIN, **place)
        if isinstance(shape, Cylinder):
            return scene.add_cylinder(node, shape.radius, shape.height, _PLAIN, **place)
        if isinstance(shape, Mesh):
            return scene.add_mesh_simple(
                node, shape.vertices, shape.triangles, color=_PLAIN, side="double", **place
            )
        raise TypeError(f"no drawing of a {type(shape).__name__}")
