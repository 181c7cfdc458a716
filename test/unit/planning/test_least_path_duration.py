# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The least duration of a path, by closed forms and by TOPP-RA."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.arm import JOINTS, arm_robot

from mp_pca_planner.motion.interpolation import interpolate_at, segment_ends
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.time_scaling import least_path_duration

ROBOT = arm_robot()
FREE = {"max_velocity": np.inf, "max_effort": np.inf}
START, GOAL = np.array([-0.2, 0.1, 0.5, -0.4]), np.array([-1.0, 0.7, 0.2, -1.4])


def limits_of(**values):
    """These limits of every joint, and no others of rates."""
    return ROBOT.limits(dict.fromkeys(JOINTS, FREE | values))


def minimum_jerk(start, goal, duration=2.0, bend=None, n=81):
    """The minimum-jerk motion, and beside it a smooth one, if asked for."""
    s = np.linspace(0.0, 1.0, n)[:, None]
    shapes = [10 * s**3 - 15 * s**4 + 6 * s**5, 30 * s**2 - 60 * s**3 + 30 * s**4]
    shapes.append(60 * s - 180 * s**2 + 120 * s**3)
    states = [(goal - start) * shape / duration**d for d, shape in enumerate(shapes)]
    if bend is not None:
        bump = np.polynomial.Polynomial.fromroots([0, 0, 0, 1, 1, 1])
        states = [q + bend * bump.deriv(d)(s) / duration**d for d, q in enumerate(states)]
    states[0] = states[0] + start
    return Trajectory(JOINTS, duration * s[:, 0], *states)


def bang_bang(distance, velocity, acceleration):
    """Least duration from rest to rest on a line."""
    if distance * acceleration <= velocity**2:
        return 2.0 * np.sqrt(distance / acceleration)
    return distance / velocity + velocity / acceleration


@settings(deadline=None)
@given(st.floats(0.05, 20.0), st.floats(0.1, 50.0), st.floats(0.2, 9.0))
def test_a_straight_line_takes_as_long_as_bang_bang(velocity, acceleration, duration):
    motion = minimum_jerk(START, GOAL, duration)
    limits = limits_of(max_velocity=velocity, max_acceleration=acceleration)
    # Both bounds act on the joint that moves most.
    expected = bang_bang(np.abs(GOAL - START).max(), velocity, acceleration)
    assert least_path_duration(motion, ROBOT, limits) == pytest.approx(expected, rel=5e-3)


def test_limits_of_acceleration_alone_or_of_velocity_alone_suffice():
    motion, distance = minimum_jerk(START, GOAL), np.abs(GOAL - START).max()
    by_acceleration = least_path_duration(motion, ROBOT, limits_of(max_acceleration=3.0))
    assert by_acceleration == pytest.approx(2.0 * np.sqrt(distance / 3.0), rel=1e-3)
    by_velocity = least_path_duration(motion, ROBOT, limits_of(max_velocity=0.5))
    # The first and the last step are between rest and the largest velocity.
    assert by_velocity == pytest.approx(distance / 0.5, rel=5e-3)
    assert np.isnan(least_path_duration(motion, ROBOT, limits_of()))


def test_a_rest_on_the_way_is_kept_without_waiting():
    first, second = minimum_jerk(START, GOAL), minimum_jerk(GOAL, START)
    times = np.concatenate([first.times, [2.5, 3.0], 3.0 + second.times[1:]])
    rest = np.zeros((2, 4))
    states = [
        np.concatenate([a, still, b[1:]])
        for a, still, b in zip(first.states, (rest + GOAL, rest, rest), second.states, strict=True)
    ]
    limits = limits_of(max_velocity=1.0, max_acceleration=3.0)
    there, whole = minimum_jerk(START, GOAL), Trajectory(JOINTS, times, *states)
    once = least_path_duration(there, ROBOT, limits)
    assert least_path_duration(whole, ROBOT, limits) == pytest.approx(2.0 * once, rel=1e-6)


