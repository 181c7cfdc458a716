# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Stops, against limits, paths and polynomials that the tests compute for themselves."""

from __future__ import annotations

import time
from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arm import JOINTS, arm_robot
from support.dense import assert_keeps, minimum_jerk_motion, spline

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.states import MeasuredStates
from mp_pca_planner.execution.stopping import (
    LATENCY,
    find_stop,
    stop_at_point,
    stop_on_path,
)
from mp_pca_planner.execution.tracking import Tracker
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory

ROBOT = arm_robot()
LIMITS = ROBOT.limits(
    {name: {"max_velocity": 2.0, "max_acceleration": 8.0, "max_jerk": 120.0} for name in JOINTS}
)
START, SHIFT = np.array([-1.0, 0.2, 0.0, -1.6]), np.array([0.6, -0.4, 0.5, 0.7])
DURATION, PERIOD = 1.5, 0.01


@cache
def curved():
    """A minimum-jerk motion with a detour, so that its path is no straight line."""
    straight = minimum_jerk_motion(JOINTS, START, START + SHIFT, DURATION)
    s = straight.times / DURATION
    bump = np.polynomial.Polynomial([0, 0, 0, 1]) * np.polynomial.Polynomial([1, -1]) ** 3
    side = 4.0 * np.array([1.0, 0.0, -1.0, 0.5])
    columns = (straight.positions, straight.velocities, straight.accelerations)
    q, v, a = (
        x + np.outer((bump.deriv(d) if d else bump)(s), side) / DURATION**d
        for d, x in enumerate(columns)
    )
    return PublishedMotion(Trajectory(JOINTS, straight.times, q, v, a), 0.0)


@pytest.mark.parametrize("place", np.linspace(0.02, 0.98, 13) * DURATION)
def test_stop_on_path_continues_the_motion_keeps_its_path_and_the_limits_and_ends_at_rest(place):
    motion = curved()
    stop = stop_on_path(motion, place, ROBOT, LIMITS, PERIOD)
    path, curve = spline(motion.trajectory), spline(stop)
    for order in range(3):
        np.testing.assert_allclose(curve(0.0, order), path(place, order), atol=1e-9)
    assert_keeps(curve, LIMITS)
    assert not stop.velocities[-1].any() and not stop.accelerations[-1].any()
    on_path = path(np.linspace(place, DURATION, 10001))
    for q in curve(np.linspace(0.0, stop.duration, 150)):
        assert np.abs(on_path - q).max(axis=1).min() < 2e-4


def test_stop_on_path_is_as_short_as_the_limits_allow():
    stop = stop_on_path(curved(), 0.5 * DURATION, ROBOT, LIMITS, PERIOD)
    fastest = np.abs(curved().state(0.5 * DURATION).velocities / LIMITS.acceleration).max()
    # The rate falls at most 1.5 times as fast as evenly, and each time tried is 1.2 times the last.
    assert fastest < stop.duration < 0.5 * DURATION
    quicker = ROBOT.limits({name: {"max_velocity": 2.0} for name in JOINTS})
    assert stop_on_path(curved(), 0.5 * DURATION, ROBOT, quicker, PERIOD).duration < stop.duration


def test_stop_on_path_is_the_rest_of_the_motion_where_no_stop_keeps_the_limits():
    tight = ROBOT.limits({name: {"max_acceleration": 1e-3} for name in JOINTS})
    place = 0.6 * DURATION
    rest = stop_on_path(curved(), place, ROBOT, tight, PERIOD)
    path, curve = spline(curved().trajectory), spline(rest)
    assert rest.duration == pytest.approx(DURATION - place, abs=1e-6)
    times = np.linspace(0.0, rest.duration, 300)
    np.testing.assert_allclose(curve(times), path(place + times), atol=1e-5)


def test_stop_of_a_motion_that_is_over_holds_its_end():
    stop = stop_on_path(curved(), DURATION, ROBOT, LIMITS, PERIOD)
    assert stop.n_steps == 1
    np.testing.assert_allclose(stop.positions[0], curved().end)


def assert_is_allowed_from(states, stop, limits):
    """A controller may lead to the last point from each state, with or without accelerations."""
    for state in states:
        zero = np.zeros(4)
        path = Trajectory(
            JOINTS,
            [0.0, stop.duration],
            [state.positions, stop.positions[-1]],
            [state.velocities, zero],
            [state.accelerations, zero],
        )
        for n_derivatives in (2, 3):
            assert_keeps(spline(path, n_derivatives), limits)


def braking_from(state):
    """The end of an even deceleration, by its duration."""
    return lambda time: state.positions + 0.5 * time * state.velocities


NUMBERS = st.lists(st.floats(-1.0, 1.0), min_size=4, max_size=4).map(np.array)


@given(where=NUMBERS, v=NUMBERS, a=NUMBERS)
def test_robot_that_moves_anyhow_is_braked_within_its_limits(where, v, a):
    middle, half = 0.5 * (LIMITS.upper + LIMITS.lower), 0.5 * (LIMITS.upper - LIMITS.lower)
    # So far from its limits that it can stop before them.
    q, v, a = middle + 0.6 * where * half, 0.5 * v * LIMITS.velocity, 0.2 * a * LIMITS.acceleration
    state = JointState(JOINTS, q, v, a)
    stop = stop_at_point([state], braking_from(state), ROBOT, LIMITS)
    assert stop is not None
    assert_is_allowed_from([state], stop, LIMITS)


