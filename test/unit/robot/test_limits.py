# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits from URDFs, files and parameters."""

import numpy as np
import pytest
from support.arm import arm_robot

from mp_pca_planner.exceptions import LimitsError
from mp_pca_planner.robot.limits import JointLimits, given_limits, limits_file_note, merge_limits

NAMES = ("a", "b")


def write(path, text):
    path.write_text(text)
    return path


def test_what_is_not_said_is_not_limited():
    limits = JointLimits(NAMES, {"a": {"max_velocity": 2.0}})
    assert limits.velocity.tolist() == [2.0, np.inf]
    assert np.isinf([limits.lower, limits.upper, limits.jerk, limits.effort]).all()


def test_later_layers_win_key_by_key():
    urdf = {"a": {"max_velocity": 1.0, "max_effort": 5.0}}
    merged = merge_limits(urdf, {"a": {"max_velocity": 0.5}}, {"b": {"max_jerk": 9.0}})
    assert merged == {"a": {"max_velocity": 0.5, "max_effort": 5.0}, "b": {"max_jerk": 9.0}}
    assert urdf == {"a": {"max_velocity": 1.0, "max_effort": 5.0}}


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan])
def test_a_magnitude_that_is_not_positive_is_refused_by_joint(value):
    with pytest.raises(LimitsError, match="max_effort of joint 'b'.*positive"):
        JointLimits(NAMES, {"b": {"max_effort": value}})


def test_an_empty_range_is_refused():
    with pytest.raises(LimitsError, match="'a' range from 1 to 1"):
        JointLimits(NAMES, {"a": {"min_position": 1.0, "max_position": 1.0}})


@pytest.mark.parametrize(
    "text",
    [
        # moveit/moveit2#2198
        "/**:\n  ros__parameters:\n    robot_description_planning:\n      joint_limits:\n"
        "        default_velocity_scaling_factor: 0.1\n"
        "        a: {has_velocity_limits: true, max_velocity: 2.0}\n",
        # moveit/moveit#2451
        "joint_limits:\n  default_velocity_scaling_factor: 0.1\n"
        "  a: {has_velocity_limits: true, max_velocity: 2.0}\n",
    ],
)
def test_limits_are_read_as_users_of_moveit_write_them(tmp_path, text):
    path = write(tmp_path / "joint_limits.yaml", text)
    assert given_limits(path, NAMES) == {"a": {"max_velocity": 2.0}}
    assert "default_velocity_scaling_factor 0.1 are not applied" in limits_file_note(path)


def test_a_moveit_file_is_read_with_its_switches(tmp_path):
    path = write(
        tmp_path / "joint_limits.yaml",
        "joint_limits:\n"
        "  a: {has_velocity_limits: true, max_velocity: 2, has_acceleration_limits: false,\n"
        "      max_acceleration: 3.0, max_effort: 40.5}\n"
        # The Setup Assistant of MoveIt writes 0 where there is no limit.
        "  b: {has_position_limits: false, has_acceleration_limits: false, max_acceleration: 0}\n",
    )
    limits = JointLimits(
        NAMES, merge_limits({"b": {"min_position": 0.0}}, given_limits(path, NAMES))
    )
    assert limits.velocity.tolist() == [2.0, np.inf]
    assert limits.acceleration.tolist() == [np.inf, np.inf]
    assert limits.effort.tolist() == [40.5, np.inf]
    assert limits.lower.tolist() == [-np.inf, -np.inf]
    assert limits.unlimited == ("velocity", "acceleration", "jerk")


def test_a_file_with_degrees_and_keys_of_pilz_is_read(tmp_path):
    path = write(
        tmp_path / "limits.yaml",
        "joint_limits:\n  1: {max_velocity: !degrees 90, max_acceleration: 4.0,\n"
        "      has_deceleration_limits: true, max_deceleration: -3.0, k_position: 20}\n"
        "  b: {max_position: !radians 1.5, has_acceleration_limits: false}\n",
    )
    found = given_limits(path, ("1", "b"))
    assert found["1"] == {"max_velocity": pytest.approx(np.pi / 2), "max_acceleration": 3.0}
    assert found["b"] == {"max_position": 1.5, "max_acceleration": np.inf}
    assert "'k_position' are ignored" in limits_file_note(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "mapping 'joint_limits'"),
        ("joint_limits: [1]", "mapping 'joint_limits'"),
        ("joint_limits: {c: {max_velocity: 1}}", "no joint is called 'c'.*'a', 'b'"),
        ("joint_limits: {a: 3}", "joint 'a' must be a mapping"),
        ("joint_limits: {a: {damping: -1}}", "damping of joint 'a' must be a number from 0"),
        ("joint_limits: {a: {max_velocty: 1}}", "did you mean 'max_velocity'"),
        ("joint_limits: {a: {max_velocity: fast}}", "'fast', not a number"),
        ("joint_limits: {a: {max_velocity: true}}", "not a number"),
        ("joint_limits: {a: {max_velocity: -1}}", "must be a positive number"),
        ("joint_limits: {a: {max_velocity: .nan}}", "must be a positive number"),
        ("joint_limits: {a: {max_jerk: 1.0e-300}}", "must be a positive number from 1e-09 on"),
        ("joint_limits: {a: {has_velocity_limits: 1}}", "true or false"),
        ("joint_limits: {a: [", "can't be read"),
        ("joint_limits: " + "[" * 100_000, "nest"),
        ("joint_limits: {a: &x {max_velocity: 1}, b: *x}", "aliases of YAML"),
        ("joint_limits: !!python/object/apply:os.getcwd []", "can't be read"),
    ],
)
def test_a_faulty_file_is_refused_with_its_name_and_the_reason(tmp_path, text, message):
    path = write(tmp_path / "limits.yaml", text)
    with pytest.raises(LimitsError, match=rf"limits\.yaml.*{message}"):
        given_limits(path, NAMES)


def test_joints_of_limits_are_renamed(tmp_path):
    path = write(tmp_path / "limits.yaml", "joint_limits: {left_elbow_joint: {max_velocity: 1.5}}")
    robot = arm_robot()
    rename = {"left_*_joint": "*"}
    assert robot.limits(path, rename=rename).velocity[-1] == 1.5
    with pytest.raises(
        LimitsError, match="no joint is called 'left_elbow_joint'.*--rename OLD=NEW"
    ):
        robot.limits(path)


def test_limits_of_a_robot_come_from_a_mapping_or_a_file(tmp_path):
    path = tmp_path / "joint_limits.yaml"
    path.write_text("joint_limits: {elbow: {max_velocity: 1.5, has_jerk_limits: false}}")
    for given in (path, str(path), {"elbow": {"max_velocity": np.float64(1.5)}}):
        assert arm_robot().limits(given).velocity[-1] == 1.5
