# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The panel of the obstacles: drawn, added, moved, resized and removed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import viser
from numpy.typing import ArrayLike

from ..arrays import FloatArray
from ..plotting.motion import surface
from ..robot.world import Box, Cylinder, Obstacle, Shape, Sphere, World
from .robot_shapes import Rgb, add_mesh
from .stage import ShownMotion, Stage, part

NAME = "World"
_NOTHING = "none"
_TEXT = "Add an obstacle, and drag its arrows: the plan avoids it. Click another one to choose it."
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

    def __getitem__(self, name: str) -> Obstacle:
        return next(one for one in self.world if one.name == name)

    def place(self, name: str) -> FloatArray:
        """The middle of the shapes of an obstacle, shape (3,) [m]."""
        return np.asarray(np.mean([shape.position for shape in self[name].shapes], axis=0))

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
        self.world = self.world.with_obstacles(Obstacle(name, shapes[kind]))
        return name

    def move(self, name: str, place: FloatArray) -> None:
        """Move the middle of an obstacle to a place, shape (3,) [m]; nothing is turned."""
        shift = np.append(place - self.place(name), [0.0, 0.0, 0.0, 1.0])
        self._replace(name, tuple(shape.moved(shift) for shape in self[name].shapes))

    def resize(self, name: str, sizes: Iterable[float]) -> None:
        """Give the sizes of :meth:`sizes` of an obstacle other values [m]."""
        shape, values = self[name].shapes[0], tuple(sizes)
        kind: Any = type(shape)
        given = (values,) if isinstance(shape, Box) else values
        self._replace(name, (kind(*given, shape.position, shape.orientation),))

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

    def _replace(self, name: str, shapes: tuple[Shape, ...]) -> None:
        """Give an obstacle other shapes; the order stays."""
        obstacles = [replace(one, shapes=shapes) if one.name == name else one for one in self.world]
        self.world = World(obstacles, self.world.allowed)


class DrawnObstacle:
    """An obstacle in the scene; one attached to a link moves with it.

    Parameters
    ----------
    stage : Stage
        The scene.
    obstacle : Obstacle
        The obstacle.
    place : array, shape (3,)
        The middle of its shapes [m].
    pick : callable
        Called when a person clicks it.
    """

    def __init__(
        self, stage: Stage, obstacle: Obstacle, place: FloatArray, pick: Callable[[], None]
    ) -> None:
        scene, parent = stage.server.scene, "/world"
        if obstacle.frame:
            joint, position, turn = stage.shapes.link_place(obstacle.frame)
            parent = f"/robot/{joint}/{obstacle.frame}"
            scene.add_frame(parent, show_axes=False, position=position, wxyz=turn)
        node = f"{parent}/{obstacle.name.replace('/', '|')}"
        self.root = scene.add_frame(node, show_axes=False, position=place)
        self._meshes = []
        for i, shape in enumerate(obstacle.shapes):
            look: Any = {"side": "double", "flat_shading": isinstance(shape, Box)}
            look |= {"position": shape.position - place, "wxyz": np.roll(shape.orientation, 1)}
            mesh = add_mesh(scene, f"{node}/{i}", surface(shape), _OBSTACLE, **look)
            mesh.on_click(lambda _: pick())
            self._meshes.append(mesh)

    def mark(self, is_chosen: bool) -> None:
        """Draw it in the colour of the chosen one, or of the others."""
        for mesh in self._meshes:
            mesh.color = _CHOSEN if is_chosen else _OBSTACLE


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
        gui = stage.server.gui
        gui.add_html(part("lines", [_TEXT]))
        kinds = gui.add_button_group("Add", KINDS)
        self._choice: Any = gui.add_dropdown("Obstacle", (_NOTHING,))
        self._sizes: list[Any] = []
        self._folder = gui.add_folder(None)
        remove = gui.add_button("Remove", icon=viser.Icon.TRASH, color="gray")
        self.handle = stage.add_handle("/obstacle_handle", disable_rotations=True, visible=False)
        stage.on_drag(self.handle, lambda _: self._on_moved())
        stage.on_click(kinds, lambda: self._on_add(kinds.value))
        stage.on_click(remove, self._on_remove)
        stage.on_change(self._choice, lambda: self._choose(self._choice.value))
        self._drawn: dict[str, DrawnObstacle] = {}
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
        places: list[FloatArray] = [path[int(x * len(path))] for x in (0.5, 0.4, 0.6, 0.3, 0.7)]
        around = 0.35 * stage.size * np.array([[0, 1], [0, -1], [1, 0], [-1, 0]])
        places += [np.append(place, 0.5 * size) for place in around]
        ends = positions[[0, -1]]
        free = (x for x in places if min(stage.shapes.gap(q, x) for q in ends) > size)
        return np.asarray(next(free, places[-1]))

    def _on_remove(self) -> None:
        name = self._choice.value
        if name != _NOTHING:
            self._editor.remove(name)
            self._drawn.pop(name).root.remove()
            self._choose(_NOTHING)
            self._react(self._editor.world)

    def _on_picked(self, name: str) -> None:
        with self._stage.caught(), self._stage.lock:
            self._choose(name)

    def _on_moved(self) -> None:
        name = self._choice.value
        if name != _NOTHING:
            place = self.handle.position
            self._editor.move(name, place)
            self._drawn[name].root.position = place
            self._react(self._editor.world)

    def _on_size(self) -> None:
        name = self._choice.value
        self._editor.resize(name, [number.value for number in self._sizes])
        self._draw(name)
        self._drawn[name].mark(True)
        self._react(self._editor.world)

    def _choose(self, name: str) -> None:
        """Make an obstacle the chosen one."""
        self._choice.options = (_NOTHING, *self._editor.world.names)
        self._choice.value = name
        for other, drawn in self._drawn.items():
            drawn.mark(other == name)
        self._place_handle()
        self._show_sizes(name)

    def _place_handle(self) -> None:
        name = self._choice.value
        is_movable = name != _NOTHING and not self._editor[name].frame
        self.handle.visible = self._is_open and is_movable
        if is_movable:
            self.handle.position = self._editor.place(name)

    def _show_sizes(self, name: str) -> None:
        """Show a number for each size of the chosen obstacle."""
        for number in self._sizes:
            number.remove()
        sizes = {} if name == _NOTHING else self._editor.sizes(name)
        add = self._stage.server.gui.add_number
        with self._folder:
            self._sizes = [
                add(f"{label} [m]", value, min=0.005, max=100.0, step=0.005)
                for label, value in sizes.items()
            ]
        for number in self._sizes:
            self._stage.on_change(number, self._on_size)

    def _draw(self, name: str) -> None:
        """Draw an obstacle, in the place of what was drawn of it before."""
        if name in self._drawn:
            self._drawn.pop(name).root.remove()
        self._drawn[name] = DrawnObstacle(
            self._stage, self._editor[name], self._editor.place(name), lambda: self._on_picked(name)
        )
