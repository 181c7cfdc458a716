# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The robot model: chosen joints, dynamics and kinematics."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_robot

from mp_pca_planner.exceptions import LimitsError, RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.robot.locked import mimicking_joints
from mp_pca_planner.robot.model import Robot

# A pendulum of 2 kg at 0.5 m on a continuous joint, on a cart that slides along x, with a
# gripper finger that is of no interest here.
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


def shipped_arm(joints):
    return Robot.from_file(config_file("human_arm.urdf"), joints)


def slope(function, x, step=1e-6):
    """Central differences of a function by each of the last components of x, on a new last axis."""
    moves = step * np.eye(x.shape[-1])
    return np.stack([(function(x + e) - function(x - e)) / (2.0 * step) for e in moves], axis=-1)


def test_efforts_are_those_of_the_cart_and_pendulum_in_closed_form():
    stated = CART.replace('effort="30"/>', 'effort="30"/><dynamics damping="3" friction="2"/>')
    q, v, a = random_motion(2)
    m, cart, length, g = 2.0, 3.0, 0.5, 9.81
    sin, cos = np.sin(q[:, 1]), np.cos(q[:, 1])
    # Lagrange's equations of a cart with a bob at (x - l sin θ, -l cos θ).
    force = (cart + m) * a[:, 0] - m * length * (cos * a[:, 1] - sin * v[:, 1] ** 2)
    torque = m * length**2 * a[:, 1] - m * length * cos * a[:, 0] + m * g * length * sin
    drag = 3.0 * v[:, 0] + 2.0 * np.tanh(v[:, 0] / 0.02)
    for urdf, more in ((CART, 0.0), (stated, drag)):
        tau = Robot(urdf, ["slide", "swing"]).inverse_dynamics(q, v, a)
        np.testing.assert_allclose(tau, np.column_stack([force + more, torque]), atol=1e-12)
    for wrong in ('"-3"', '"high"'):
        with pytest.raises(RobotError, match="joint 'slide': 'damping' of <dynamics>.*expected"):
            Robot(stated.replace('damping="3"', f"damping={wrong}"))


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
    rigid = shipped_arm(names)
    armature, damping, friction = (
        np.array([DRIVES[name].get(key, 0.0) for name in names])
        for key in ("armature", "damping", "friction")
    )
    expected = rigid.inverse_dynamics(q, v, a)
    expected += armature * a + damping * v + friction * np.tanh(v / 0.02)
    whole = shipped_arm(JOINTS).with_drives(DRIVES)
    for robot in (rigid.with_drives(DRIVES), rigid.with_drives(file), whole.with_joints(names)):
        tau = robot.inverse_dynamics(q, v, a)
        np.testing.assert_allclose(tau, expected, atol=1e-12)
        for at in zip(q, v, tau, a, strict=True):
            np.testing.assert_allclose(robot.forward_dynamics(*at[:3]), at[3], atol=1e-8)


@pytest.mark.parametrize("order", [JOINTS, JOINTS[::-1], JOINTS[1:]])
@pytest.mark.parametrize("drives", [{}, DRIVES])
def test_derivatives_are_those_of_differences_in_any_joint_order(order, drives):
    drives = {name: drives[name] for name in drives if name in order}
    robot, n = shipped_arm(order).with_drives(drives), len(order)
    motion = random_motion(n)
    motion[1] *= 0.05  # where smoothed friction changes
    tau, dtau = robot.inverse_dynamics_derivatives(*motion)
    np.testing.assert_allclose(tau, robot.inverse_dynamics(*motion), atol=1e-12)
    for k in range(3):
        by_one = slope(
            lambda x, k=k: robot.inverse_dynamics(*motion[:k], x, *motion[k + 1 :]), motion[k]
        )
        found = dtau[:, :, k * n : (k + 1) * n]
        np.testing.assert_allclose(found, by_one, rtol=1e-6, atol=1e-7)
    # The order of joints only rearranges.
    usual = shipped_arm([name for name in JOINTS if name in order]).with_drives(drives)
    moved = [usual.joint_names.index(name) for name in order]
    expected = usual.inverse_dynamics(*motion[:, :, np.argsort(moved)])[:, moved]
    np.testing.assert_allclose(tau, expected, atol=1e-12)


