# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.robot.world import Box, Cylinder, Mesh, Obstacle, Shape, Sphere, World

# As MoveIt 2 exports it: each object has a pose, each shape one in it, a colour, and no subframes.
SCENE = """(noname)+
* the table
0.5 0 0.1
0 0 0 1
1
box
1 2 0.2
0 0 -0.1
0 0 0 1
0 0 0 0
0
* can and ball
0 0 1
0 0 0.707107 0.707107
2
cylinder
0.05 0.3
1 0 0
0 0 0 1
0 0 0 0
sphere
0.04
0 0 0
0 0 0 1
0.1 0.2 0.3 1
1
tip
0 0 0
0 0 0 1
* wedge
0 0 0
0 0 0 1
1
mesh
4 4
0 0 0
1 0 0
0 1 0
0 0 1
0 2 1
0 1 3
0 3 2
1 2 3
0 0 0
0 0 0 1
0 0 0 0
0
.
"""
# Older releases have no pose of an object, and no subframes.
OLD_SCENE = """(noname)
* box 1
1
box
1 2 3
4 5 6
0 0 0 1
0 0 0 0
.
"""


def read(folder: Path, text: str, name: str = "x.yaml") -> World:
    (folder / name).write_text(text, encoding="utf-8")
    return World.from_file(folder / name)


def test_scene_of_moveit_is_read(tmp_path):
    table, both, wedge = read(tmp_path, SCENE, "x.scene")
    assert (table.name, both.name, wedge.name) == ("the table", "can and ball", "wedge")
    (top,) = table.shapes
    np.testing.assert_allclose(top.size, [1, 2, 0.2])
    np.testing.assert_allclose(top.position, [0.5, 0, 0])
    can, ball = both.shapes
    assert (can.radius, can.height, ball.radius) == (0.05, 0.3, 0.04)
    np.testing.assert_allclose(can.position, [0, 1, 1], atol=1e-6)
    assert isinstance(wedge.shapes[0], Mesh) and len(wedge.shapes[0].triangles) == 4
    (box,) = read(tmp_path, OLD_SCENE, "old.scene")
    assert box.name == "box 1"
    np.testing.assert_allclose(box.shapes[0].position, [4, 5, 6])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sphere\n0.04", "plane\n0 0 1 0"), "'can and ball' has a plane, which is not supported"),
        (
            ("sphere\n0.04", "sphere\n-0.04"),
            "'can and ball': radius of a sphere must be",
        ),
        (("sphere\n0.04", "sphere\nnan"), "radius of a sphere is nan"),
        (
            ("sphere\n0.04", "sphere\nbig"),
            "can and ball': could not convert .*'big'",
        ),
        (("4 4\n", "4 999999999\n"), "object 'wedge': it ends after 24 of 2999999997 numbers"),
        (("\n.\n", "\n"), "it ends before the final"),
        (("* wedge", "* the table"), "'the table' given more than once"),
        (("0 0 0.707107 0.707107", "0 0 0 0"), "length 1, got one of length 0"),
    ],
)
def test_scene_with_a_defect_is_refused_by_file_and_reason(tmp_path, change, message):
    with pytest.raises(WorldError, match=r"scene file '.*x\.scene': .*" + message):
        read(tmp_path, SCENE.replace(*change), "x.scene")


PLANNING_SCENE = {
    "fixed_frame_transforms": [
        {"child_frame_id": "world", "transform": {"translation": {"z": 1.0}}},
    ],
    "robot_state": {
        "attached_collision_objects": [
            {
                "link_name": "hand",
                "touch_links": ["finger"],
                "object": {
                    "id": "tool",
                    "header": {"frame_id": "hand"},
                    "primitives": [{"type": 2, "dimensions": [0.1]}],
                },
            }
        ]
    },
    "allowed_collision_matrix": {
        "entry_names": ["hand", "table"],
        "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}],
        "default_entry_names": ["floor"],
        "default_entry_values": [True],
    },
    "world": {
        "collision_objects": [
            {
                "id": "table",
                "header": {"frame_id": "world"},
                "pose": {"position": {"x": 1.0}, "orientation": {"w": 1.0}},
                "primitives": [
                    {"type": "box", "dimensions": [1, 2, 3]},
                    {"type": 3, "dimensions": [0.3, 0.05]},
                ],
                "primitive_poses": [
                    {"position": [0, 0, 0]},
                    {"position": [0, 1, 0], "orientation": [0, 0, 0, 1]},
                ],
                "meshes": [
                    {
                        "vertices": [{}, {"x": 1}, {"y": 1}],
                        "triangles": [{"vertex_indices": [0, 1, 2]}],
                    }
                ],
            },
        ]
    },
}


