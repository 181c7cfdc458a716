# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning scenes of MoveIt: ``.scene`` files of text, and moveit_msgs/PlanningScene as YAML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable, shown, unknown_name
from ..files import load_yaml, read_text, reading
from ..input_limits import INPUT_LIMITS
from .world import ANY, Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World

_IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
# Constants of shape_msgs/SolidPrimitive.
_PRIMITIVES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
# Sizes of each shape in a message and in a .scene file.
_N_SIZES = {"box": 3, "sphere": 1, "cylinder": 2}
_ACCEPTED = "accepted are box, sphere, cylinder and mesh"
# Values of CollisionObject.operation that add an object, as numbers and as bytes in YAML.
_ADDED = (0, "\0", 2, "\2")


def read_scene(path: str | Path) -> World:
    """Read a planning scene, see :meth:`.World.from_file`."""
    where = f"scene file '{path}'"
    with reading(where, WorldError):
        try:
            if Path(path).suffix == ".scene":
                return _TextScene(read_text(path)).world()
            return _yaml_world(load_yaml(read_text(path)))
        except WorldError as error:
            raise WorldError(f"{where}: {error}") from None


class _TextScene:
    """A ``.scene`` file: numbers and words, and names that end with their line."""

    def __init__(self, text: str) -> None:
        self._text, self._at = text, 0
        self._has_object_poses = False

    def world(self) -> World:
        self._line()  # the name of the scene
        first = re.search(r"^\*.*\n(.*)$", self._text, re.MULTILINE)
        # The line after a name is the object's pose, or in files of older releases a count.
        self._has_object_poses = first is not None and len(first[1].split()) > 1
        obstacles: list[Obstacle] = []
        while (mark := self._word()) == "*":
            obstacles += self._obstacle()
        if mark != ".":
            raise WorldError(f"expected '*' or the final '.', got '{printable(mark):.40}'")
        return World(obstacles)

    def _obstacle(self) -> Iterator[Obstacle]:
        """The obstacle whose name is next; none if it has no shapes."""
        name = self._line().strip()
        pose = self._pose() if self._has_object_poses else _IDENTITY
        shapes = []
        for _ in range(self._count(INPUT_LIMITS.shapes, f"shapes of '{name}'")):
            shape = self._shape(name)
            shapes.append(shape.moved(self._pose()).moved(pose))
            self._numbers(4)  # its colour
        if self._has_object_poses:
            for _ in range(self._count(INPUT_LIMITS.shapes, f"subframes of '{name}'")):
                self._line()
                self._pose()
        if shapes:
            yield Obstacle(name, shapes)

    def _shape(self, name: str) -> Shape:
        kind = self._word()
        if kind == "mesh":
            n_vertices = self._count(3 * INPUT_LIMITS.triangles, f"vertices of '{name}'")
            n_triangles = self._count(INPUT_LIMITS.triangles, f"triangles of '{name}'")
            vertices = self._numbers(3 * n_vertices).reshape(-1, 3)
            return Mesh(vertices, self._numbers(3 * n_triangles).reshape(-1, 3))
        if kind not in _N_SIZES:
            raise _unsupported(kind, name)
        sizes = self._numbers(_N_SIZES[kind])
        # A cylinder has its radius first here.
        return _solid(kind, sizes[::-1] if kind == "cylinder" else sizes)

    def _pose(self) -> FloatArray:
        return self._numbers(7)

    def _line(self) -> str:
        """The rest of the line; the next one if that is empty."""
        found = re.compile(r"\n*([^\n]*)" if self._at else r"([^\n]*)").match(self._text, self._at)
        assert found is not None  # even the empty text matches
        self._at = found.end()
        return found[1]

    def _word(self) -> str:
        found = re.compile(r"\s*(\S+)").match(self._text, self._at)
        if found is None:
            raise WorldError("it ends before the final '.'")
        self._at = found.end()
        return found[1]

    def _numbers(self, n: int) -> FloatArray:
        numbers = np.empty(n)
        for i in range(n):
            word = self._word()
            try:
                numbers[i] = float(word)
            except ValueError:
                raise WorldError(f"expected a number, got '{printable(word):.40}'") from None
        return numbers

    def _count(self, most: int, what: str) -> int:
        (number,) = self._numbers(1)
        if not (0 <= number <= most and number == int(number)):
            raise WorldError(f"number of {what} must be from 0 to {most}, got {number:g}")
        return int(number)