@pytest.mark.parametrize("order", [JOINTS, JOINTS[::-1], JOINTS[1:]])
def test_points_and_poses_of_links_move_as_differences_say(order):
    robot = shipped_arm(order)
    points = robot.attach_points(
        ["chest", "upper_arm", "wrist"], np.array([[0.1, 0, 0], [0, 0.2, -0.1], [0, 0, 0]])
    )
    q = random_motion(len(order))[0]
    positions, jacobians = points.positions_and_jacobians(q)
    np.testing.assert_allclose(positions[:, 2], robot.frame_positions(q, ["wrist"])[:, 0])
    np.testing.assert_allclose(positions[:, 0], np.tile([0.1, 0.0, 0.0], (len(q), 1)))
    by_one = slope(lambda x: points.positions_and_jacobians(x)[0], q)
    np.testing.assert_allclose(jacobians, by_one, atol=1e-9)
    position, orientation = np.array([0.1, 0.3, 0.2]), np.array([0.1, -0.5, 0.2, 0.8])
    pose = position, orientation / np.linalg.norm(orientation)
    error, jacobian = robot.pose_error("wrist", q[0], *pose)
    np.testing.assert_allclose(error[:3], positions[0, 2] - position, atol=1e-12)
    by_one = slope(lambda x: robot.pose_error("wrist", x, *pose)[0], q[0])
    np.testing.assert_allclose(jacobian, by_one, atol=1e-8)
    alone, rows = robot.pose_error("wrist", q[0], positions[0, 2])
    np.testing.assert_allclose(alone, 0.0, atol=1e-15)
    np.testing.assert_array_equal(rows, jacobian[:3])


def test_continuous_joints_are_angles_without_limits():
    robot = Robot(CART, ["slide", "swing"])
    assert robot.continuous.tolist() == [False, True]
    limits = robot.limits({"slide": {"max_velocity": 0.5, "max_acceleration": 4.0}})
    found = [limits.lower, limits.upper, limits.velocity, limits.acceleration, limits.effort]
    assert [x[0] for x in found] == [-1.0, 1.0, 0.5, 4.0, 30.0]
    assert [x[1] for x in found] == [-np.inf, *4 * [np.inf]]
    q = np.array([[0.0, 1.0], [0.0, 1.0 + 2.0 * np.pi]])
    tau = robot.inverse_dynamics(q, 0.0 * q, 0.0 * q)
    np.testing.assert_allclose(tau[0], tau[1], atol=1e-12)


def test_a_limit_of_zero_in_the_urdf_is_rejected_when_it_matters():
    robot = Robot(CART, ["finger"])
    with pytest.raises(LimitsError, match="max_effort of joint 'finger' is 0"):
        robot.limits()
    assert robot.limits({"finger": {"max_effort": 5.0}}).effort.tolist() == [5.0]
    others = robot.with_drives({"slide": {"armature": 0.1}}).with_joints(["slide", "swing"])
    assert others.armature.tolist() == [0.1, 0.0]
    assert others.locked_at({"finger": 0.02}).limits().effort.tolist() == [30.0, np.inf]


def test_limits_of_rates_in_the_urdf_hold():
    # urdfdom reads them in URDF 1.2.
    more = 'velocity="2" acceleration="4" deceleration="3" jerk="50"'
    limits = Robot(CART.replace('velocity="2"', more), ["slide"]).limits()
    assert (limits.acceleration.tolist(), limits.jerk.tolist()) == ([3.0], [50.0])


@pytest.mark.parametrize(
    ("joints", "locked", "message"),
    [
        (["slde"], {}, "no movable joint is called 'slde'.*did you mean 'slide'.*'swing'"),
        (["slide"], {"slide": 0.0}, "'slide' can't be locked and move"),
        (["slide"], {"wheel": 0.0}, "no movable joint is called 'wheel'"),
        (["slide"], {"finger": np.nan}, "position of locked joint 'finger' is nan"),
    ],
)
def test_wrong_joints_are_rejected_with_the_valid_names(joints, locked, message):
    with pytest.raises(RobotError, match=message):
        Robot(CART, joints, locked=locked)


def test_joints_that_mimic_others_move_only_if_asked_for():
    def mimicking(slide="", finger=""):
        urdf = CART.replace('effort="30"/>', f'effort="30"/><mimic joint="{slide}"/>')
        return urdf.replace('effort="0"/>', f'effort="0"/><mimic joint="{finger}"/>')

    robot = Robot(mimicking("finger"))
    assert robot.joint_names == ("finger", "swing")
    assert robot.movable_joints == Robot(CART).movable_joints
    assert mimicking_joints(robot) == {"slide": "finger"}
    assert mimicking_joints(Robot(mimicking("finger"), ["slide"])) == {}
    for circle in (mimicking("slide", "slide"), mimicking("finger", "slide")):
        assert mimicking_joints(Robot(circle, ["swing"])) == {}


def test_end_effector_is_the_last_link_that_most_joints_move():
    urdf = config_file("human_arm.urdf").read_text(encoding="utf-8")
    wheel = """<link name="wheel"/><joint name="z" type="fixed"><parent link="chest"/>
        <child link="wheel"/></joint></robot>"""
    robot = Robot(urdf.replace("</robot>", wheel))
    assert (robot.frame_names[-1], robot.end_effector) == ("wheel", "wrist")
    assert arm_robot().end_effector == Robot(urdf, ["shoulder1"]).end_effector == "wrist"


def test_the_name_of_an_example_is_no_file_but_says_how_to_get_one():
    with pytest.raises(RobotError, match="`mp-pca demo so101 --files` writes that of the example"):
        Robot.from_file("so101")
