# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where motions start, with a robot of which the tests say how it follows its motion."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from support.dense import minimum_jerk_motion, spline
from support.virtual_node import receive

from mp_pca_planner.exceptions import GoalError, TrajectoryError
from mp_pca_planner.execution.options import Tracking
from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.tracking.estimation import StatedCommand
from mp_pca_planner.execution.tracking.following import How, MotionFollower, UnconfirmedError
from mp_pca_planner.execution.tracking.measured import MeasuredStates
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion
from mp_pca_planner.execution.tracking.start_state import TooLateError, choose_start, join
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory

JOINTS = ("a", "b")
TIMEOUT = 0.5
SETTINGS = Settings(state_timeout=TIMEOUT, commanded_tolerance=0.1)
TRANSPORT, PLANNED_TRANSPORT = 0.02, 0.04  # of a message, and of one that is still to be planned
SERVO = 0.003  # by which the robot lags behind its commands [s]
DURATION = 2.0


class World:
    """A robot, and what is known of where its motions start."""

    def __init__(self):
        self.now = 1000.0
        self.load = np.zeros(2)
        self.clock_ahead = 0.0
        self.here = np.zeros(2)
        self.set_back = 0.0  # time by which the clock of motions was set back
        self.tick = 0.0  # time that passes between two looks at the clock
        self.follower = MotionFollower(
            MeasuredStates(lambda: self.now + self.set_back, self._clock)
        )
        self.follower.expect(JOINTS)

    def _clock(self):
        self.now += self.tick
        return self.now

    def measure(self, positions, velocities=(0.0, 0.0)):
        self.here = np.asarray(positions)
        stamp = self.now + self.clock_ahead
        receive(self.follower.measured, stamp, self.here + self.load, velocities)

    def rest(self, duration=0.4, *, see=True):
        self.run(duration, lambda _: self.here, see=see)

    def run(self, duration, where, *, see=True):
        """The robot is where the function of time says, and the node sees how it follows.

        It may be moved there at once: for a moment its states contradict each other.
        """
        for k in range(round(duration / 0.004)):
            self.now += 0.004
            self.measure(where(self.now))
            if see and k % 10 == 9:
                with suppress(GoalError):
                    self.follower.follow(SETTINGS)

    def begin(self, goal=(1.0, -1.0)):
        """Publish a motion from here."""
        trajectory = minimum_jerk_motion(JOINTS, self.here, goal, DURATION)
        self.publish(PublishedMotion.after_wait(trajectory, self.now))

    def publish(self, motion):
        self.follower.command(motion)
        self.motion = motion

    def follow(self, duration, rate=lambda _: 1.0):
        """The robot follows the motion at a rate; returns its place at last."""
        place = self.now - self.motion.began
        for k in range(round(duration / 0.004)):
            self.now += 0.004
            place += 0.004 * rate(self.now)
            self.measure(self.motion.state(place - SERVO * rate(self.now)).positions)
            if k % 10 == 9:
                self.follower.follow(SETTINGS)
        return place

    def choose(self, start_from="auto", latency=0.05, **options):
        return choose_start(
            self.follower, replace(SETTINGS, start_from=start_from), latency, **options
        )

    def join(self, rest, start, may_stamp=True):
        return join(self.follower, rest, start, replace(SETTINGS, stamp_trajectories=may_stamp))


@pytest.fixture
def world():
    world = World()
    world.rest()
    return world


@pytest.fixture
def moving(world):
    """Half a second into a motion."""
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
    world.measure([0.3, 0.4])
    world.rest()
    start = world.choose(start_from)
    assert start.state.positions.tolist() == [0.3, 0.4]
    assert not start.state.velocities.any() and not start.state.accelerations.any()
    assert not start.is_in_motion


def test_velocity_below_the_noise_counts_as_rest(world):
    world.measure([0.0, 0.0], [0.009, -0.009])
    assert not world.choose("measured").state.velocities.any()


@pytest.mark.parametrize("start_from", ["auto", "measured", "commanded"])
def test_robot_that_moves_by_itself_is_refused(world, start_from):
    world.run(0.4, lambda time: [0.1 * (time - 1000.0), 0.0])
    with pytest.raises(GoalError, match="the robot moves"):
        world.choose(start_from)