@pytest.mark.parametrize("speed", [0.3, -1.0, 1.9])
def test_stop_at_a_point_is_as_short_as_an_acceleration_allows(speed):
    free = {"max_velocity": 2.0, "max_acceleration": 8.0, "max_effort": np.inf}
    limits = ROBOT.limits(dict.fromkeys(JOINTS, free))
    state = JointState(JOINTS, START, [speed, 0.0, 0.0, 0.0])
    stop = stop_at_point([state], braking_from(state), ROBOT, limits)
    # The quartic's acceleration is 1.5 times the cubic's; each time tried is 1.3 times the last.
    least = 1.5 * abs(speed) / 8.0
    assert least * (1.0 - 1e-6) <= stop.duration <= 1.31 * least


def test_stop_at_a_point_does_not_exist_where_none_keeps_the_limits_and_is_given_up_at_once():
    slow = JointState(JOINTS, START, [0.5, 0.0, 0.0, 0.0])
    fast = JointState(JOINTS, START, [2.1, 0.0, 0.0, 0.0])  # than its limit
    near = JointState(JOINTS, LIMITS.upper - 1e-3, np.full(4, 1.5))
    weak = ROBOT.limits({name: {"max_effort": 0.1} for name in JOINTS})  # for its weight
    for state, limits in ((near, LIMITS), (fast, LIMITS), (slow, weak)):
        spent = []
        for _ in range(3):
            began = time.process_time()
            assert stop_at_point([state, slow], braking_from(state), ROBOT, limits) is None
            spent.append(time.process_time() - began)
        assert min(spent) < LATENCY


def silent_stop(now, seen, limits):
    """The stop of a robot on its motion that was seen last at a time."""
    clock = seen
    measured = MeasuredStates(lambda: clock, lambda: clock)
    tracker = Tracker(measured, lambda: clock)
    tracker.expect(JOINTS)
    tracker.publish(curved())
    measured.receive(JOINTS, curved().state(seen).positions)
    clock = now
    return find_stop(GoalError("its states are old"), tracker, ROBOT, limits, Settings())


def test_stop_of_a_silent_robot_takes_as_long_as_its_limits_need():
    # From where it was seen, a quintic to the end has a peak velocity of 1.875 times the mean.
    limits = ROBOT.limits({name: {"max_velocity": 0.05} for name in JOINTS})
    _, stop = silent_stop(1.6, 0.2, limits)
    distance = np.abs(curved().end - curved().state(0.2).positions).max()
    least = 1.875 * distance / 0.05
    assert least <= stop.sent.duration <= 1.31 * least
    np.testing.assert_allclose(stop.end, curved().end, atol=1e-9)


def test_stop_of_a_silent_robot_is_near_its_command_if_none_is_allowed_from_elsewhere():
    # Gravity at the place where it was seen exceeds the limit of effort.
    seen, now = curved().state(0.2).positions, curved().state(1.6)
    still = np.zeros((1, 4))
    at_seen, at_end = (
        np.abs(ROBOT.inverse_dynamics(q[None], still, still))[0] for q in (seen, now.positions)
    )
    k = (at_seen / at_end).argmax()
    bound = 0.5 * (at_seen + at_end)[k]
    _, stop = silent_stop(1.6, 0.2, ROBOT.limits({JOINTS[k]: {"max_effort": bound}}))
    np.testing.assert_allclose(stop.sent.positions, [now.positions] * 2, atol=1e-9)
    _, stop = silent_stop(1.6, 0.2, ROBOT.limits({JOINTS[k]: {"max_effort": 0.5 * at_end[k]}}))
    np.testing.assert_allclose(stop.sent.positions, [now.positions], atol=1e-9)


def test_stop_of_a_silent_robot_is_allowed_from_wherever_it_may_have_been_held():
    said, stop = silent_stop(0.9, 0.2, LIMITS)
    assert "not known whether the robot stops" in said and not stop.is_path_known
    held = JointState(JOINTS, curved().state(0.2).positions)
    assert_is_allowed_from([curved().state(0.9), held], stop.sent, LIMITS)
    on_path = spline(curved().trajectory)(np.linspace(0.9, DURATION, 10001))
    assert np.abs(on_path - stop.end).max(axis=1).min() < 2e-4


def test_stop_of_a_robot_on_no_motion_is_allowed_from_where_it_was_and_where_it_may_be():
    now, v = 0.0, np.array([0.5, -0.3, 0.4, 0.2])
    tracker = Tracker(MeasuredStates(lambda: now, lambda: now), lambda: now)
    tracker.expect(JOINTS)
    for now in np.linspace(0.0, 0.4, 41):
        tracker.measured.receive(JOINTS, START + now * v, v.tolist())
    seen, now = now, now + 0.08
    where = tracker.where(Settings())
    _, stop = find_stop(where, tracker, ROBOT, LIMITS, Settings())
    assert not stop.is_path_known
    states = [JointState(JOINTS, START + time * v, v) for time in (seen, now)]
    assert_is_allowed_from(states, stop.sent, LIMITS)


def test_stop_before_an_obstacle_is_quick_enough_with_the_time_until_it_begins():
    now = 0.0
    tracker = Tracker(MeasuredStates(lambda: now, lambda: now), lambda: now)
    tracker.expect(JOINTS)
    tracker.publish(curved())
    for now in np.linspace(0.4, 0.5, 11) * DURATION:
        tracker.measured.receive(JOINTS, curved().state(now).positions)
    where = tracker.where(Settings())

    def time_to_rest(time_left):
        _, stop = find_stop(where, tracker, ROBOT, LIMITS, Settings(), time_left)
        return stop.time + stop.sent.duration - now

    usual = time_to_rest(np.inf)
    for less in (0.01, 0.03):
        assert time_to_rest(usual - less) <= usual - less