def _yaml_world(content: Any) -> World:
    """The world of a moveit_msgs/PlanningScene."""
    if not isinstance(content, dict) or not {"world", "robot_state"} & content.keys():
        raise WorldError(
            "expected a moveit_msgs/PlanningScene: a mapping with the key 'world' (obstacles) or "
            "'robot_state' (attached objects)"
        )
    world, state = _mapping(content, "world"), _mapping(content, "robot_state")
    if _mapping(_mapping(world, "octomap"), "octomap").get("data"):
        raise WorldError("an octomap is not supported; give boxes or meshes instead")
    for key, neutral in (("padding", 0.0), ("scale", 1.0)):
        if any(one.get(key, neutral) != neutral for one in _list(content, f"link_{key}")):
            raise WorldError(f"link_{key} is not supported; give a margin of the clearance instead")
    frames = {}
    for one in _list(content, "fixed_frame_transforms"):
        place = _mapping(one, "transform")
        pose = {"position": place.get("translation"), "orientation": place.get("rotation")}
        frames[str(one.get("child_frame_id", ""))] = _pose(pose, "fixed_frame_transforms")
    obstacles: list[Obstacle] = []
    for one in _list(world, "collision_objects"):
        obstacles += _collision_object(one, frames)
    for one in _list(state, "attached_collision_objects"):
        obstacles += _attached_object(one)
    return World(obstacles, _allowed(_mapping(content, "allowed_collision_matrix")))


def _collision_object(
    one: Mapping[str, Any], frames: Mapping[str, FloatArray]
) -> Iterator[Obstacle]:
    name, frame = str(one.get("id", "")), _frame_of(one)
    if one.get("operation", 0) not in _ADDED:
        raise WorldError(
            f"object '{printable(name)}': operation {shown(one['operation'], 40)} is not "
            "supported; accepted is a scene whose objects are added (0)"
        )
    shapes = _shapes_of(one, name)
    if frame in frames:
        shapes, frame = [shape.moved(frames[frame]) for shape in shapes], ""
    if shapes:
        yield Obstacle(name, shapes, frame)


def _attached_object(one: Mapping[str, Any]) -> Iterator[Obstacle]:
    body, link = _mapping(one, "object"), str(one.get("link_name", ""))
    name, frame = str(body.get("id", "")), _frame_of(body)
    if not link or frame not in ("", link):
        raise WorldError(
            f"attached object '{printable(name)}': expected its pose in the frame of its link "
            f"'{printable(link)}', got frame '{printable(frame)}'"
        )
    if shapes := _shapes_of(body, name):
        yield Obstacle(name, shapes, link, [str(name) for name in one.get("touch_links") or ()])


def _frame_of(one: Mapping[str, Any]) -> str:
    return str(_mapping(one, "header").get("frame_id") or "")


def _shapes_of(one: Mapping[str, Any], name: str) -> list[Shape]:
    """The shapes of a moveit_msgs/CollisionObject in its frame."""
    if one.get("planes"):
        raise _unsupported("plane", name)
    whole = _pose(one.get("pose"), f"pose of '{name}'")
    shapes: list[Shape] = []
    for key, many in (("primitive", "primitives"), ("mesh", "meshes")):
        made = [(_primitive if key == "primitive" else _mesh)(x, name) for x in _list(one, many)]
        poses = one.get(f"{key}_poses") or [None] * len(made)
        if len(poses) != len(made):
            raise WorldError(f"'{name}' has {len(made)} shapes, but {len(poses)} {key}_poses")
        for shape, pose in zip(made, poses, strict=True):
            shapes.append(shape.moved(_pose(pose, f"poses of '{name}'")).moved(whole))
    return shapes