def test_held_end_is_where_the_next_motion_starts_whatever_a_load_pulls(moving):
    moving.follow(2.0)
    moving.load = np.array([0.0, -0.01])
    moving.rest()
    start = moving.choose()
    assert start.state.positions.tolist() == [1.0, -1.0]
    assert not start.is_in_motion
    np.testing.assert_allclose(moving.follower.servo.load, moving.load)
    np.testing.assert_allclose(moving.choose("measured").state.positions, [1.0, -1.01])


def test_robot_that_its_load_pulls_back_along_the_path_has_arrived(world):
    world.load = np.array([0.002, -0.002])
    world.begin()
    world.follow(DURATION + 0.2)
    world.rest()
    world.choose()
    world.begin(goal=(0.0, 0.0))
    world.follow(DURATION - 0.04)
    world.load = 1.9 * world.load
    world.follow(0.3)
    world.rest()
    np.testing.assert_allclose(world.choose().state.positions, [0.0, 0.0], atol=1e-9)


def test_load_that_is_known_is_taken_off_where_a_robot_rests_off_its_motion(moving):
    moving.load = np.array([0.0, -0.01])
    moving.follow(2.0)
    moving.choose()
    moving.run(0.4, lambda _: np.array([0.5, -0.5]))
    np.testing.assert_allclose(moving.choose().state.positions, [0.5, -0.5])


def test_robot_that_rests_away_from_its_motion_starts_where_it_is(moving):
    moving.run(0.5, lambda _: np.array([0.1, 0.3]))
    start = moving.choose()
    assert start.following is None
    np.testing.assert_allclose(start.state.positions, [0.1, 0.3], atol=1e-3)
    assert not start.state.velocities.any()


@pytest.mark.parametrize(("moved", "accepted"), [(0.9, True), (1.1, False)])
def test_measured_start_may_move_by_the_tolerance_while_planning(world, moved, accepted):
    start = world.choose("measured")
    world.measure([0.0, moved * Tracking.start_tolerance])
    if accepted:
        world.join(standing(start), start)
    else:
        with pytest.raises(TrajectoryError, match="joint 'b'"):
            world.join(standing(start), start)


def test_start_is_refused_when_the_state_became_too_old(world):
    start = world.choose()
    world.now += TIMEOUT + 0.1
    with pytest.raises(GoalError, match="old"):
        world.join(standing(start), start)


def test_motion_from_rest_waits_as_long_as_a_message_may_take(world):
    start = world.choose()
    joined = world.join(standing(start), start)
    assert (joined.is_timed, joined.time) == (True, world.now)
    assert joined.sent.times.tolist() == [0.0, TRANSPORT, 1.0 + TRANSPORT]
    assert joined.sent.positions.tolist() == [[0.0, 0.0]] * 3
    assert not joined.sent.velocities[:2].any()


def test_motion_is_not_stamped_unless_that_is_enabled(world):
    start = world.choose()
    joined = world.join(standing(start), start, False)
    assert not joined.is_timed
    assert joined.sent.times.tolist() == [0.0, 1.0]


@pytest.mark.parametrize("clock_ahead", [5.0, -5.0, 0.02])
def test_stamp_is_a_time_of_the_robots_clock(clock_ahead):
    world = World()
    world.clock_ahead = clock_ahead
    world.rest()
    start = world.choose()
    joined = world.join(standing(start), start)
    assert joined.stamp == pytest.approx(world.now + clock_ahead)


def test_motion_is_not_stamped_if_the_stamps_of_states_are_no_times():
    world, random = World(), np.random.default_rng(0)
    for _ in range(100):
        world.clock_ahead = random.uniform(-1000.0, 1000.0)
        world.rest(0.004)
    start = world.choose()
    assert not world.join(standing(start), start).is_timed


# In motion


@pytest.mark.parametrize("start_from", ["auto", "commanded"])
def test_start_is_on_the_running_motion_ahead_by_the_latency(moving, start_from):
    start = moving.choose(start_from, 0.1)
    place = moving.now + 0.1 + PLANNED_TRANSPORT - moving.motion.began
    found = [getattr(start.state, k) for k in ("positions", "velocities", "accelerations")]
    path = spline(moving.motion.trajectory)
    np.testing.assert_allclose(found, [path(place, d) for d in range(3)], atol=1e-9)
    assert start.is_in_motion
    assert start.deadline == pytest.approx(moving.now + 0.1 + PLANNED_TRANSPORT - TRANSPORT)


