# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where a robot is and where its motions start; the tests say how it follows its motion."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from support.dense import minimum_jerk_motion, spline

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.execution.motions import PublishedMotion
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.states import MeasuredStates, UnconfirmedError
from mp_pca_planner.execution.tracking import (
    StatedCommand,
    TooLateError,
    Tracker,
    choose_start,
    join,
)
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory

JOINTS = ("a", "b")
SETTINGS = Settings(state_timeout=0.5)
TRANSPORT, PLANNED_TRANSPORT = 0.02, 0.04  # of a message, and of one that is still to be planned
START_TOLERANCE = 0.005  # of a robot at rest, while a motion is planned [rad]
DURATION = 2.0


class World:
    """A robot, and what is known of where its motions start.

    Its servos lag by a time [s] and, under a load, by a distance [rad]. Its clock is ahead of that
    of the node by a time [s]. It may state its command.
    """

    def __init__(self, lag=0.003, *, states_command=False):
        self.now, self.lag, self.states_command = 1000.0, lag, states_command
        self.load, self.here = np.zeros(2), np.zeros(2)
        self.clock_ahead = 0.0
        self.tracker = Tracker(MeasuredStates(lambda: self.now, lambda: self.now), lambda: self.now)
        self.tracker.expect(JOINTS)
        self.rest()

    def measure(self, positions, velocities=(0.0, 0.0)):
        self.here = np.asarray(positions)
        stamp = self.now + self.clock_ahead
        self.tracker.measured.receive(JOINTS, self.here + self.load, velocities, stamp)

    def state_command(self, state, rate=1.0):
        if self.states_command:
            self.tracker.receive(StatedCommand(state, rate, self.now))

    def run(self, duration, where):
        """The robot is where the function of time says, off its motion."""
        for k in range(round(duration / 0.004)):
            self.now += 0.004
            self.measure(where(self.now))
            self.state_command(JointState(JOINTS, self.here))
            if k % 10 == 9:
                with suppress(GoalError):
                    self.where()

    def rest(self, duration=0.4):
        self.run(duration, lambda _: self.here)

    def begin(self, goal=(1.0, -1.0)):
        """Publish a motion from here."""
        trajectory = minimum_jerk_motion(JOINTS, self.here, goal, DURATION)
        self.publish(PublishedMotion.after_wait(trajectory, self.now))

    def publish(self, motion):
        self.tracker.publish(motion)
        self.motion = motion

    def follow(self, duration, rate=lambda _: 1.0, motion=None):
        """The robot follows a motion at a rate; returns its place at last."""
        motion = motion or self.motion
        place = self.now - motion.began
        for k in range(round(duration / 0.004)):
            self.now += 0.004
            place += 0.004 * rate(self.now)
            self.measure(motion.state(place - self.lag * rate(self.now)).positions)
            self.state_command(motion.state(place), rate(self.now))
            if k % 10 == 9:
                self.where()
        return place

    def where(self):
        return self.tracker.where(SETTINGS)

    def choose(self, start_from="auto", latency=0.05):
        settings = replace(SETTINGS, start_from=start_from)
        return choose_start(self.tracker.where(settings), settings, latency)

    def join(self, rest, start, *, stamp=True):
        settings = replace(SETTINGS, stamp_trajectories=stamp)
        return join(rest, start, self.tracker.where(settings))


@pytest.fixture
def world():
    return World()


@pytest.fixture(params=[False, True], ids=["seen", "stated"])
def moving(request):
    """Half a second into a motion."""
    world = World(states_command=request.param)
    world.begin()
    world.follow(0.5)
    return world


def standing(start):
    """A second of standing still, from where a motion is to start."""
    zero = np.zeros((2, 2))
    return Trajectory(JOINTS, [0.0, 1.0], [start.state.positions] * 2, zero, zero)


