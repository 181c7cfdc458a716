# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Shapes of robots: meshes, simple shapes, a skeleton; and where joints are."""

from pathlib import Path

import numpy as np
import pytest
from support.arm import arm_robot

from mp_pca_planner.robot.model import Robot

trimesh = pytest.importorskip("trimesh", reason="the extra 'view' is not installed")
from mp_pca_planner.view.robot_shapes import RobotShapes  # noqa: E402

URDF = """<robot name="r"><material name="red"><color rgba="1 0 0 0.5"/></material>
<link name="base">{base}</link>
<link name="arm"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0"
iyz="0"/></inertial>{arm}</link>
<link name="tip"/>
<joint name="j" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 1"/>
<axis xyz="0 1 0"/><limit lower="-2" upper="2" velocity="1" effort="1"/></joint>
<joint name="f" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0.5 0 0"/></joint>
</robot>"""
MESH = '<visual><geometry><mesh filename="{}" scale="2 1 1"/></geometry></visual>'


def shapes(base: str = "", arm: str = "", folders: tuple[Path, ...] = ()) -> RobotShapes:
    urdf = URDF.format(base=base, arm=arm)
    return RobotShapes(Robot(urdf), folders)


def part(shape: str, tag: str = "visual", more: str = "") -> str:
    return f"<{tag}>{more}<geometry>{shape}</geometry></{tag}>"


def test_visual_shapes_come_before_collision_shapes_with_their_colours_and_places():
    origin = '<origin xyz="0 0 2" rpy="0 1.5707963267948966 0"/><material name="red"/>'
    found = shapes(
        part('<box size="1 2 3"/>'),
        part('<cylinder radius="0.1" length="2"/>', more=origin)
        + part('<sphere radius="9"/>', "collision"),
    )
    box, cylinder = found.shapes
    assert (box.joint, cylinder.joint) == (0, 1)
    np.testing.assert_allclose(box.mesh.extents, [1, 2, 3])
    np.testing.assert_allclose(cylinder.mesh.bounds[:, 0], [-1.0, 1.0], atol=1e-9)
    np.testing.assert_allclose(cylinder.mesh.bounds[:, 2], [1.9, 2.1], atol=1e-3)
    assert cylinder.colour == (1.0, 0.0, 0.0, 0.5)
    wrong = URDF.format(base=part('<box size="1 2 3"/>'), arm="").replace("0.5", "", 1)
    assert not RobotShapes(Robot(wrong), ()).notes


def test_a_link_whose_mesh_is_missing_is_drawn_by_its_collision_shape_or_a_skeleton():
    base, missing = part('<box size="1 1 1"/>'), MESH.format("nowhere.stl")
    covered = shapes(base, missing + part('<sphere radius="0.3"/>', "collision"))
    (ball,) = [s.mesh.extents for s in covered.shapes if s.joint == 1]
    np.testing.assert_allclose(ball, 0.6, atol=0.01)
    bare = shapes(base, missing)  # up to the tip
    assert max(s.mesh.bounds[1, 0] for s in bare.shapes if s.joint == 1) > 0.45
    assert all("nowhere.stl" in found.notes[0] for found in (covered, bare))


@pytest.mark.parametrize(
    ("shape", "content", "word"),
    [
        (part('<box size="1 2"/>'), "", "'arm'"),
        (part('<box size="1 1 nan"/>'), "", "'arm'"),
        (part("<cone/>"), "", "'arm'"),
        (MESH.format("box.stl"), "", "box.stl"),
        (MESH.format("box.stl"), "solid nothing\nendsolid nothing\n", "box.stl"),
    ],
)
def test_a_shape_that_cannot_be_drawn_is_left_out_with_a_note(tmp_path, shape, content, word):
    (tmp_path / "box.stl").write_text(content)
    found = shapes(part('<box size="1 1 1"/>'), shape, (tmp_path,))
    assert found.shapes[0].joint == 0 and word in found.notes[0]


def test_meshes_are_found_in_packages_and_scaled(tmp_path):
    (tmp_path / "pack" / "meshes").mkdir(parents=True)
    trimesh.creation.box((1, 1, 1)).export(tmp_path / "pack" / "meshes" / "box.stl")
    for folder in (tmp_path, tmp_path / "pack"):
        found = shapes(arm=MESH.format("package://pack/meshes/box.stl"), folders=(folder,))
        np.testing.assert_allclose(found.shapes[0].mesh.extents, [2, 1, 1])
        assert found.notes == ()


def test_places_agree_with_the_kinematics_of_the_robot():
    robot = arm_robot()
    found = RobotShapes(robot, ())
    rng = np.random.default_rng(0)
    for q in rng.uniform(-1.0, 1.0, (5, robot.n_joints)):
        position, turn = found.frame_pose(q, "wrist")
        x, y, z, w = np.roll(turn, -1)
        error, _ = robot.pose_error("wrist", q, position, np.array([x, y, z, w]))
        np.testing.assert_allclose(error, 0.0, atol=1e-9)
        joints, turns = found.placements(q)
        np.testing.assert_allclose(
            joints[-1], robot.frame_positions(q[None], ["lower_arm"])[0, 0], atol=1e-12
        )
        np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1.0)


def test_the_gap_of_a_point_is_that_of_the_moved_boxes():
    found = shapes(part('<box size="1 2 3"/>'), part('<box size="0.2 0.2 0.8"/>'))
    q = np.array([0.5 * np.pi])  # the arm's box lies along x, 1 m above the origin
    assert found.gap(q, np.array([0.0, 0.0, 0.5])) == 0.0
    assert found.gap(q, np.array([0.0, 3.0, 0.0])) == pytest.approx(2.0)
    assert found.gap(q, np.array([0.0, 1.3, 1.9])) == pytest.approx(0.5)
    assert found.gap(q, np.array([1.0, 0.0, 1.0])) == pytest.approx(0.5)