def test_measured_refuses_a_robot_that_moves_and_says_what_to_do(moving):
    with pytest.raises(GoalError, match="start_from.*set start_from to 'auto'"):
        moving.choose("measured")


def test_start_beyond_the_end_of_the_running_motion_is_its_goal_at_rest(moving):
    moving.follow(1.45)
    start = moving.choose(latency=0.3)
    assert start.state.positions.tolist() == [1.0, -1.0]
    assert not start.state.velocities.any()


def test_robot_that_moves_at_the_end_of_its_motion_is_waited_for(world):
    world.begin()
    world.follow(DURATION + 0.5)
    world.measure(world.here, (0.2, 0.0))
    with pytest.raises(UnconfirmedError, match="is coming to rest"):
        world.choose()
    with pytest.raises(GoalError, match="start_from is 'measured'"):
        world.choose("measured")


def test_robot_that_moves_away_from_the_running_motion_is_refused(moving):
    moving.run(0.5, lambda time: [0.3 - 0.5 * (time - moving.motion.began), 0.6])
    with pytest.raises(GoalError, match="joint '.' is .* commanded_tolerance"):
        moving.choose()


def test_motion_leads_to_the_start_along_the_running_one(moving):
    start = moving.choose(latency=0.1)
    moving.follow(0.04)
    joined = moving.join(continuing(start), start)
    # It begins at a point of the running motion that is nearer than 0.3 ms.
    assert joined.is_timed and joined.time == pytest.approx(moving.now, abs=3e-4)
    lead = start.time - joined.time
    assert joined.sent.duration == pytest.approx(1.0 + lead, abs=1e-6)
    old, new, rest = (
        spline(one) for one in (moving.motion.trajectory, joined.sent, continuing(start))
    )
    for order in range(3):
        for since in np.linspace(0.0, lead - 1e-6, 20):
            expected = old(moving.now - moving.motion.began + since, order)
            np.testing.assert_allclose(new(since, order), expected, atol=1e-4)
        for since in np.linspace(0.0, 1.0, 20):
            np.testing.assert_allclose(new(lead + since, order), rest(since, order), atol=1e-4)


def test_stamp_is_that_of_the_first_point_however_long_computing_takes(moving):
    moving.tick = 0.002
    start = moving.choose(latency=0.1)
    joined = moving.join(continuing(start), start)
    assert joined.is_timed
    there = moving.motion.state(joined.time - moving.motion.began).positions
    np.testing.assert_allclose(joined.sent.positions[0], there, atol=2e-6)


def test_robot_that_was_last_heard_of_before_its_motion_ended_has_not_arrived(world):
    world.begin()
    world.now += 10.0
    forever = replace(SETTINGS, state_timeout=0.0)
    assert not world.follower.follow(forever).at_rest
    world.measure(world.motion.end)
    following = world.follower.follow(forever)
    assert following.is_over and following.at_rest


def test_start_is_refused_when_no_message_can_be_there_in_time(moving):
    start = moving.choose(latency=0.0)
    moving.follow(PLANNED_TRANSPORT - TRANSPORT - 0.004)
    moving.join(continuing(start), start)
    moving.follow(0.008)
    with pytest.raises(TooLateError, match="planning took too long"):
        moving.join(continuing(start), start)


def test_start_is_refused_when_another_motion_was_published_meanwhile(moving):
    start = moving.choose()
    moving.follower.command(moving.join(continuing(start), start))
    with pytest.raises(TooLateError, match="another motion"):
        moving.join(continuing(start), start)


def test_start_is_refused_when_the_robot_was_held_meanwhile(moving):
    start = moving.choose(latency=0.5)
    here = moving.here
    moving.run(0.4, lambda _: here)
    with pytest.raises(TooLateError, match="on time when planning began and is held now"):
        moving.join(continuing(start), start)


def test_stale_state_waits_in_motion_and_is_refused_after_the_timeout(moving):
    moving.now += 0.11
    with pytest.raises(UnconfirmedError, match="0.11 s old"):
        moving.choose()
    moving.now += TIMEOUT
    with pytest.raises(GoalError, match="old"):
        moving.choose()


def test_motion_that_may_not_have_been_taken_is_not_continued_until_it_is_seen(moving):
    start = moving.choose()
    joined = moving.join(continuing(start), start)
    moving.publish(joined)
    with pytest.raises(UnconfirmedError, match="has taken the motion before"):
        moving.choose(latency=0.3)
    moving.follow(0.5)
    assert moving.choose(latency=0.3).following.motion is moving.motion


