# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of the obstacles: drawn, added, moved, resized and removed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import viser
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..robot.world import Box, Cylinder, Obstacle, Shape, Sphere, World
from .robot_shapes import Rgb, add_mesh, surface
from .stage import ShownMotion, Stage, part

NAME = "World"
_NOTHING = "none"
_TEXT = (
    "Add an obstacle: the plan avoids it. Drag its arrows. Click another one to choose it."
)
_OBSTACLE: Rgb = (150, 128, 104)
_CHOSEN: Rgb = (230, 159, 0)

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


class DrawnWorld:
    """The obstacles in the scene; those attached to a link move with it.

    Parameters
    ----------
    stage : Stage
        The scene.
    pick : callable
        Called with the name of an obstacle that a person clicks.
    """

    def __init__(self, stage: Stage, pick: Callable[[str], None]) -> None:
        self._stage, self._pick = stage, pick
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
        for mesh in nodes:
            mesh.on_click(lambda _: self._pick(obstacle.name))
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
            for mesh in parts:
                mesh.color = _CHOSEN if name == chosen else _OBSTACLE

    def _parent(self, frame: str) -> str:
        """The node of a link of the robot; that of the world for an empty name."""
        if not frame:
            return "/world"
        joint, position, orientation = self._stage.shapes.link_place(frame)
        node = f"/robot/{joint}/{frame}"
        self._stage.server.scene.add_frame(
            node, show_axes=False, position=position, wxyz=orientation
        )
        return node

    def _add_shape(self, node: str, shape: Shape) -> Any:
        place: Any = {"position": shape.position, "wxyz": np.roll(shape.orientation, 1)}
        scene, is_flat = self._stage.server.scene, isinstance(shape, Box)
        look: Any = {"side": "double", "flat_shading": is_flat, **place}
        return add_mesh(scene, node, surface(shape), _OBSTACLE, **look)


class WorldPanel:
    """The obstacles and the handle of the chosen one.

    Parameters
    ----------
    stage : Stage
        The scene.
    world : World
        The obstacles at the beginning.
    get_motion : callable
        Returns the present plan, on whose path new obstacles are put.
    react : callable
        Called with the world when a person changes it.

    Attributes
    ----------
    handle : viser.TransformControlsHandle
        The handle of the chosen obstacle.
    """

    def __init__(
        self,
        stage: Stage,
        world: World,
        get_motion: Callable[[], ShownMotion],
        react: Callable[[World], None],
    ) -> None:
        self._stage, self._get_motion, self._react = stage, get_motion, react
        self._editor, self._is_open = WorldEditor(world), False
        self._drawn = DrawnWorld(stage, self._on_picked)
        gui = stage.server.gui
        gui.add_html(part("lines", [_TEXT]))
        kinds = gui.add_button_group("Add", KINDS)
        self._choice: Any = gui.add_dropdown("Obstacle", (_NOTHING,))
        self._sizes: list[Any] = []
        self._folder = gui.add_folder(None)
        remove = gui.add_button("Remove", icon=viser.Icon.TRASH, color="gray")
        self.handle = stage.add_handle("/obstacle_handle", visible=False)
        stage.on_drag(self.handle, lambda _: self._on_moved())
        stage.on_click(kinds, lambda: self._on_add(kinds.value))
        stage.on_click(remove, self._on_remove)
        stage.on_change(self._choice, lambda: self._choose(self._choice.value))
        for name in world.names:
            self._draw(name)
        self._choose(_NOTHING)

    def set_open(self, is_open: bool) -> None:
        """Show or hide the handle; obstacles are always shown."""
        self._is_open = is_open
        self._place_handle()

    def _on_add(self, kind: str) -> None:
        size = max(round(0.06 * self._stage.size, 2), 0.02)
        name = self._editor.add(kind, self._free_place(size).round(3), size)
        self._draw(name)
        self._choose(name)
        self._react(self._editor.world)

    def _free_place(self, size: float) -> FloatArray:
        """A place on the path, free at its ends; without one, beside the base."""
        stage, positions = self._stage, self._get_motion().positions
        path = stage.path(positions)
        places = [path[int(share * len(path))] for share in (0.5, 0.4, 0.6, 0.3, 0.7)]
        around = 0.35 * stage.size * np.array([[0, 1], [0, -1], [1, 0], [-1, 0]])
        places += [np.append(place, 0.5 * size) for place in around]
        ends = positions[[0, -1]]
        free = (x for x in places if min(stage.shapes.gap(q, x) for q in ends) > size)
        return np.asarray(next(free, places[-1]))

    def _on_remove(self) -> None:
        name = self._choice.value
        if name != _NOTHING:
            self._editor.remove(name)
            self._drawn.remove(name)
            self._choose(_NOTHING)
            self._react(self._editor.world)

    def _on_picked(self, name: str) -> None:
        with self._stage.caught(), self._stage.lock:
            self._choose(name)

    def _on_moved(self) -> None:
        name, handle = self._choice.value, self.handle
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
        self._place_handle()
        self._show_sizes(name)

    def _place_handle(self) -> None:
        name = self._choice.value
        is_movable = name != _NOTHING and not self._editor[name].frame
        self.handle.visible = self._is_open and is_movable
        if is_movable:
            place = self._editor.place(name)
            self.handle.position, self.handle.wxyz = place[:3], np.roll(place[3:], 1)

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
