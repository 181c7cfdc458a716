# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Descriptions are read as Pinocchio reads them, or rejected in a sentence, never on stderr."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from mp_pca_planner.exceptions import RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.robot.model import Robot
from mp_pca_planner.robot.urdf import read_description

ARM = """<robot name="arm"><link name="base"/>
<joint name="one" type="revolute"><origin xyz="0 0 1" rpy="0 0 0"/><parent link="base"/>
  <child link="rod"/><axis xyz="0 1 0"/>
  <limit lower="-1" upper="1" velocity="2" effort="30"/></joint>
<link name="rod"><collision><geometry><box size="1 1 1"/></geometry></collision></link></robot>"""
SECRET = '<!DOCTYPE robot [<!ENTITY e SYSTEM "file:///etc/passwd">]>'
LAUGHS = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))


def changed(old, new):
    assert old in ARM
    return ARM.replace(old, new)


def many(kind, n):
    links = "".join(f'<link name="l{i}"/>' for i in range(n + 1))
    limit = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'
    joints = "".join(
        f'<joint name="j{i}" type="{kind if i else "revolute"}"><parent link="l{i}"/>'
        f'<child link="l{i + 1}"/>{limit}</joint>'
        for i in range(n)
    )
    return f'<robot name="many">{links}{joints}</robot>'


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        ("<robot", "not XML"),
        ("<mujoco/>", r"<mujoco>, not <robot> \(MuJoCo's MJCF\): give the URDF of the same robot"),
        (changed('size="1 1 1"', 'size="${a} 1 1"'), "xacro"),
        (changed('size="1 1 1"', 'size="$(arg size)"'), "xacro"),
        (changed('type="revolute"', 'type="hinge"'), "no revolute, continuous or prismatic joint"),
        (changed('parent link="base"', 'parent link="bas"'), "link 'bas' of joint 'one' not"),
        (changed('<link name="base"/>', '<link name="base"/><link name="x"/>'), "'base' and 'x'"),
        (changed('xyz="0 0 1"', 'xyz="0 1"'), "'0 1'; Malformed .* origin element for joint 'one'"),
        (changed('xyz="0 1 0"', 'xyz="0 -0.0 0"'), "joint 'one': its <axis> has no direction"),
        # Versions of urdfdom differ in the order of what they say.
        (changed('upper="1"', 'upper="inf"'), r"(?=.*joint 'one')(?=.*upper value \(inf\) is not)"),
        (changed("<limit ", "<bounds "), "Joint 'one' is of type REVOLUTE but it does not specify"),
        (changed("<limit", '<mimic joint="one" multiplier="x"/><limit'), "'one': 'multiplier' of"),
        (many("revolute", 20_000), "20001 links and 20000 movable joints, but at most 500 and 200"),
        (f'<!DOCTYPE robot [<!ENTITY e0 "ha">{LAUGHS}]>' + changed("arm", "&e9;"), "amplification"),
        (SECRET + changed("</robot>", "&e;</robot>"), "undefined entity"),
    ],
)
def test_descriptions_that_can_not_be_used_are_rejected_in_silence(urdf, message, capfd):
    with pytest.raises(RobotError, match=message):
        Robot(urdf)
    assert capfd.readouterr() == ("", "")


def test_largest_descriptions_are_read_and_deeper_ones_rejected():
    assert Robot(many("fixed", 499)).n_joints == 1
    assert Robot(many("revolute", 200)).n_joints == 200
    moments = '<inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
    deep = "<a>" * 10_000 + "</a>" * 10_000 + f'<mass value="1"/>{moments}'
    with pytest.raises(RobotError, match="nested too deeply"):
        Robot(changed('<link name="rod">', f'<link name="rod"><inertial>{deep}</inertial>'))


@pytest.mark.parametrize(
    ("shape", "message"),
    [
        ('<box size="1 1"/>', "'size' of <box> is '1 1', expected 3 numbers of at most 1e"),
        ('<cylinder radius="1" length="nan"/>', "'length' of <cylinder> is 'nan'"),
        ("<torus/>", "its geometry is 'torus', expected one of box, sphere, cylinder, mesh"),
    ],
)
def test_shapes_that_can_not_be_used_are_rejected_when_collisions_matter(shape, message, capfd):
    robot = Robot(changed('<box size="1 1 1"/>', shape))
    assert robot.frame_names == ("base", "rod")
    with pytest.raises(RobotError, match=f"<collision> of link 'rod': {message}"):
        CollisionModel(robot)
    assert capfd.readouterr() == ("", "")


def test_what_is_not_needed_may_be_wrong_and_numbers_are_read_as_written(capfd):
    left = '<!-- <xacro:arm mass="${mass}"/> -->'
    urdf = changed('<link name="rod">', '<link name="rod"><visual><geometry/></visual>')
    urdf = urdf.replace("</joint>", '<dynamics/><safety_controller k_velocity="x"/></joint>')
    urdf = urdf.replace("</robot>", f'{left}<material name="a"/><material name="a"/></robot>')
    urdf = urdf.replace('lower="-1"', 'lower="-1.25e0"').replace(
        'xyz="0 0 1"', 'xyz=" 1e-9  +2 3."'
    )
    robot = Robot(urdf.replace(' name="arm"', ""))
    assert (robot.joint_names, robot.limits().lower.tolist()) == (("one",), [-1.25])
    place = robot.frame_positions(np.zeros((1, 1)), ["rod"])[0, 0]
    assert place.tolist() == [1e-9, 2.0, 3.0]
    assert capfd.readouterr() == ("", "")


NOTHING_MOVES = {"bluevolta", "falcon", "iris_simple", "quadrotor_base", "ur3"}
WITHOUT_INERTIAS = {  # fingers without mass; inertia tensors that no body has
    *("bluevolta_bravo7_gripper", "bravo7_gripper", "falcon_bravo7_gripper", "icub"),
    *("icub_reduced", "romeo", "romeo_laas_small", "romeo_small"),
}


def test_the_part_that_is_read_of_real_descriptions_makes_the_model_of_the_whole(capfd):
    loader = pytest.importorskip(
        "example_robot_data.robots_loader",
        reason="example-robot-data is not installed (extra 'peers')",
    )
    folder = Path(loader.getModelPath("panda_description/urdf/panda.urdf"))
    n_models, refused = 0, set()
    for path in [config_file("human_arm.urdf"), *sorted(folder.glob("**/*.urdf"))]:
        if path.stem in NOTHING_MOVES:
            continue
        text = path.read_text(encoding="utf-8")
        try:
            Robot(text).require_inertias("tests")
        except RobotError:
            refused.add(path.stem)
        found = read_description(text, path.name)
        if "continuous" in found.types.values():
            continue  # one angle here, a cosine and a sine in Pinocchio
        part, whole = found.model, pin.buildModelFromXML(text)
        assert list(part.names) == list(whole.names)
        assert [f.name for f in part.frames] == [f.name for f in whole.frames]
        for kind in ("inertias", "jointPlacements"):
            pairs = zip(getattr(part, kind), getattr(whole, kind), strict=True)
            assert all(one.isApprox(other, 1e-12) for one, other in pairs), path.name
        np.testing.assert_array_equal(part.effortLimit, whole.effortLimit)
        np.testing.assert_array_equal(part.lowerPositionLimit, whole.lowerPositionLimit)
        assert found.inertias.keys() == {x for x in found.links if found.states(x, "inertial")}
        n_models += 1
    assert n_models > 30 and refused == WITHOUT_INERTIAS
    assert capfd.readouterr() == ("", "")
