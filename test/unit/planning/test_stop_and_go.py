# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions without optimisation: time scaling by closed forms, brakes, and rests between."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arm import JOINTS, arm_robot
from support.dense import minimum_jerk_motion

from mp_pca_planner.exceptions import TrajectoryError
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.motion.validation import Violation, check_limits
from mp_pca_planner.planning.search.stop_and_go import StopAndGo, stop_and_go
from mp_pca_planner.planning.time_scaling import (
    least_duration,
    least_stretch,
    slowdown,
)
from mp_pca_planner.robot.limits import JointLimits

STEP = 0.01
INSIDE = arm_robot().limits()
shares = st.lists(st.floats(0.1, 0.9), min_size=4, max_size=4).map(np.array)
signed = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)


def limits_of(**values: float) -> JointLimits:
    """The limits of the arm's positions, and these of every joint."""
    free = {"max_velocity": np.inf, "max_effort": np.inf}
    return arm_robot().limits(dict.fromkeys(JOINTS, free | values))


def configuration(share: np.ndarray) -> np.ndarray:
    return INSIDE.lower + share * (INSIDE.upper - INSIDE.lower)


def minimum_jerk(start, goal, duration: float, n: int = 401) -> Trajectory:
    return minimum_jerk_motion(JOINTS, start, goal, duration, n)


def jerks_of(knots: np.ndarray) -> np.ndarray:
    return np.diff(knots[2], axis=0) / STEP


@given(shares, shares, st.sampled_from(["max_velocity", "max_acceleration", "max_jerk"]))
def test_least_duration_takes_the_whole_of_a_kinematic_limit_and_no_more(first, second, quantity):
    start, goal = configuration(first), configuration(second)
    limits = limits_of(**{quantity: 0.7})
    duration = least_duration(arm_robot(), limits, start, goal)
    if duration < 1e-3:
        return
    exact = check_limits(minimum_jerk(start, goal, duration), arm_robot(), limits)
    assert exact.worst_excess < 1e-5  # rounding of jerks
    hasty = check_limits(minimum_jerk(start, goal, 0.99 * duration), arm_robot(), limits)
    order = ("max_velocity", "max_acceleration", "max_jerk").index(quantity) + 1
    assert hasty.worst_excess == pytest.approx(0.99**-order - 1.0, abs=1e-3)


@given(shares, shares, st.floats(0.2, 5.0), st.floats(1.0, 3.0))
def test_stretch_holds_for_efforts_with_damping_and_friction(first, second, duration, longer):
    drive = {"armature": 0.05, "damping": 2.0, "friction": 0.5}
    robot = arm_robot().with_drives(dict.fromkeys(JOINTS, drive))
    start, goal = configuration(first), configuration(second)
    motion, limits = minimum_jerk(start, goal, duration), limits_of(max_effort=20.0)
    states = np.array([*motion.states, np.zeros_like(motion.positions)])
    stretch = least_stretch(robot, limits, states)
    if 0.0 < stretch < np.inf:
        slow = minimum_jerk(start, goal, longer * stretch * duration)
        assert np.abs(robot.inverse_dynamics(*slow.states)).max() <= 20.0 * (1.0 + 1e-9)


@given(shares, signed, signed)
def test_brake_ends_at_rest_within_limits_of_acceleration_and_jerk(share, v, a):
    bounds = {"max_velocity": 2.0, "max_acceleration": 4.0, "max_jerk": 80.0}
    limits = replace_positions(limits_of(**bounds))
    # As fast as the limit of velocity allows a joint that accelerates and brakes in whole steps.
    a = 4.0 * a
    fastest = 2.0 - a**2 / 140.0 - STEP * np.abs(a)
    v = np.clip(2.0 * v, -fastest, fastest)
    start = JointState(JOINTS, configuration(share), v, a)
    motion = stop_and_go(arm_robot(), limits, [start, JointState(JOINTS, np.zeros(4))], STEP)
    q, speed, acceleration = motion.brake
    np.testing.assert_array_equal([speed[0], acceleration[0]], [v, a])
    assert not speed[-1].any() and not acceleration[-1].any()
    tolerance = 1.0 + 1e-6
    assert np.abs(jerks_of(motion.brake)).max(initial=0.0) <= 80.0 * tolerance
    assert np.abs(acceleration).max() <= 4.0 * tolerance
    assert np.abs(speed).max() <= 2.0 * tolerance
    # Constant jerks: sums of Taylor's series give the velocities and positions.
    jerk = jerks_of(motion.brake)
    rises = STEP * acceleration[:-1] + STEP**2 / 2.0 * jerk
    np.testing.assert_allclose(np.diff(speed, axis=0), rises, atol=1e-9)
    ways = STEP * speed[:-1] + STEP**2 / 2.0 * acceleration[:-1] + STEP**3 / 6.0 * jerk
    np.testing.assert_allclose(np.diff(q, axis=0), ways, atol=1e-9)