def continuing(start):
    """A motion that continues the state at which it starts, to rest."""
    state, zero = start.state, np.zeros(2)
    q, v, a = state.positions, state.velocities, state.accelerations
    return Trajectory(JOINTS, [0.0, 1.0], [q, q + 0.3], [v, zero], [a, zero])


# At rest


@pytest.mark.parametrize("start_from", ["auto", "measured", "commanded"])
def test_resting_robot_that_was_never_commanded_starts_where_it_is_measured(world, start_from):
    world.here = np.array([0.3, 0.4])
    world.rest()
    start = world.choose(start_from)
    assert start.state.positions.tolist() == [0.3, 0.4]
    assert not start.state.velocities.any() and not start.state.accelerations.any()
    assert start.following is None or not start.following.is_running


@pytest.mark.parametrize("lag", [0.0, 0.1])
def test_held_end_is_where_the_next_motion_starts_whatever_a_load_pulls(lag):
    world = World(lag)
    world.begin()
    world.load = np.array([0.0, -0.01])
    world.follow(2.5)
    start = world.choose()
    assert start.state.positions.tolist() == [1.0, -1.0]
    assert start.following is None or not start.following.is_running
    np.testing.assert_allclose(world.choose("measured").state.positions, [1.0, -1.01], atol=1e-6)


@pytest.mark.parametrize(("moved", "accepted"), [(0.9, True), (1.1, False)])
def test_measured_start_may_move_by_the_tolerance_while_planning(world, moved, accepted):
    start = world.choose()
    world.measure([0.0, moved * START_TOLERANCE])
    if accepted:
        world.join(standing(start), start)
    else:
        with pytest.raises(TooLateError, match="joint 'b'"):
            world.join(standing(start), start)


@pytest.mark.parametrize(("stamp", "clock_ahead"), [(False, 0.0), (True, 5.0), (True, -5.0)])
def test_motion_is_not_stamped_unless_that_is_enabled_and_clocks_agree(world, stamp, clock_ahead):
    world.clock_ahead = clock_ahead
    world.rest(2.0)
    start = world.choose()
    joined = world.join(standing(start), start, stamp=stamp)
    assert joined.stamp is None
    assert joined.sent.times.tolist() == [0.0, 1.0]


# In motion


@pytest.mark.parametrize("start_from", ["auto", "commanded"])
def test_start_is_on_the_running_motion_ahead_by_the_latency(moving, start_from):
    start = moving.choose(start_from, 0.1)
    # At a point of the motion that is nearer than 0.3 ms.
    assert start.time == pytest.approx(moving.now + 0.1 + PLANNED_TRANSPORT, abs=3e-4)
    path = spline(moving.motion.trajectory)
    expected = [path(start.time - moving.motion.began, order) for order in range(3)]
    np.testing.assert_allclose(start.state.values, expected, atol=1e-6)
    assert start.following is not None and start.following.is_running


def test_start_beyond_the_end_of_the_running_motion_is_its_goal_at_rest(moving):
    moving.follow(1.45)
    start = moving.choose(latency=0.3)
    assert start.state.positions.tolist() == [1.0, -1.0]
    assert not start.state.velocities.any()


def test_robot_that_moves_away_from_the_running_motion_is_refused(world):
    world.begin()
    world.follow(0.5)
    world.run(0.5, lambda time: [0.3 - 0.5 * (time - world.motion.began), 0.6])
    with pytest.raises(GoalError, match=r"not along a motion of this node: joint '.' is 0\.\d+"):
        world.choose()
    with pytest.raises(GoalError, match="start_from.*set start_from to 'auto'"):
        world.choose("measured")


def test_robot_whose_speed_changes_waits():
    world = World(states_command=True)
    world.begin()
    world.follow(0.7, lambda time: 1.0 - 0.9 * (time - world.motion.began))
    with pytest.raises(UnconfirmedError, match="speed of the robot changes"):
        world.choose()


