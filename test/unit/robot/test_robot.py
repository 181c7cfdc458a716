# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot model: chosen joints, locked joints, dynamics and kinematics."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot

from mp_pca_planner.exceptions import LimitsError, RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.robot.model import Robot

# A pendulum of 2 kg at 0.5 m on a continuous joint, on a cart that slides along x, with a
# gripper finger and a wheel that are of no interest here.
CART = """<robot name="cart">
<link name="world"/>
<joint name="finger" type="prismatic"><parent link="world"/><child link="tip"/><axis xyz="0 0 1"/>
  <limit lower="0.01" upper="0.04" velocity="1" effort="0"/></joint>
<link name="tip"/>
<joint name="slide" type="prismatic"><parent link="world"/><child link="cart"/>
  <axis xyz="1 0 0"/><limit lower="-1" upper="1" velocity="2" effort="30"/></joint>
<link name="cart"><inertial><mass value="3"/>
  <inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="continuous"><parent link="cart"/><child link="bob"/>
  <axis xyz="0 1 0"/></joint>
<link name="bob"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
  <inertia ixx="0" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""


def random_motion(n_joints, n_steps=5, seed=0):
    return np.random.default_rng(seed).normal(size=(3, n_steps, n_joints))


def test_efforts_are_those_of_the_cart_and_pendulum_in_closed_form():
    robot = Robot(CART, ["slide", "swing"])
    q, v, a = random_motion(2)
    m, cart, length, g = 2.0, 3.0, 0.5, 9.81
    sin, cos = np.sin(q[:, 1]), np.cos(q[:, 1])
    # Lagrange's equations of a cart with a bob at (x - l sin θ, -l cos θ).
    force = (cart + m) * a[:, 0] - m * length * (cos * a[:, 1] - sin * v[:, 1] ** 2)
    torque = m * length**2 * a[:, 1] - m * length * cos * a[:, 0] + m * g * length * sin
    np.testing.assert_allclose(
        robot.inverse_dynamics(q, v, a), np.column_stack([force, torque]), atol=1e-12
    )


DRIVES = {
    "shoulder1": {"armature": 0.3, "damping": 2.0, "friction": 0.7},
    "shoulder3": {"damping": 0.5},
    "elbow": {"armature": 0.1, "friction": 0.2},
}


def test_efforts_are_those_of_the_drives(tmp_path):
    file = tmp_path / "limits.yaml"
    file.write_text(f"joint_limits: {DRIVES}")
    q, v, a = random_motion(3)
    names = ("elbow", "shoulder1", "shoulder3")
    rigid = Robot.from_file(config_file("human_arm.urdf"), names)
    armature, damping, friction = (
        np.array([DRIVES[name].get(key, 0.0) for name in names])
        for key in ("armature", "damping", "friction")
    )
    expected = rigid.inverse_dynamics(q, v, a)
    expected += armature * a + damping * v + friction * np.tanh(v / 0.02)
    whole = Robot.from_file(config_file("human_arm.urdf"), JOINTS).with_drives(DRIVES)
    for robot in (rigid.with_drives(DRIVES), rigid.with_drives(file), whole.with_joints(names)):
        tau = robot.inverse_dynamics(q, v, a)
        np.testing.assert_allclose(tau, expected, atol=1e-12)
        for at in zip(q, v, tau, a, strict=True):
            np.testing.assert_allclose(robot.forward_dynamics(*at[:3]), at[3], atol=1e-8)


def test_damping_and_friction_come_from_the_description():
    stated = CART.replace('velocity="2" effort="30"/>', '{}<dynamics damping="3" friction="2"/>')
    stated = stated.format('velocity="2" effort="30"/>')
    q, v, a = random_motion(2)
    more = Robot(stated, ["slide", "swing"]).inverse_dynamics(q, v, a)
    more -= Robot(CART, ["slide", "swing"]).inverse_dynamics(q, v, a)
    drag = 3.0 * v[:, 0] + 2.0 * np.tanh(v[:, 0] / 0.02)
    np.testing.assert_allclose(more, np.column_stack([drag, 0.0 * drag]), atol=1e-12)
    for wrong in ('"-3"', '"high"'):
        with pytest.raises(RobotError, match="joint 'slide': 'damping' of <dynamics>.*expected"):
            Robot(stated.replace('damping="3"', f"damping={wrong}"))


@pytest.mark.parametrize("order", [JOINTS, tuple(reversed(JOINTS)), JOINTS[1:]])
@pytest.mark.parametrize("drives", [{}, DRIVES])
def test_derivatives_agree_with_central_differences_in_any_joint_order(order, drives):
    drives = {name: drives[name] for name in drives if name in order}
    robot = Robot.from_file(config_file("human_arm.urdf"), order).with_drives(drives)
    motion = random_motion(len(order))
    motion[1] *= 0.05  # where smoothed friction changes
    tau, dtau = robot.inverse_dynamics_derivatives(*motion)
    np.testing.assert_allclose(tau, robot.inverse_dynamics(*motion), atol=1e-12)
    step = 1e-6
    for k in range(3):
        for j in range(len(order)):
            ends = []
            for sign in (1.0, -1.0):
                moved = motion.copy()
                moved[k, :, j] += sign * step
                ends.append(robot.inverse_dynamics(*moved))
            difference = (ends[0] - ends[1]) / (2.0 * step)
            np.testing.assert_allclose(
                dtau[:, :, k * len(order) + j], difference, rtol=1e-6, atol=1e-7
            )


def test_joint_order_only_rearranges():
    forward, backward = (
        Robot.from_file(config_file("human_arm.urdf"), order) for order in (JOINTS, JOINTS[::-1])
    )
    q, v, a = random_motion(4)
    tau = forward.inverse_dynamics(q, v, a)
    np.testing.assert_allclose(
        backward.inverse_dynamics(q[:, ::-1], v[:, ::-1], a[:, ::-1])[:, ::-1], tau, atol=1e-12
    )
    np.testing.assert_allclose(
        backward.frame_positions(q[:, ::-1], ["wrist"]), forward.frame_positions(q, ["wrist"])
    )


def test_locked_joints_stay_where_they_are_locked():
    free = Robot(CART, ["slide", "swing"])
    locked = Robot(CART, ["swing"], locked={"slide": 0.25})
    q, v, a = random_motion(1)
    zero = np.zeros_like(q)
    expected = free.inverse_dynamics(*(np.hstack([zero, x]) for x in (q, v, a)))[:, 1:]
    np.testing.assert_allclose(locked.inverse_dynamics(q, v, a), expected, atol=1e-12)
    assert locked.frame_positions(q, ["cart"])[0, 0].tolist() == [0.25, 0.0, 0.0]


def test_a_locked_joint_that_is_not_mentioned_stands_as_near_to_zero_as_it_can():
    tip = Robot(CART, ["slide"]).frame_positions(np.zeros((1, 1)), ["tip"])
    np.testing.assert_allclose(tip[0, 0], [0.0, 0.0, 0.01])


def test_continuous_joints_are_angles_without_limits():
    robot = Robot(CART, ["slide", "swing"])
    assert robot.continuous.tolist() == [False, True]
    limits = robot.limits()
    assert (limits.lower[1], limits.upper[1], limits.velocity[1]) == (-np.inf, np.inf, np.inf)
    q = np.array([[0.0, 1.0], [0.0, 1.0 + 2.0 * np.pi]])
    tau = robot.inverse_dynamics(q, 0.0 * q, 0.0 * q)
    np.testing.assert_allclose(tau[0], tau[1], atol=1e-12)


def test_limits_come_from_the_urdf_and_can_be_overridden():
    robot = Robot(CART, ["slide"])
    limits = robot.limits({"slide": {"max_velocity": 0.5, "max_acceleration": 4.0}})
    found = [limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.effort]
    assert [x[0] for x in found] == [-1.0, 1.0, 0.5, 4.0, 30.0]


def test_a_limit_of_zero_in_the_urdf_is_refused_when_it_matters():
    robot = Robot(CART, ["finger"])
    with pytest.raises(LimitsError, match="max_effort of joint 'finger' is 0"):
        robot.limits()
    assert robot.limits({"finger": {"max_effort": 5.0}}).effort.tolist() == [5.0]


@pytest.mark.parametrize(
    ("joints", "message"),
    [
        (["slde"], "no movable joint is called 'slde'.*did you mean 'slide'.*'swing'"),
        (["slide", "slide"], "'slide' given more than once"),
        ([], "at least one"),
    ],
)
def test_wrong_joints_are_refused_with_the_valid_names(joints, message):
    with pytest.raises(RobotError, match=message):
        Robot(CART, joints)


@pytest.mark.parametrize(
    ("locked", "message"),
    [
        ({"slide": 0.0}, "'slide' can't be locked and move"),
        ({"wheel": 0.0}, "no movable joint is called 'wheel'"),
        ({"finger": np.nan}, "position of locked joint 'finger' is nan"),
    ],
)
def test_wrong_locks_are_refused(locked, message):
    with pytest.raises(RobotError, match=message):
        Robot(CART, ["slide", "swing"], locked=locked)


@pytest.mark.parametrize(
    ("urdf", "message"),
    [
        ("", "not XML"),
        ("<robot", "not XML"),
        ("<sdf/>", "root element is <sdf>"),
        ('<robot name="r"><link name="l"/></robot>', "no revolute, continuous or prismatic"),
        (
            CART.replace('child link="bob"', 'child link="nothing"'),
            "child link 'nothing' of joint 'swing' not found",
        ),
        (
            CART.replace('velocity="2"', 'velocity="fast"'),
            r"(?=.*joint 'slide')(?=.*velocity value \(fast\) is not a valid float)",
        ),
        (CART.replace('value="3"', 'value="${mass}"'), "xacro"),
        (
            CART.replace("<robot", '<robot xmlns:x="http://www.ros.org/wiki/xacro"').replace(
                "</robot>", "<x:include/></robot>"
            ),
            "xacro",
        ),
    ],
)
def test_a_broken_description_is_refused_in_a_sentence(urdf, message):
    with pytest.raises(RobotError, match=message):
        Robot(urdf)


def test_what_xacro_leaves_in_comments_is_no_xacro():
    left = '<!-- <xacro:arm mass="${mass}"/> -->'
    expanded = CART.replace("</robot>", f'{left}<gazebo reference="bob">{left}</gazebo></robot>')
    assert Robot(expanded).joint_names == Robot(CART).joint_names


def test_joints_that_mimic_others_move_only_if_asked_for():
    mimic = CART.replace('effort="30"/>', 'effort="30"/><mimic joint="finger"/>')
    assert Robot(mimic).joint_names == ("finger", "swing")
    assert Robot(mimic).movable_joints == Robot(CART).movable_joints
    assert Robot(mimic, ["slide"]).joint_names == ("slide",)


@pytest.mark.parametrize("followed", ["slide", "finger"])
def test_joints_that_mimic_each_other_end_no_search(followed):
    mimic = CART.replace('effort="30"/>', f'effort="30"/><mimic joint="{followed}"/>')
    mimic = mimic.replace('effort="0"/>', 'effort="0"/><mimic joint="slide"/>')
    robot = Robot(mimic, ["swing"])
    assert robot.mimicking_joints == {}


@pytest.mark.parametrize("order", [JOINTS, JOINTS[::-1], JOINTS[1:]])
def test_points_on_links_move_as_central_differences_say(order):
    robot = Robot.from_file(config_file("human_arm.urdf"), order)
    links = ["chest", "upper_arm", "wrist"]
    points = robot.attach_points(links, np.array([[0.1, 0, 0], [0, 0.2, -0.1], [0, 0, 0]]))
    q, step = random_motion(len(order))[0], 1e-6
    positions, jacobians = points.positions_and_jacobians(q)
    np.testing.assert_allclose(positions[:, 2], robot.frame_positions(q, ["wrist"])[:, 0])
    np.testing.assert_allclose(positions[:, 0], np.tile([0.1, 0.0, 0.0], (len(q), 1)))
    for j in range(len(order)):
        moved = step * np.eye(len(order))[j]
        forward, backward = (points.positions_and_jacobians(q + s * moved)[0] for s in (1, -1))
        difference = (forward - backward) / (2.0 * step)
        np.testing.assert_allclose(jacobians[..., j], difference, atol=1e-9)


def test_a_pose_error_is_zero_at_the_pose_and_has_the_derivative_of_central_differences():
    robot = arm_robot()
    q = np.array([0.3, -0.2, 0.5, -1.1])
    hand = robot.frame_names[-1]
    position = np.array([0.1, 0.3, 0.2])
    orientation = np.array([0.1, -0.5, 0.2, 0.8]) / np.linalg.norm([0.1, -0.5, 0.2, 0.8])
    error, jacobian = robot.pose_error(hand, q, position, orientation)
    place = robot.frame_positions(q[None], [hand])[0, 0]
    np.testing.assert_allclose(error[:3], place - position, atol=1e-12)
    step = 1e-6
    for j, e in enumerate(np.eye(4)):
        ends = [robot.pose_error(hand, q + s * e, position, orientation)[0] for s in (step, -step)]
        np.testing.assert_allclose(jacobian[:, j], (ends[0] - ends[1]) / (2 * step), atol=1e-8)
    alone, rows = robot.pose_error(hand, q, place)
    np.testing.assert_allclose(alone, 0.0, atol=1e-15)
    np.testing.assert_array_equal(rows, jacobian[:3])


def test_a_description_can_neither_fill_the_memory_nor_read_files(tmp_path):
    laughs = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10}">' for k in range(1, 10))
    bomb = f'<!DOCTYPE robot [<!ENTITY e0 "ha">{laughs}]>' + CART.replace("cart", "&e9;", 1)
    with pytest.raises(RobotError, match="amplification"):
        Robot(bomb)
    secret = tmp_path / "secret.txt"
    secret.write_text("<joint/>")
    thief = f'<!DOCTYPE robot [<!ENTITY e SYSTEM "{secret.as_uri()}">]>'
    with pytest.raises(RobotError, match="undefined entity"):
        Robot(thief + CART.replace("</robot>", "&e;</robot>"))


def test_end_effector_is_the_last_link_that_most_joints_move():
    assert arm_robot().end_effector == "wrist"
    urdf = config_file("human_arm.urdf").read_text(encoding="utf-8")
    wheel = """<link name="wheel"/><joint name="z" type="fixed"><parent link="chest"/>
        <child link="wheel"/></joint></robot>"""
    robot = Robot(urdf.replace("</robot>", wheel))
    assert (robot.frame_names[-1], robot.end_effector) == ("wheel", "wrist")
    assert Robot(urdf, ["shoulder1"]).end_effector == "wrist"