def replace_positions(limits: JointLimits) -> JointLimits:
    """The same without limits of position."""
    values = {
        name: {
            "max_velocity": float(limits.velocity[j]),
            "max_acceleration": float(limits.acceleration[j]),
            "max_jerk": float(limits.jerk[j]),
        }
        for j, name in enumerate(JOINTS)
    }
    return JointLimits(JOINTS, values)


def test_brake_is_as_fast_as_the_closed_form_says_but_for_whole_steps():
    bounds = {"max_velocity": 2.0, "max_acceleration": 4.0, "max_jerk": 80.0}
    limits = replace_positions(limits_of(**bounds))
    start = JointState(JOINTS, np.zeros(4), [1.5, -0.3, 0.0, 0.0], [0.0, 0.0, 0.0, 2.0])
    motion = stop_and_go(arm_robot(), limits, [start, JointState(JOINTS, np.ones(4))], STEP)
    # A trapezoid of acceleration, a triangle, nothing, and a triangle after the first ramp.
    ends = [1.5 / 4.0 + 4.0 / 80.0, 2.0 * np.sqrt(0.3 / 80.0), 0.0, (2 + 2**1.5) / 80.0]
    for j, end in enumerate(ends):
        moving = np.flatnonzero(motion.brake[1:, :, j].any(axis=0))
        steps = moving[-1] + 1 if moving.size else 0
        assert end / STEP - 1e-9 <= steps <= end / STEP + 3.0


def through(*, moving: bool) -> StopAndGo:
    limits = limits_of(max_velocity=2.0, max_acceleration=4.0, max_jerk=80.0)
    places = [configuration(np.full(4, share)) for share in (0.3, 0.5, 0.4, 0.7)]
    rate = np.full(4, 0.2) if moving else np.zeros(4)
    states = [
        JointState(JOINTS, places[0], rate, -rate),
        *(JointState(JOINTS, q) for q in places[1:-1]),
        JointState(JOINTS, places[-1], rate, rate),
    ]
    return stop_and_go(arm_robot(), limits, states, STEP)


@pytest.mark.parametrize("moving", [False, True])
def test_motion_rests_at_each_place_and_its_segments_are_the_same(moving):
    route = through(moving=moving)
    durations = 1.1 * route.durations
    (whole,) = route.motions(durations, [len(durations)])
    segments = route.motions(durations, [1] * len(durations))
    ends = np.cumsum(durations)
    q, v, a = whole.evaluate(ends[:-1])
    np.testing.assert_allclose(q, route.places[1:-1], atol=1e-9)
    assert max(np.abs(v).max(), np.abs(a).max()) < 1e-9
    for end, segment in zip(ends, segments, strict=True):
        times = np.linspace(0.0, segment.duration, 50)
        for x, y in zip(
            whole.evaluate(end - segment.duration + times), segment.evaluate(times), strict=True
        ):
            np.testing.assert_allclose(x, y, atol=1e-8)
    for moment, state in ((0.0, route.start), (whole.duration, route.goal)):
        values = [x[0] for x in whole.evaluate(np.array([moment]))]
        expected = (state.positions, state.velocities, state.accelerations)
        np.testing.assert_array_equal(values, expected)


@pytest.mark.parametrize(
    ("quantity", "factor"),
    [("velocity", 1.2), ("acceleration", 1.2**0.5), ("jerk", 1.2 ** (1 / 3)), ("position", None)],
)
def test_slowdown_follows_the_law_of_time_scaling(quantity, factor):
    violated = [Violation(quantity, "elbow", 0.0, 1.2, 1.0, 0.2)]
    assert slowdown(violated) == pytest.approx(1.0 if factor is None else 1.02 * factor)
    worse = Violation("velocity", "elbow", 0.0, 1.5, 1.0, 0.5)
    assert slowdown([*violated, worse]) == pytest.approx(1.02 * 1.5)


@given(shares, shares, st.floats(0.2, 5.0))
def test_stretch_of_a_minimum_jerk_motion_gives_its_least_duration(first, second, duration):
    robot, start, goal = arm_robot(), configuration(first), configuration(second)
    limits = limits_of(max_velocity=0.7, max_acceleration=2.0, max_jerk=9.0)
    motion = minimum_jerk(start, goal, duration)
    s = motion.times[:, None] / duration
    jerks = (goal - start) * (60.0 - 360.0 * s + 360.0 * s**2) / duration**3
    states = np.array([motion.positions, motion.velocities, motion.accelerations, jerks])
    for bounds in (limits, limits_of(max_effort=50.0), limits_of(max_effort=0.01)):
        stretch = least_stretch(robot, bounds, states)
        try:
            least = least_duration(robot, bounds, start, goal)
        except TrajectoryError:
            assert stretch == np.inf
        else:
            assert stretch * duration == pytest.approx(least, rel=5e-3, abs=1e-6)