def _primitive(one: Mapping[str, Any], name: str) -> Shape:
    kind = one.get("type")
    kind = _PRIMITIVES.get(kind, kind) if isinstance(kind, int) else str(kind).lower()
    if kind not in _N_SIZES:
        raise _unsupported(str(kind), name)
    what = f"dimensions of the {kind} of '{name}'"
    sizes = one.get("dimensions") or ()
    return _solid(kind, frozen_array(sizes, (_N_SIZES[kind],), what, WorldError))


def _solid(kind: str, sizes: FloatArray) -> Shape:
    """A box, a sphere, or a cylinder from its height and radius."""
    if kind == "box":
        return Box(sizes)
    if kind == "sphere":
        return Sphere(float(sizes[0]))
    return Cylinder(radius=float(sizes[1]), height=float(sizes[0]))


def _mesh(one: Mapping[str, Any], name: str) -> Shape:
    """A shape_msgs/Mesh."""
    what = f"vertices of the mesh of '{name}'"
    vertices = [_numbers_of(v, "xyz", what) for v in one.get("vertices") or ()]
    triangles = [
        t["vertex_indices"] if isinstance(t, dict) else t for t in one.get("triangles") or ()
    ]
    return Mesh(np.reshape(vertices, (-1, 3)), triangles or np.zeros((0, 3)))


def _pose(pose: Any, what: str) -> FloatArray:
    """A geometry_msgs/Pose as an array, shape (7,); the identity if there is none."""
    found = [
        default
        if (pose or {}).get(key) is None
        else _numbers_of(pose[key], names, f"{key}, {what}")
        for key, names, default in (
            ("position", "xyz", _IDENTITY[:3]),
            ("orientation", "xyzw", _IDENTITY[3:]),
        )
    ]
    return np.concatenate(found)


def _numbers_of(content: Any, names: str, what: str) -> FloatArray:
    """Numbers that are given as a list or by their names."""
    if isinstance(content, dict):
        for key in content:
            if key not in list(names):
                raise WorldError(f"{what}: {unknown_name('number', str(key), names)}")
        content = [content.get(key, 0.0) for key in names]
    return frozen_array(content, (len(names),), what, WorldError)


def _allowed(matrix: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """The pairs that a moveit_msgs/AllowedCollisionMatrix doesn't check."""
    names, rows = matrix.get("entry_names") or [], matrix.get("entry_values") or []
    enabled = [row["enabled"] if isinstance(row, dict) else row for row in rows]
    if any(len(row) != len(names) for row in (enabled, *enabled)):
        raise WorldError(
            f"allowed_collision_matrix must have {len(names)} entry_values with as many values, "
            "as it has entry_names"
        )
    for name, row in zip(names, enabled, strict=True):
        yield from ((str(name), str(n)) for n, may in zip(names, row, strict=True) if may)
    defaults = (matrix.get(f"default_entry_{kind}") or [] for kind in ("names", "values"))
    yield from ((str(name), ANY) for name, may in zip(*defaults, strict=False) if may)


def _mapping(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The mapping of a key; an empty one in the place of nothing."""
    found = content.get(key) or {}
    if not isinstance(found, dict):
        raise WorldError(f"{key} must be a mapping, got {shown(found, 60)}")
    return found


def _list(content: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """The list of mappings of a key; an empty one in the place of nothing."""
    found = content.get(key) or []
    if not (isinstance(found, list) and all(isinstance(one, dict) for one in found)):
        raise WorldError(f"{key} must be a list of mappings, got {shown(found, 60)}")
    return found


def _unsupported(kind: str, name: str) -> WorldError:
    return WorldError(
        f"'{printable(name)}' has a {printable(kind):.40}, which is not supported; {_ACCEPTED}"
    )
