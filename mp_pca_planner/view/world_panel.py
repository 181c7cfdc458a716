# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Obstacles on the page: drawn, added, moved and removed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import viser

from ..arrays import FloatArray
from ..robot.world import Box, Obstacle, Shape, World
from .options import PAGE
from .robot_shapes import surface
from .stage import Stage, add_mesh
from .world_edit import KINDS, WorldEditor

NAME = "World"
_NOTHING = "none"
_TEXT = "Plans avoid obstacles while these are moved. Click an obstacle, or choose it, to move it."


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
        # The node of each obstacle, and its parts.
        self._drawn: dict[str, tuple[Any, list[Any]]] = {}
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
        self._drawn[obstacle.name] = root, nodes
        self.place(obstacle.name, pose)

    def place(self, name: str, pose: FloatArray) -> None:
        """Move an obstacle to a pose, shape (7,)."""
        root, _ = self._drawn[name]
        root.position, root.wxyz = pose[:3], np.roll(pose[3:], 1)

    def remove(self, name: str) -> None:
        """Remove an obstacle, if it is drawn."""
        if name in self._drawn:
            self._drawn.pop(name)[0].remove()

    def mark(self, chosen: str) -> None:
        """Draw one obstacle in another colour than the others."""
        for name, (_, parts) in self._drawn.items():
            for part in parts:
                part.color = PAGE.chosen if name == chosen else PAGE.obstacle

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
        place: Any = {"position": shape.position, "wxyz": np.roll(shape.orientation, 1)}
        scene, is_flat = self._stage.server.scene, isinstance(shape, Box)
        look: Any = {"side": "double", "flat_shading": is_flat, **place}
        return add_mesh(scene, node, surface(shape), PAGE.obstacle, **look)


class WorldPanel:
    """The obstacles and the handle of the chosen one.

    Parameters
    ----------
    stage : Stage
        The scene.
    world : World
        The obstacles at the beginning.
    react : callable
        Called with the world when a person changes it.
    """

    def __init__(self, stage: Stage, world: World, react: Callable[[World], None]) -> None:
        self._stage, self._react = stage, react
        self._editor = WorldEditor(world)
        self._drawn = DrawnWorld(stage, self._on_picked)
        gui = stage.server.gui
        gui.add_markdown(_TEXT)
        kinds = gui.add_button_group("Add", KINDS)
        self._choice: Any = gui.add_dropdown("Obstacle", (_NOTHING,))
        self._sizes: list[Any] = []
        self._folder = gui.add_folder(None)
        remove = gui.add_button("Remove", icon=viser.Icon.TRASH, color="gray")
        self._handle = stage.server.scene.add_transform_controls(
            "/obstacle_handle", scale=0.14 * stage.size, depth_test=False, visible=False
        )
        self._handle.on_update(self._on_moved)
        stage.on_click(kinds, lambda: self._on_add(kinds.value))
        stage.on_click(remove, self._on_remove)
        stage.on_change(self._choice, lambda: self._choose(self._choice.value))
        for name in world.names:
            self._draw(name)
        self._choose(_NOTHING)

    def _on_add(self, kind: str) -> None:
        stage = self._stage
        position = stage.shapes.frame_pose(stage.drawn.configuration, stage.frame)[0]
        # Beside the end effector, away from the base.
        out = position[:2] / max(float(np.linalg.norm(position[:2])), 1e-6)
        position[:2] += 0.15 * stage.size * out
        name = self._editor.add(kind, position.round(2), max(round(0.06 * stage.size, 2), 0.02))
        self._draw(name)
        self._choose(name)
        self._react(self._editor.world)

    def _on_remove(self) -> None:
        name = self._choice.value
        if name != _NOTHING:
            self._editor.remove(name)
            self._drawn.remove(name)
            self._choose(_NOTHING)
            self._react(self._editor.world)

    def _on_picked(self, name: str) -> None:
        with self._stage.lock:
            self._choose(name)

    def _on_moved(self, _: viser.TransformControlsEvent) -> None:
        with self._stage.lock:
            name, handle = self._choice.value, self._handle
            if name != _NOTHING:
                pose = np.concatenate([handle.position, np.roll(handle.wxyz, -1)])
                self._editor.move(name, pose)
                self._drawn.place(name, pose)
                self._react(self._editor.world)

    def _on_size(self) -> None:
        name = self._choice.value
        self._editor.resize(name, [number.value for number in self._sizes])
        self._draw(name)
        self._choose(name)
        self._react(self._editor.world)

    def _choose(self, name: str) -> None:
        """Make an obstacle the chosen one."""
        self._choice.options = (_NOTHING, *self._editor.world.names)
        self._choice.value = name
        self._drawn.mark(name)
        is_movable = name != _NOTHING and not self._editor[name].frame
        self._handle.visible = is_movable
        if is_movable:
            place = self._editor.place(name)
            self._handle.position, self._handle.wxyz = place[:3], np.roll(place[3:], 1)
        self._show_sizes(name)

    def _show_sizes(self, name: str) -> None:
        sizes = {} if name == _NOTHING else self._editor.sizes(name)
        labels = [number.label for number in self._sizes]
        if labels == list(sizes):
            for number, value in zip(self._sizes, sizes.values(), strict=True):
                number.value = value
            return
        for number in self._sizes:
            number.remove()
        self._sizes = []
        with self._folder:
            for label, value in sizes.items():
                number = self._stage.server.gui.add_number(
                    label, value, min=0.005, max=100.0, step=0.005
                )
                self._stage.on_change(number, self._on_size)
                self._sizes.append(number)

    def _draw(self, name: str) -> None:
        editor = self._editor
        self._drawn.draw(editor[name], editor.place(name), editor.parts(name))
