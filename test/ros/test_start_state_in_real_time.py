# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Where motions start when computing takes time, and when nothing is heard of the robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mp_pca_planner.execution.parameters import Settings
from mp_pca_planner.execution.tracking.following import MotionFollower
from mp_pca_planner.execution.tracking.measured import MeasuredStates
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion
from mp_pca_planner.execution.tracking.start_state import choose_start, join
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory

JOINTS = ("a",)
SETTINGS = Settings(state_timeout=0.5, commanded_tolerance=0.1)


class World:
    """A clock that goes on by `tick` [s] whenever it is read, and a robot that keeps to it."""

    def __init__(self) -> None:
        self.now, self.tick = 100.0, 0.0
        self.follower = MotionFollower(MeasuredStates(self.clock, self.clock))
        self.follower.expect(JOINTS)

    def clock(self) -> float:
        self.now += self.tick
        return self.now

    def measure(self, q: float) -> None:
        self.follower.measured.receive(JOINTS, lambda _: JointState(JOINTS, [q]))


def minimum_jerk(start: float, goal: float, duration: float) -> Trajectory:
    times = np.linspace(0.0, duration, 201)
    s, d = times / duration, goal - start
    q = start + d * (10 * s**3 - 15 * s**4 + 6 * s**5)
    v = d * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration
    a = d * (60 * s - 180 * s**2 + 120 * s**3) / duration**2
    return Trajectory(JOINTS, times, *(x[:, None] for x in (q, v, a)))


@pytest.fixture
def world() -> World:
    """A robot that rests at 0."""
    world = World()
    world.measure(0.0)
    return world


def test_stamp_is_that_of_the_first_point_however_long_computing_takes(world: World) -> None:
    motion = PublishedMotion.after_wait(minimum_jerk(0.0, 1.0, 2.0), world.follower.motion_time)
    world.follower.command(motion)
    for _ in range(100):
        world.now += 0.01
        world.measure(float(motion.state(world.now - motion.began).positions[0]))
    world.tick = 0.002
    start = choose_start(world.follower, SETTINGS, 0.1)
    assert start.is_in_motion
    rest = minimum_jerk(float(start.state.positions[0]), 2.0, 2.0)
    joined = join(world.follower, rest, start, SETTINGS)
    assert joined.is_timed
    there = motion.state(joined.time - motion.began).positions
    np.testing.assert_allclose(joined.sent.positions[0], there, atol=2e-6)


def test_robot_that_was_last_heard_of_before_its_motion_ended_has_not_arrived(
    world: World,
) -> None:
    motion = PublishedMotion.after_wait(minimum_jerk(0.0, 1.0, 2.0), world.follower.motion_time)
    world.follower.command(motion)
    world.now += 10.0
    following = world.follower.follow(replace(SETTINGS, state_timeout=0.0))
    assert following is not None
    assert not following.at_rest
    world.measure(float(motion.end[0]))
    following = world.follower.follow(replace(SETTINGS, state_timeout=0.0))
    assert following is not None
    assert following.is_over
    assert following.at_rest