def test_planning_scene_is_read(tmp_path):
    world = read(tmp_path, yaml.safe_dump(PLANNING_SCENE))
    table, tool = world
    assert (table.name, table.frame, tool.name) == ("table", "", "tool")
    assert (tool.frame, tool.touch_links) == ("hand", ("finger",))
    box, can, mesh = table.shapes
    np.testing.assert_allclose(box.position, [1, 0, 1])
    np.testing.assert_allclose(can.position, [1, 1, 1])
    assert (can.radius, can.height) == (0.05, 0.3)
    assert isinstance(mesh, Mesh)
    assert world.allows("hand", "table") and world.allows("floor", "anything")
    assert not world.allows("hand", "tool")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"planes": [{"coef": [0, 0, 1, 0]}]}, "'a' has a plane, which is not supported"),
        ({"primitives": [{"type": 4, "dimensions": [1, 1]}]}, "'a' has a cone"),
        ({"primitives": [{"type": "box", "dimensions": [1]}]}, "dimensions of the box of 'a'"),
        ({"primitives": [{"type": "box"}]}, "dimensions of the box of 'a'"),
        ({"primitive_poses": [{}, {}]}, "'a' has 1 shapes, but 2 primitive_poses"),
        ({"operation": 1}, "'a': operation 1 is not supported"),
        ({"primitives": 3}, "primitives must be a list of mappings, got 3"),
        ({"pose": {"position": [1, 2]}}, "position, pose of 'a' must have the shape"),
        ({"pose": {"position": {"u": 2}}}, "no number is called 'u'"),
        ({"id": ""}, "an obstacle must have a name"),
    ],
)
def test_object_with_a_defect_is_refused(tmp_path, change, message):
    one = {"id": "a", "primitives": [{"type": "sphere", "dimensions": [1]}]} | change
    with pytest.raises(WorldError, match=r"scene file '.*': .*" + message):
        read(tmp_path, yaml.safe_dump({"world": {"collision_objects": [one]}}))


@pytest.mark.parametrize(
    "text",
    [
        "",
        "3",
        "a: b",
        "world: [1]",
        "world: {collision_objects: [3]}",
        "world: &a {collision_objects: *a}",
        "{world: {octomap: {octomap: {data: [1]}}}}",
        "{world: {}, link_padding: [{link_name: a, padding: 0.1}]}",
        "{world: {}, allowed_collision_matrix: {entry_names: [a]}}",
        "robot_state: {attached_collision_objects: [{link_name: a, object: {header: "
        "{frame_id: b}}}]}",
        "[" * 10_000,
    ],
)
def test_other_yaml_is_refused(tmp_path, text):
    with pytest.raises(WorldError, match="scene file"):
        read(tmp_path, text)
    with pytest.raises(WorldError, match="can't be read"):
        World.from_file(tmp_path / "none.yaml")


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200) | st.text("*.01 \nboxsphermcyl", max_size=200))
def test_any_text_is_a_world_or_refused(tmp_path_factory, text):
    for name in ("x.scene", "x.yaml"):
        path = tmp_path_factory.getbasetemp() / name
        path.write_text(text, encoding="utf-8")
        with suppress(WorldError):
            World.from_file(path)
        path.unlink()


lengths = st.floats(1e-3, 10.0)
places = st.tuples(*[st.floats(-10.0, 10.0)] * 3)
quaternions = (
    st.tuples(*[st.floats(-1.0, 1.0)] * 4)
    .map(np.array)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
shapes = st.one_of(
    st.builds(Box, st.tuples(lengths, lengths, lengths), places, quaternions),
    st.builds(Sphere, lengths, places, quaternions),
    st.builds(Cylinder, lengths, lengths, places, quaternions),
)


def as_text(obstacles: list[Obstacle]) -> str:
    """A .scene file, written on its own."""
    lines = ["scene"]
    for one in obstacles:
        lines += [f"* {one.name}", "0 0 0", "0 0 0 1", str(len(one.shapes))]
        for shape in one.shapes:
            sizes = {
                Box: lambda s: s.size,
                Sphere: lambda s: [s.radius],
                Cylinder: lambda s: [s.radius, s.height],
            }[type(shape)](shape)
            lines += [type(shape).__name__.lower()]
            lines += [
                " ".join(map(repr, map(float, numbers)))
                for numbers in (sizes, shape.position, shape.orientation, [0, 0, 0, 0])
            ]
        lines.append("0")
    return "\n".join([*lines, ".", ""])


def as_yaml(obstacles: list[Obstacle]) -> str:
    def primitive(shape: Shape) -> dict[str, object]:
        sizes = {
            Box: lambda s: s.size.tolist(),
            Sphere: lambda s: [s.radius],
            Cylinder: lambda s: [s.height, s.radius],
        }[type(shape)](shape)
        return {"type": type(shape).__name__.lower(), "dimensions": sizes}

    objects = [
        {
            "id": one.name,
            "primitives": [primitive(shape) for shape in one.shapes],
            "primitive_poses": [
                {"position": s.position.tolist(), "orientation": s.orientation.tolist()}
                for s in one.shapes
            ],
        }
        for one in obstacles
    ]
    return yaml.safe_dump({"world": {"collision_objects": objects}})


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(shapes, min_size=1, max_size=3), max_size=3))
def test_shapes_come_back_from_files(tmp_path_factory, groups):
    folder = tmp_path_factory.mktemp("scene")
    obstacles = [Obstacle(f"object {k}", group) for k, group in enumerate(groups)]
    for world in (
        read(folder, as_text(obstacles), "x.scene"),
        read(folder, as_yaml(obstacles)),
    ):
        assert world.names == tuple(one.name for one in obstacles)
        for one, other in zip(obstacles, world, strict=True):
            for a, b in zip(one.shapes, other.shapes, strict=True):
                assert type(a) is type(b)
                for field in vars(a).keys() - {"orientation"}:
                    np.testing.assert_allclose(getattr(a, field), getattr(b, field), atol=1e-9)
                # A quaternion and its negative are one orientation.
                assert abs(a.orientation @ b.orientation) == pytest.approx(1.0, abs=1e-9)