def test_a_path_that_turns_back_between_points_rests_there():
    s = np.linspace(0.0, 1.0, 60)[:, None]
    to_and_fro = np.polynomial.Polynomial.fromroots([0, 0, 0, 1, 1, 1])
    only = np.array([0.0, 0.0, 0.0, 30.0])
    motion = Trajectory(JOINTS, s[:, 0], *[START * (d == 0) + only * to_and_fro.deriv(d)(s)
                                           for d in range(3)])  # fmt: skip
    height = 30.0 / 64.0
    found = least_path_duration(motion, ROBOT, limits_of(max_acceleration=5.0))
    assert found == pytest.approx(4.0 * np.sqrt(height / 5.0), rel=0.03)


def test_a_motion_that_starts_and_ends_in_motion_keeps_its_velocities():
    times = np.linspace(0.0, 2.0, 41)
    way = (GOAL - START) / 2.0
    states = [START + way * times[:, None], np.tile(way, (41, 1)), np.zeros((41, 4))]
    distance, speed, most = np.abs(GOAL - START).max(), np.abs(way).max(), 2.0
    # Faster, then slower: half of the way from the speed v to the speed √(v² + a d).
    expected = 2.0 * (np.sqrt(speed**2 + most * distance) - speed) / most
    motion, limits = Trajectory(JOINTS, times, *states), limits_of(max_acceleration=most)
    assert least_path_duration(motion, ROBOT, limits) == pytest.approx(expected, rel=1e-3)


def test_efforts_that_gravity_alone_exceeds_bound_nothing():
    limits = limits_of(max_acceleration=3.0, max_effort=1e-3)
    assert np.isnan(least_path_duration(minimum_jerk(START, GOAL), ROBOT, limits))


def test_a_motion_that_goes_nowhere_takes_no_time():
    still = Trajectory(JOINTS, [0.0, 1.0], [START, START], np.zeros((2, 4)), np.zeros((2, 4)))
    assert least_path_duration(still, ROBOT, limits_of(max_velocity=1.0)) == 0.0


@pytest.mark.parametrize("seed", range(6))
def test_curved_paths_take_as_long_as_toppra_says(seed):
    toppra = pytest.importorskip("toppra", reason="the extra 'peers' is not installed")
    rng = np.random.default_rng(seed)
    motion = minimum_jerk(START, GOAL, bend=rng.normal(0.0, 15.0, 4))
    q, rest = motion.positions, np.zeros_like(motion.positions)
    tau = [ROBOT.inverse_dynamics(q, *rates) for rates in (motion.states[1:], (rest, rest))]
    entries = {
        name: {"max_velocity": rng.uniform(0.8, 3.0), "max_acceleration": rng.uniform(2.0, 8.0)}
        | {"max_effort": 1.1 * most}
        for name, most in zip(JOINTS, np.abs(tau).max(axis=(0, 1)), strict=True)
    }
    limits, both = ROBOT.limits(entries), [-1.0, 1.0]
    fine = np.linspace(0.0, motion.duration, 4001)
    q, _, _ = interpolate_at(fine, motion.times, segment_ends(motion.times, *motion.states))
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(q, axis=0), axis=1))])
    knots = np.unique(np.searchsorted(lengths, np.linspace(0.0, lengths[-1], 400)).clip(0, 4000))
    path = toppra.SplineInterpolator(lengths[knots], q[knots])
    bounds = toppra.constraint
    constraints = [
        bounds.JointVelocityConstraint(np.outer(limits.velocity, both)),
        bounds.JointAccelerationConstraint(np.outer(limits.acceleration, both)),
        bounds.JointTorqueConstraint(
            lambda *state: ROBOT.inverse_dynamics(*[x[None] for x in state])[0],
            np.outer(limits.effort, both),
            np.zeros(4),
        ),
    ]
    grid = np.linspace(0.0, lengths[-1], 601)
    expected = toppra.algorithm.TOPPRA(constraints, path, gridpoints=grid).compute_trajectory()
    found = least_path_duration(motion, ROBOT, limits)
    assert found == pytest.approx(expected.duration, rel=0.01)
