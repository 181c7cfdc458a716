# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What is learned of loads and servos, from robots whose load and lag the tests choose."""

from __future__ import annotations

import numpy as np
import pytest

from mp_pca_planner.execution.options import Tracking
from mp_pca_planner.execution.tracking.estimation import ServoModel
from mp_pca_planner.execution.tracking.published_motion import PublishedMotion
from mp_pca_planner.motion.trajectory import Trajectory

V = np.array([0.8, -0.6, 0.0])
ACROSS = np.array([0.6, 0.8, 1.0])  # to the motion: along it, an offset looks like a lag
LAG, LOAD, PERIOD = 0.012, 0.01 * ACROSS, 0.01


def even(duration=10.0, rate=1.0):
    """A motion at a constant speed, which began at 0."""
    ends = np.array([np.zeros(3), V * rate * duration])
    velocities = np.tile(rate * V, (2, 1))
    trajectory = Trajectory(tuple("abc"), [0.0, duration], ends, velocities, np.zeros((2, 3)))
    return PublishedMotion(trajectory, 0.0)


def learned(servo, seconds, *, begin=1.0, lag=LAG, load=LOAD, motion=None):
    """Learn from a robot that follows with this lag and load."""
    motion = motion or even()
    for time in begin + PERIOD * np.arange(round(seconds / PERIOD)):
        servo.learn(motion, time, motion.state(time - lag).positions + load, lag)
    return servo


def test_lag_and_load_of_a_robot_in_motion_are_learned():
    servo = learned(ServoModel(3), 2.0)
    assert servo.lag == pytest.approx(LAG, abs=5e-4)
    np.testing.assert_allclose(servo.offset, LOAD, atol=1e-4)


def test_load_is_learned_with_a_time_constant_of_a_fifth_of_a_second():
    servo = learned(ServoModel(3), 1.0, load=np.zeros(3))
    learned(servo, 0.2, begin=2.0)
    np.testing.assert_allclose(servo.offset, LOAD * (1.0 - np.exp(-1.0)), rtol=0.05)


def test_lag_is_not_learned_from_a_robot_that_hardly_moves():
    servo = learned(ServoModel(3), 0.5, lag=0.05, motion=even(rate=0.001))
    assert servo.lag < 0.003


@pytest.mark.parametrize(("lag", "expected"), [(-0.5, 0.0), (0.5, Tracking.max_lag)])
def test_lag_stays_within_what_servos_do(lag, expected):
    servo = ServoModel(3)
    for time in 1.0 + PERIOD * np.arange(500):
        servo.learn(even(), time, even().state(time).positions, lag)
    assert servo.lag == pytest.approx(expected, abs=1e-3)


def test_lag_that_grows_while_it_is_learned_is_not_believed():
    """A robot that was slowed for a moment is behind the clock, too, until its motion ends."""
    servo = ServoModel(3)
    servo.limit_lag(1.0, 0.002)
    assert servo.longest_lag == pytest.approx(0.002 + Tracking.lag_noise)
    learned(servo, 0.2, lag=0.026)
    assert servo.lag <= 0.002 + Tracking.lag_noise


def test_offset_at_rest_is_taken_as_measured():
    servo = ServoModel(3)
    servo.rest(LOAD)
    np.testing.assert_array_equal(servo.offset, LOAD)
    assert not servo.unlearn()


def test_what_was_learned_of_the_last_moments_is_forgotten_at_once():
    servo = learned(ServoModel(3), 2.0)
    good = servo.offset, servo.lag
    learned(servo, 0.3, begin=3.0, lag=0.06, load=3.0 * LOAD)
    assert np.abs(servo.offset - LOAD).max() > 0.005
    assert servo.unlearn()
    np.testing.assert_allclose(servo.offset, good[0], atol=1e-4)
    assert servo.lag == pytest.approx(good[1], abs=1e-4)
    assert not servo.unlearn()


def test_robot_may_be_little_later_than_it_was_learned_to_be():
    servo = ServoModel(3)
    assert servo.longest_lag == Tracking.max_lag
    learned(servo, 2.0)
    assert LAG < servo.longest_lag < LAG + 0.02


@pytest.mark.parametrize(
    ("speed", "lag", "expected"),
    [(1.0, 0.003, 0.003), (1.0, -0.001, 0.0), (0.05, 0.003, 0.018), (1.0, 0.016, 0.018)],
)
def test_servos_lag_no_more_than_a_robot_in_fast_motion_does(speed, lag, expected):
    servo = ServoModel(1)
    servo.lag = 0.018
    servo.limit_lag(speed, lag)
    assert servo.lag == pytest.approx(expected)
