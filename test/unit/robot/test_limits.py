# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Joint limits from URDFs, files and parameters."""

import numpy as np
import pytest

from mp_pca_planner.exceptions import LimitsError
from mp_pca_planner.robot.limits import JointLimits, given_limits, limits_file_note, merge_limits

NAMES = ("a", "b")


@pytest.fixture
def write(tmp_path):
    def write(text):
        (tmp_path / "limits.yaml").write_text(text)
        return tmp_path / "limits.yaml"

    return write


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"b": {"max_effort": 0.0}}, "max_effort of joint 'b'.*positive"),
        ({"a": {"min_position": 1.0, "max_position": 1.0}}, "'a' range from 1 to 1.*limits file"),
    ],
)
def test_bad_limits_are_rejected_by_joint(limits, message):
    with pytest.raises(LimitsError, match=message):
        JointLimits(NAMES, limits)


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
def test_limits_are_read_as_users_of_moveit_write_them(write, text):
    path = write(text)
    assert given_limits(path, NAMES) == {"a": {"max_velocity": 2.0}}
    assert "default_velocity_scaling_factor 0.1 are not applied" in limits_file_note(path)


def test_a_file_replaces_limits_key_by_key_and_switches_them_off(write):
    path = write(
        "joint_limits:\n"
        "  a: {has_velocity_limits: true, max_velocity: 2, has_acceleration_limits: false,\n"
        "      max_acceleration: 3.0, max_effort: 40.5}\n"
        # The Setup Assistant of MoveIt writes 0 where there is no limit.
        "  b: {has_position_limits: false, has_acceleration_limits: false, max_acceleration: 0}\n",
    )
    stated = {"a": {"max_velocity": 1.0, "max_jerk": 9.0}, "b": {"min_position": 0.0}}
    limits = JointLimits(NAMES, merge_limits(stated, given_limits(path, NAMES)))
    assert limits.velocity.tolist() == [2.0, np.inf]
    assert limits.acceleration.tolist() == [np.inf, np.inf]
    assert limits.jerk.tolist() == [9.0, np.inf]
    assert limits.effort.tolist() == [40.5, np.inf]
    assert limits.lower.tolist() == [-np.inf, -np.inf]
    whose = "some joints have no limit of velocity or jerk, no joint has a limit of acceleration"
    assert limits.unlimited == whose
    assert stated["a"]["max_velocity"] == 1.0


def test_a_file_with_degrees_and_keys_of_pilz_is_read(write):
    path = write(
        "joint_limits:\n  1: {max_velocity: !degrees 90, max_acceleration: 4.0,\n"
        "      has_deceleration_limits: true, max_deceleration: -3.0, k_position: 20}\n"
        "  b: {max_position: !radians 1.5, has_acceleration_limits: false}\n"
        "  c: {max_acceleration: 2.0, max_deceleration: -3.0}\n",
    )
    found = given_limits(path, ("1", "b", "c"))
    assert found["1"] == {"max_velocity": pytest.approx(np.pi / 2), "max_acceleration": 3.0}
    assert found["b"] == {"max_position": 1.5, "max_acceleration": np.inf}
    assert found["c"] == {"max_acceleration": 2.0}
    assert "'k_position' are ignored" in limits_file_note(path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("joint_limits: [1]", "mapping 'joint_limits'"),
        ("joint_limits: {c: {max_velocity: 1}}", "no joint is called 'c'.*'a', 'b'"),
        ("joint_limits: {a: {damping: -1}}", "damping of joint 'a' must be a number from 0"),
        ("joint_limits: {a: {max_velocty: 1}}", "did you mean 'max_velocity'"),
        ("joint_limits: {a: {max_velocity: true}}", "not a number"),
        ("joint_limits: {a: [", r"can't be read: it is not YAML \(line 2: "),
        ("joint_limits: {a: &x {max_velocity: 1}, b: *x}", "aliases of YAML"),
    ],
)
def test_a_faulty_file_is_rejected_with_its_name_and_the_reason(write, text, message):
    with pytest.raises(LimitsError, match=rf"limits\.yaml.*{message}"):
        given_limits(write(text), NAMES)
