# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Running motions that are led to another goal, against closed forms and dense checks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import simpson
from support.arm import JOINTS, arm_robot
from support.arm_plans import planned
from support.dense import assert_keeps, minimum_jerk_motion, spline

from mp_pca_planner.execution.link import RunningMotion
from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.planning import displaced
from mp_pca_planner.motion.goal import JointState

ROBOT = arm_robot()
LIMITS = ROBOT.limits(
    {name: {"max_velocity": 2.0, "max_acceleration": 8.0, "max_jerk": 120.0} for name in JOINTS}
)
START, SHIFT = np.array([-1.0, 0.2, 0.0, -1.6]), np.array([0.6, -0.4, 0.5, 0.7])
DURATION, PERIOD, PLACE = 1.5, 0.01, 0.55
MOTION = PublishedMotion(minimum_jerk_motion(JOINTS, START, START + SHIFT, DURATION), 0.0)
OLD = spline(MOTION.trajectory)
CHANGE = np.array([0.05, -0.1, 0.08, 0.02])


def adapt(change, place=PLACE, limits=LIMITS):
    goal = JointState(JOINTS, START + SHIFT + change)
    return displaced(running(MOTION.trajectory, place), goal, ROBOT, limits, PERIOD)


def running(trajectory, place):
    """A motion that was planned for the same duration."""
    return RunningMotion(planned(trajectory, DURATION), place, False)


def test_displacement_is_the_minimum_jerk_polynomial_to_the_change_of_the_goal():
    trajectory, _ = adapt(CHANGE)
    s = np.linspace(0.0, 1.0, 801)
    expected = np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, CHANGE)
    times = s * trajectory.duration
    assert trajectory.duration == pytest.approx(DURATION - PLACE)
    np.testing.assert_allclose(spline(trajectory)(times) - OLD(PLACE + times), expected, atol=1e-8)


@given(
    st.lists(st.floats(-0.4, 0.4), min_size=4, max_size=4).map(np.array),
    st.floats(0.01, DURATION - 0.01),
)
def test_displaced_motion_starts_on_the_old_one_ends_at_the_goal_and_keeps_the_limits(
    change, place
):
    found = adapt(change, place)
    assert found is not None
    trajectory, check = found
    curve = spline(trajectory)
    for order in range(3):
        np.testing.assert_allclose(curve(0.0, order), OLD(place, order), atol=1e-9)
    np.testing.assert_array_equal(trajectory.positions[-1], START + SHIFT + change)
    assert not trajectory.velocities[-1].any() and not trajectory.accelerations[-1].any()
    assert trajectory.duration >= DURATION - place - 1e-12
    assert not check.violations
    assert_keeps(curve, LIMITS)


def test_motion_that_was_displaced_often_is_bounded_by_the_planned_one():
    slow = RunningMotion(
        planned(minimum_jerk_motion(JOINTS, START, START + SHIFT, 6.0), 1.0), 0.5, False
    )
    goal = JointState(JOINTS, START + SHIFT + 0.01)
    assert displaced(slow, goal, ROBOT, LIMITS, PERIOD) is None


def test_goal_that_no_displacement_reaches_within_the_limits_gets_none():
    assert adapt(LIMITS.upper + 0.1 - START - SHIFT) is None


def test_goal_may_have_a_velocity():
    v = np.array([0.1, 0.0, -0.1, 0.2])
    goal = JointState(JOINTS, START + SHIFT, v)
    trajectory, _ = displaced(running(MOTION.trajectory, PLACE), goal, ROBOT, LIMITS, PERIOD)
    np.testing.assert_array_equal(trajectory.velocities[-1], v)
    assert_keeps(spline(trajectory), LIMITS)


def test_efforts_are_those_of_the_motion_and_their_cost_is_its_integral():
    trajectory, _ = adapt(CHANGE)
    states = zip(trajectory.positions, trajectory.velocities, trajectory.accelerations, strict=True)
    efforts = [M @ a + h for q, v, a in states for M, h in [ROBOT.motion_equation(q, v)]]
    np.testing.assert_allclose(trajectory.efforts, efforts, atol=1e-9)
    integral = simpson(np.square(efforts).sum(axis=1), x=trajectory.times)
    assert trajectory.effort_cost == pytest.approx(0.5 * integral, rel=1e-4)