def test_robot_that_slows_down_stops_and_does_not_go_back(moving):
    following = replace(moving.where().following, time=0.0, place=0.7, rate=0.1, change=-0.5)
    assert following.at(0.1) == pytest.approx(0.7 + 0.1 * 0.1 - 0.25 * 0.1**2)
    assert following.at(0.2) == following.at(5.0) == pytest.approx(0.7 + 0.01)


def test_motion_to_a_single_point_is_known_only_at_its_end(world):
    trajectory = minimum_jerk_motion(JOINTS, world.here, (1.0, -1.0), DURATION)
    world.publish(PublishedMotion.to_last_point(trajectory, world.now))
    world.follow(1.0)  # by chance, its controller leads there along the same path
    with pytest.raises(GoalError, match="moves"):
        world.choose()
    world.follow(1.5)
    assert world.choose().state.positions.tolist() == [1.0, -1.0]


def test_start_is_refused_when_no_message_can_be_there_in_time(moving):
    start = moving.choose(latency=0.0)
    moving.follow(PLANNED_TRANSPORT - TRANSPORT - 0.004)
    moving.join(continuing(start), start)
    moving.follow(0.008)
    with pytest.raises(TooLateError, match="planning took too long"):
        moving.join(continuing(start), start)


def test_start_is_refused_when_the_robot_was_held_meanwhile(moving):
    start = moving.choose(latency=0.5)
    moving.follow(0.4, lambda _: 0.0)
    with pytest.raises(TooLateError, match="on time when planning began and is held now"):
        moving.join(continuing(start), start)


def test_stale_state_waits_in_motion_and_is_refused_after_the_timeout(moving):
    moving.now += 0.11
    with pytest.raises(UnconfirmedError, match="0.11 s old"):
        moving.choose()
    moving.now += 0.5
    with pytest.raises(GoalError, match="old"):
        moving.choose()


def test_state_of_before_the_end_of_a_motion_does_not_say_that_the_robot_is_there(world):
    """The controller may have rejected the motion, while no state says so."""
    short = minimum_jerk_motion(JOINTS, world.here, (1.0, -1.0), 0.4)
    world.publish(PublishedMotion.after_wait(short, world.now))
    world.now += 0.48
    assert not world.where().following.is_over
    with pytest.raises(UnconfirmedError):
        world.choose()
    world.rest()
    assert world.choose().state.positions == pytest.approx(world.here)


def test_robot_that_is_seen_on_the_motion_before_is_continued_there(moving):
    old = moving.motion
    start = moving.choose()
    moving.publish(moving.join(continuing(start), start))
    moving.follow(0.6, motion=old)
    assert moving.choose().following.motion is old
    moving.tracker.give_up()
    assert moving.tracker.motion is old


# The stated command


def test_stated_command_that_is_old_or_far_from_the_robot_does_not_count():
    world = World(states_command=True)
    world.state_command(JointState(JOINTS, [0.09, 0.0]))
    assert world.where().command is not None
    world.now += 0.004
    world.state_command(JointState(JOINTS, [0.11, 0.0]))
    assert world.where().command is None
    world.now += 0.004
    world.state_command(JointState(JOINTS, [0.0, 0.0]))
    assert world.where().command is not None
    world.states_command = False
    world.rest(0.12)
    assert world.where().command is None


def test_stated_command_of_a_fast_robot_counts_though_its_servos_lag():
    world = World(0.09, states_command=True)
    world.begin(goal=(3.0, -3.0))
    world.follow(1.0)
    stated = world.where().command.state.positions
    assert np.abs(stated - world.here).min() > 0.2
    velocities = world.where().command.state.velocities
    world.now += 0.001
    world.state_command(JointState(JOINTS, stated + 0.2, velocities))
    assert world.where().command is None


def test_command_of_other_joints_does_not_count(world):
    other = JointState(("other", "joints"), [1.0, 1.0])
    world.tracker.receive(StatedCommand(other, 1.0, world.now))
    assert world.where().command is None
    assert world.choose().state.positions.tolist() == [0.0, 0.0]