def test_robot_that_was_seen_on_the_motion_before_is_continued_there(moving):
    old = moving.motion
    start = moving.choose()
    moving.follower.command(moving.join(continuing(start), start))
    moving.follow(0.6)
    assert moving.follower.commanded.motion is old
    assert moving.choose().following.motion is old


def test_motion_that_was_never_begun_leaves_the_start_as_it_was(world):
    world.begin()
    world.rest(0.6)
    assert world.choose().state.positions.tolist() == [0.0, 0.0]


@pytest.mark.parametrize("rate", [0.1, 0.5, 0.8])
def test_slowed_robot_starts_at_its_own_place_and_rate(world, rate):
    world.begin()
    place = world.follow(0.7 / rate, lambda _: rate)
    start = world.choose(latency=0.1)
    assert start.is_in_motion and start.following.how is How.LAGGING
    then = place + rate * (0.1 + PLANNED_TRANSPORT)
    assert start.place == pytest.approx(then, abs=2e-3)
    assert start.following.progress.rate == pytest.approx(rate, abs=0.02)
    joined = world.join(continuing(start), start)
    assert joined.is_timed == (rate > 0.5)
    # When its message arrives, the robot has gone on at its rate, and the command continues that.
    arrival = world.now + 1e-3
    here = start.following.progress.at(arrival)
    sent = joined.sent.states[0][0]
    if joined.is_timed:
        sent = spline(joined.sent)(arrival - joined.time)
    np.testing.assert_allclose(sent, start.following.motion.state(here).positions, atol=1e-4)


def test_command_that_is_on_no_motion_is_waited_for_only_while_a_message_may_be_on_its_way(world):
    world.begin(goal=(0.01, -0.01))
    elsewhere = np.array([0.05, 0.05])
    state = StatedCommand(JointState(JOINTS, elsewhere), 10.0, 1.0)
    found = []
    for _ in range(60):
        world.now += 0.01
        world.measure(elsewhere)
        world.follower.controller.receive(lambda _: state, world.now)
        found.append(world.follower.follow(SETTINGS).how)
    late = round(Tracking.visible_time / 0.01)
    assert set(found[: late - 2]) == {How.ON_TIME}
    assert set(found[late + 1 :]) == {How.OFF}


def test_robot_whose_speed_changes_waits(world):
    world.begin()
    world.follow(0.7, lambda time: 1.0 - 0.9 * (time - world.motion.began))
    with pytest.raises(UnconfirmedError, match="speed of the robot changes"):
        world.choose()
    assert world.choose(at_once=True).is_in_motion


def test_held_robot_starts_where_it_rests(world):
    world.begin()
    world.follow(1.2, lambda time: max(1.0 - 1.5 * (time - world.motion.began), 0.0))
    start = world.choose()
    assert not start.is_in_motion
    np.testing.assert_allclose(start.state.positions, world.here, atol=1e-3)


def test_robot_that_is_led_to_a_point_is_not_continued(moving):
    start = moving.choose()
    stop = PublishedMotion.to_last_point(continuing(start), moving.now)
    moving.publish(stop)
    moving.follow(0.3)
    with pytest.raises(UnconfirmedError, match="being stopped"):
        moving.choose()


@pytest.mark.parametrize(("away", "is_reached"), [(0.004, True), (0.006, False), (0.011, False)])
def test_robot_that_rests_short_of_a_single_point_has_not_reached_it(moving, away, is_reached):
    moving.publish(PublishedMotion.to_last_point(continuing(moving.choose()), moving.now))
    # Beside the path that the node assumes.
    rest, since = moving.motion.end + away * np.array([-1.0, 1.0]), moving.now
    moving.run(2.0, lambda time: rest + (moving.here - rest) * (time < since + 0.5))
    assert moving.follower.follow(SETTINGS).is_over == is_reached
    np.testing.assert_allclose(moving.choose().state.positions, rest, atol=1e-4)


def test_motion_counts_no_longer_when_time_was_set_back(moving):
    moving.now -= 10.0
    moving.set_back = 10.0
    moving.rest()
    assert moving.follower.commanded is None
    np.testing.assert_allclose(moving.choose().state.positions, moving.here)


def test_what_is_known_of_former_joints_is_forgotten(moving):
    moving.follower.expect(("a",))
    assert moving.follower.commanded is None
