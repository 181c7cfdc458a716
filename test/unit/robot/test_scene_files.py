# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Planning scenes of MoveIt, written by the tests."""

from contextlib import suppress

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from mp_pca_planner.exceptions import WorldError
from mp_pca_planner.robot.world import Box, Cylinder, Mesh, Obstacle, Sphere, World

IDENTITY = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
WEDGE = np.vstack([np.zeros(3), np.eye(3)]), [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]


def read(folder, text, name="x.yaml"):
    (folder / name).write_text(text, encoding="utf-8")
    return World.from_file(folder / name)


def text_of(numbers):
    return " ".join(map(repr, np.ravel(numbers).tolist()))


def as_text(obstacles, pose=IDENTITY, *, is_old=False):
    """A .scene file as MoveIt 2 exports it; older releases have no pose and no subframes."""
    lines = ["(noname)+"]
    for one in obstacles:
        whole = [] if is_old else [text_of(pose[:3]), text_of(pose[3:])]
        lines += [f"* {one.name}", *whole, str(len(one.shapes))]
        for shape in one.shapes:
            lines += [type(shape).__name__.lower()]
            if isinstance(shape, Mesh):
                counts = f"{len(shape.vertices)} {len(shape.triangles)}"
                lines += [counts, text_of(shape.vertices), text_of(shape.triangles.astype(int))]
            else:
                fields = {Box: ["size"], Sphere: ["radius"], Cylinder: ["radius", "height"]}
                lines += [text_of([*np.ravel([getattr(shape, x) for x in fields[type(shape)]])])]
            lines += [text_of(shape.position), text_of(shape.orientation), "0 0.5 1 1"]
        lines += [] if is_old else ["1", "tip", "0 0 0", "0 0 0 1"]
    return "\n".join([*lines, ".", ""])


def as_yaml(obstacles, pose=IDENTITY):
    def primitive(shape):
        fields = {Box: ["size"], Sphere: ["radius"], Cylinder: ["height", "radius"]}
        sizes = np.ravel([getattr(shape, x) for x in fields[type(shape)]]).tolist()
        return {"type": type(shape).__name__.lower(), "dimensions": sizes}

    objects = []
    for one in obstacles:
        message = {"id": one.name, "pose": pose_message(pose)}
        for shape in sorted(one.shapes, key=lambda shape: isinstance(shape, Mesh)):
            key, part = "primitive", None
            if isinstance(shape, Mesh):
                vertices = [dict(zip("xyz", v, strict=True)) for v in shape.vertices.tolist()]
                key, part = "mesh", {"vertices": vertices}
                part["triangles"] = [{"vertex_indices": t} for t in shape.triangles.tolist()]
            message.setdefault("primitives" if part is None else "meshes", []).append(
                part or primitive(shape)
            )
            message.setdefault(f"{key}_poses", []).append(pose_message(shape.pose))
        objects.append(message)
    return yaml.safe_dump({"world": {"collision_objects": objects}})


def pose_message(pose):
    return {"position": pose[:3].tolist(), "orientation": pose[3:].tolist()}


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
    st.builds(lambda *place: Mesh(*WEDGE, *place), places, quaternions),
)
poses = st.tuples(places, quaternions).map(np.concatenate)


@settings(max_examples=30, deadline=None)
@given(st.lists(st.lists(shapes, min_size=1, max_size=3), max_size=3), poses)
def test_shapes_come_back_from_files(tmp_path_factory, groups, pose):
    folder = tmp_path_factory.mktemp("scene")
    groups = [sorted(group, key=lambda shape: isinstance(shape, Mesh)) for group in groups]
    obstacles = [Obstacle(f"object {k}", group) for k, group in enumerate(groups)]
    for world, whole in (
        (read(folder, as_text(obstacles, pose), "x.scene"), pose),
        (read(folder, as_text(obstacles, is_old=True), "old.scene"), IDENTITY),
        (read(folder, as_yaml(obstacles, pose)), pose),
    ):
        assert world.names == tuple(one.name for one in obstacles)
        for one, other in zip(obstacles, world, strict=True):
            for given_shape, b in zip(one.shapes, other.shapes, strict=True):
                a = given_shape.moved(whole)
                assert type(a) is type(b)
                for field in vars(a).keys() - {"orientation", "solid"}:
                    np.testing.assert_allclose(getattr(a, field), getattr(b, field), atol=1e-9)
                # A quaternion and its negative are one orientation.
                assert abs(a.orientation @ b.orientation) == pytest.approx(1.0, abs=1e-9)


