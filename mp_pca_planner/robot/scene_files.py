# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning scenes of MoveIt: ``.scene`` files of text, and moveit_msgs/PlanningScene as YAML."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import FloatArray, frozen_array
from ..exceptions import WorldError, printable, shown, unknown_name
from ..files import load_yaml, read_text, reading
from .world import ANY, Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World

_IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
# Constants of shape_msgs/SolidPrimitive.
_PRIMITIVES = {1: "box", 2: "sphere", 3: "cylinder", 4: "cone", 5: "prism"}
# Sizes of each shape in a message and in a .scene file.
_N_SIZES = {"box": 3, "sphere": 1, "cylinder": 2}
# Values of CollisionObject.operation that add an object, as numbers and as bytes in YAML.
_ADDED = (0, "\0", 2, "\2")


def read_scene(path: str | Path) -> World:
    """Read a planning scene, see :meth:`.World.from_file`."""
    where = f"scene file '{path}'"
    with reading(where, WorldError):
        try:
            text = read_text(path)
            return (_text_world if Path(path).suffix == ".scene" else _yaml_world)(text)
        except WorldError as error:
            raise WorldError(f"{where}: {error}") from None


def _text_world(text: str) -> World:
    """The world of a ``.scene`` file: words and numbers, and names that end with their line."""
    # An object is a name, its pose, the number of its shapes, each with a pose and a colour, and
    # its subframes, which are not needed. Files of older releases lack pose and subframes.
    if text.split()[-1:] != ["."]:
        raise WorldError("it ends before the final '.'")
    _, *objects = re.split(r"^\*", text.rstrip()[:-1], flags=re.MULTILINE)
    obstacles = []
    for content in objects:
        name, _, rest = content.partition("\n")
        name, words = name.strip(), iter(rest.split())
        try:
            whole = _numbers(words, 7) if len(rest.partition("\n")[0].split()) > 1 else _IDENTITY
            shapes = []
            for _ in range(int(next(words, "none"))):
                shape = _next_shape(words, name)
                shapes.append(shape.moved(_numbers(words, 7)).moved(whole))
                _numbers(words, 4)  # its colour
        except (WorldError, ValueError) as error:
            raise WorldError(f"object '{printable(name)}': {error}") from None
        if shapes:
            obstacles.append(Obstacle(name, shapes))
    return World(obstacles)


def _next_shape(words: Iterator[str], name: str) -> Shape:
    """The next shape of a ``.scene`` file."""
    kind = next(words, "")
    if kind == "mesh":
        n_vertices, n_triangles = (int(next(words, "none")) for _ in range(2))
        vertices = _numbers(words, 3 * n_vertices).reshape(-1, 3)
        return Mesh(vertices, _numbers(words, 3 * n_triangles).reshape(-1, 3))
    sizes = _numbers(words, _N_SIZES.get(kind, 0))
    # A cylinder has its radius first here.
    return _solid(kind, sizes[::-1] if kind == "cylinder" else sizes, name)


def _numbers(words: Iterator[str], n: int) -> FloatArray:
    """The next numbers of a ``.scene`` file, shape (n,)."""
    numbers = np.array([float(word) for word in islice(words, n)])
    if numbers.size < n:
        raise WorldError(f"it ends after {numbers.size} of {n} numbers")
    return numbers


def _solid(kind: str, sizes: Any, name: str) -> Shape:
    """A box, a sphere, or a cylinder from its height and radius."""
    if kind not in _N_SIZES:
        raise WorldError(
            f"'{printable(name)}' has a {printable(kind):.40}, which is not supported; accepted "
            "are box, sphere, cylinder and mesh"
        )
    what = f"dimensions of the {kind} of '{name}'"
    sizes = frozen_array(sizes, (_N_SIZES[kind],), what, WorldError)
    if kind == "box":
        return Box(sizes)
    return Sphere(float(sizes[0])) if kind == "sphere" else Cylinder(*sizes[::-1].tolist())


