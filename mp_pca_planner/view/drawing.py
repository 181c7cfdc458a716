# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots and paths in the scene of the page."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from .robot_shapes import Colour, RobotShape, RobotShapes

Rgb = tuple[int, int, int]

MAX_FACES = 40_000
"""Faces of a mesh above which its convex hull is drawn; browsers without a GPU need that."""


class DrawnRobot:
    """A robot in the scene, in its own colours or, as a ghost, in one translucent colour.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    name : str
        Name of its node.
    shapes : RobotShapes
        Its shapes.
    ghost : tuple of int, optional
        Colour of a ghost, which consists of convex hulls of what moves.
    opacity : float
        Opacity of a ghost.

    Attributes
    ----------
    configuration : array, shape (n_joints,)
        The configuration shown.
    """

    def __init__(
        self,
        scene: viser.SceneApi,
        name: str,
        shapes: RobotShapes,
        ghost: Rgb | None = None,
        opacity: float = 0.35,
    ) -> None:
        self._shapes = shapes
        self.configuration: FloatArray = np.zeros(0)
        self._root = scene.add_frame(name, show_axes=False)
        self._joints = [
            scene.add_frame(f"{name}/{joint}", show_axes=False) for joint in range(shapes.n_joints)
        ]
        self._meshes: list[Any] = []
        for i, shape in enumerate(shapes.shapes):
            node = f"{name}/{shape.joint}/{i}"
            if ghost is None:
                _add_mesh(scene, node, shape)
            elif shape.joint > 0:
                hull = shape.hull
                self._meshes.append(
                    scene.add_mesh_simple(
                        node,
                        hull.vertices,
                        hull.faces,
                        color=ghost,
                        opacity=opacity,
                        cast_shadow=False,
                        receive_shadow=False,
                    )
                )

    def show(self, q: FloatArray) -> None:
        """Put the robot into a configuration, shape (n_joints,)."""
        self.configuration = q
        positions, orientations = self._shapes.placements(q)
        for frame, position, orientation in zip(self._joints, positions, orientations, strict=True):
            frame.position, frame.wxyz = position, orientation

    def paint(self, colour: Rgb) -> None:
        """Give a ghost another colour."""
        for mesh in self._meshes:
            mesh.color = colour

    @property
    def visible(self) -> bool:
        """Whether it is shown."""
        return bool(self._root.visible)

    @visible.setter
    def visible(self, is_visible: bool) -> None:
        self._root.visible = is_visible


def _add_mesh(scene: viser.SceneApi, name: str, shape: RobotShape) -> None:
    mesh = shape.mesh if len(shape.mesh.faces) <= MAX_FACES else shape.hull
    if shape.colour is None and mesh is shape.mesh:
        scene.add_mesh_trimesh(name, mesh)
        return
    colour = shape.colour or (0.8, 0.8, 0.8, 1.0)
    scene.add_mesh_simple(
        name, mesh.vertices, mesh.faces, color=rgb(colour), opacity=_opacity(colour)
    )


def rgb(colour: Colour) -> Rgb:
    """A colour in whole numbers from 0 to 255, without its opacity."""
    red, green, blue, _ = (round(255 * value) for value in colour)
    return red, green, blue


def _opacity(colour: Colour) -> float | None:
    return None if colour[3] >= 1.0 else colour[3]


def from_hex(colour: str) -> Rgb:
    """A colour written as ``#RRGGBB``."""
    red, green, blue = (int(colour[k : k + 2], 16) for k in (1, 3, 5))
    return red, green, blue


class DrawnPaths:
    """Paths of one colour in the scene.

    Parameters
    ----------
    scene : viser.SceneApi
        The scene.
    name : str
        Name of its node.
    colour : tuple of int
        Its colour.
    width : float
        Its width on the screen [pixels].
    """

    def __init__(self, scene: viser.SceneApi, name: str, colour: Rgb, width: float = 3.0) -> None:
        self._lines = scene.add_line_segments(
            name,
            np.zeros((1, 2, 3), np.float32),
            colour,
            thickness=width,
            thickness_units="screen",
            visible=False,
        )

    def show(self, *paths: FloatArray, colour: Rgb | None = None) -> None:
        """Draw paths through points, each of shape (n_points, 3) [m]; without any, hide them."""
        segments = [np.stack([path[:-1], path[1:]], axis=1) for path in paths]
        drawn = np.concatenate([np.zeros((0, 2, 3)), *segments]).astype(np.float32)
        if len(drawn):
            self._lines.points = drawn
        if colour is not None:
            self._lines.colors = np.asarray(colour, np.uint8)
        self._lines.visible = bool(len(drawn))