def test_frames_attached_objects_and_allowed_contacts_are_read(tmp_path):
    hand = {"header": {"frame_id": "hand"}, "primitives": [{"type": 2, "dimensions": [0.1]}]}
    can = {"type": 3, "dimensions": [0.3, 0.05]}
    scene = {
        "fixed_frame_transforms": [
            {"child_frame_id": "world", "transform": {"translation": {"z": 1.0}}},
        ],
        "robot_state": {
            "attached_collision_objects": [
                {"link_name": "hand", "touch_links": ["finger"], "object": {"id": "tool", **hand}}
            ]
        },
        "allowed_collision_matrix": {
            "entry_names": ["hand", "can"],
            "entry_values": [{"enabled": [False, True]}, {"enabled": [True, False]}],
            "default_entry_names": ["floor"],
            "default_entry_values": [True],
        },
        "world": {
            "collision_objects": [
                {"id": "can", "header": {"frame_id": "world"}, "primitives": [can]},
            ]
        },
    }
    world = read(tmp_path, yaml.safe_dump(scene))
    can, tool = world
    assert (can.frame, tool.frame, tool.touch_links) == ("", "hand", ("finger",))
    assert (can.shapes[0].radius, can.shapes[0].height) == (0.05, 0.3)
    np.testing.assert_allclose(can.shapes[0].position, [0, 0, 1])
    assert world.allows("hand", "can") and world.allows("floor", "anything")
    assert not world.allows("hand", "tool")


BALL, WEDGES = Obstacle("ball", [Sphere(0.04)]), Obstacle("wedge", [Mesh(*WEDGE)])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("sphere\n0.04", "plane\n0 0 1 0"), "'ball' has a plane, which is not supported"),
        (("sphere\n0.04", "sphere\n-0.04"), "'ball': radius of a sphere must be"),
        (("4 4\n", "4 999999999\n"), "object 'wedge': it ends after [0-9]+ of 2999999997 numbers"),
        (("\n.\n", "\n"), "it ends before the final"),
        (("* wedge", "* ball"), "'ball' given more than once"),
    ],
)
def test_scene_with_a_defect_is_rejected_by_file_and_reason(tmp_path, change, message):
    with pytest.raises(WorldError, match=r"scene file '.*x\.scene': .*" + message):
        read(tmp_path, as_text([BALL, WEDGES], is_old=True).replace(*change), "x.scene")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"planes": [{"coef": [0, 0, 1, 0]}]}, "'a' has a plane, which is not supported"),
        ({"primitives": [{"type": 4, "dimensions": [1, 1]}]}, "'a' has a cone"),
        ({"primitive_poses": [{}, {}]}, "'a' has 1 shapes, but 2 primitive_poses"),
        ({"pose": {"position": {"u": 2}}}, "no number is called 'u'"),
        ({"primitives": {"type": "box"}}, "primitives must be a list of mappings"),
    ],
)
def test_object_with_a_defect_is_rejected(tmp_path, change, message):
    one = {"id": "a", "primitives": [{"type": "sphere", "dimensions": [1]}]} | change
    with pytest.raises(WorldError, match=r"scene file '.*': .*" + message):
        read(tmp_path, yaml.safe_dump({"world": {"collision_objects": [one]}}))


@pytest.mark.parametrize(
    "text",
    [
        "{world: {octomap: {octomap: {data: [1]}}}}",
        "{world: {}, link_padding: [{link_name: a, padding: 0.1}]}",
        "{world: {}, allowed_collision_matrix: {entry_names: [a]}}",
        "robot_state: {attached_collision_objects: [{link_name: a, object: {header: "
        "{frame_id: b}}}]}",
    ],
)
def test_other_yaml_is_rejected(tmp_path, text):
    with pytest.raises(WorldError, match="scene file"):
        read(tmp_path, text)


@settings(max_examples=60, deadline=None)
@given(st.text(max_size=200) | st.text("*.01 \nboxsphermcyl", max_size=200))
def test_any_text_is_a_world_or_rejected(tmp_path_factory, text):
    for name in ("x.scene", "x.yaml"):
        with suppress(WorldError):
            read(tmp_path_factory.getbasetemp(), text, name)