def _yaml_world(text: str) -> World:
    """The world of a moveit_msgs/PlanningScene as YAML."""
    content = load_yaml(text)
    if not isinstance(content, dict) or not {"world", "robot_state"} & content.keys():
        raise WorldError(
            "expected a moveit_msgs/PlanningScene: a mapping with the key 'world' (obstacles) or "
            "'robot_state' (attached objects)"
        )
    world, state = _part(content, "world"), _part(content, "robot_state")
    if _part(_part(world, "octomap"), "octomap").get("data"):
        raise WorldError("an octomap is not supported; give boxes or meshes instead")
    for key, neutral in (("padding", 0.0), ("scale", 1.0)):
        if any(link.get(key, neutral) != neutral for link in _parts(content, f"link_{key}")):
            raise WorldError(f"link_{key} is not supported; give a margin of the clearance instead")
    frames = {}
    for stamped in _parts(content, "fixed_frame_transforms"):
        place = _part(stamped, "transform")
        pose = {"position": place.get("translation"), "orientation": place.get("rotation")}
        frames[str(stamped.get("child_frame_id", ""))] = _pose(pose, "fixed_frame_transforms")
    obstacles: list[Obstacle] = []
    for message in _parts(world, "collision_objects"):
        if message.get("operation", 0) not in _ADDED:
            raise WorldError(
                f"object '{printable(str(message.get('id', '')))}': operation "
                f"{shown(message['operation'], 40)} is not supported; accepted is a scene whose "
                "objects are added (0)"
            )
        obstacles += _obstacle(message, frames)
    for message in _parts(state, "attached_collision_objects"):
        link, touched = str(message.get("link_name", "")), message.get("touch_links") or ()
        obstacles += _obstacle(_part(message, "object"), {}, link, list(map(str, touched)))
    return World(obstacles, _allowed(_part(content, "allowed_collision_matrix")))


def _obstacle(
    message: Mapping[str, Any],
    frames: Mapping[str, FloatArray],
    link: str | None = None,
    touch_links: Sequence[str] = (),
) -> Iterator[Obstacle]:
    """The obstacle of a moveit_msgs/CollisionObject, on a link if it is attached to one."""
    name, frame = str(message.get("id", "")), str(_part(message, "header").get("frame_id") or "")
    if link is not None and (not link or frame not in ("", link)):
        raise WorldError(
            f"attached object '{printable(name)}': expected its pose in the frame of its link "
            f"'{printable(link)}', got frame '{printable(frame)}'"
        )
    if message.get("planes"):
        _solid("plane", (), name)
    whole, place = _pose(message.get("pose"), f"pose of '{name}'"), frames.get(frame)
    shapes: list[Shape] = []
    for key, many in (("primitive", "primitives"), ("mesh", "meshes")):
        make = _primitive if key == "primitive" else _mesh
        made = [make(part, name) for part in _parts(message, many)]
        poses = message.get(f"{key}_poses") or [None] * len(made)
        if len(poses) != len(made):
            raise WorldError(f"'{name}' has {len(made)} shapes, but {len(poses)} {key}_poses")
        for shape, pose in zip(made, poses, strict=True):
            shape = shape.moved(_pose(pose, f"poses of '{name}'")).moved(whole)
            shapes.append(shape if place is None else shape.moved(place))
    if shapes:
        yield Obstacle(name, shapes, link or ("" if frame in frames else frame), touch_links)


def _primitive(message: Mapping[str, Any], name: str) -> Shape:
    """A shape_msgs/SolidPrimitive."""
    kind = message.get("type")
    kind = _PRIMITIVES.get(kind, kind) if isinstance(kind, int) else str(kind).lower()
    return _solid(str(kind), message.get("dimensions") or (), name)


def _mesh(message: Mapping[str, Any], name: str) -> Shape:
    """A shape_msgs/Mesh."""
    what = f"vertices of the mesh of '{name}'"
    vertices = [_numbers_of(v, "xyz", what) for v in message.get("vertices") or ()]
    triangles = [
        t["vertex_indices"] if isinstance(t, dict) else t for t in message.get("triangles") or ()
    ]
    return Mesh(np.reshape(vertices, (-1, 3)), triangles or np.zeros((0, 3)))


def _pose(pose: Any, what: str) -> FloatArray:
    """A geometry_msgs/Pose as an array, shape (7,); the identity if there is none."""
    numbers = [
        default
        if (pose or {}).get(key) is None
        else _numbers_of(pose[key], names, f"{key}, {what}")
        for key, names, default in (
            ("position", "xyz", _IDENTITY[:3]),
            ("orientation", "xyzw", _IDENTITY[3:]),
        )
    ]
    return np.concatenate(numbers)


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


def _part(content: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """The mapping of a key; an empty message in the place of nothing."""
    inner = content.get(key) or {}
    if not isinstance(inner, dict):
        raise WorldError(f"{key} must be a mapping, got {shown(inner, 60)}")
    return inner


def _parts(content: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """The list of mappings of a key; an empty one in the place of nothing."""
    items = content.get(key) or []
    if not (isinstance(items, list) and all(isinstance(item, dict) for item in items)):
        raise WorldError(f"{key} must be a list of mappings, got {shown(items, 60)}")
    return items
