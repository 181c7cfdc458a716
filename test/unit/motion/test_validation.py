# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The one validator: limits of what the controller makes of the points, and its rules."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from support.arm import JOINTS, arm_robot

from mp_pca_planner.exceptions import TrajectoryError
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.interpolation import (
    boundary_values,
    hermite_functions,
    interpolate,
)
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.motion.validation import (
    LIMIT_NEAR,
    START_TOLERANCE,
    check_executable,
    check_limits,
)
from mp_pca_planner.robot.limits import JointLimits

START = np.array([-0.2, 0.1, 0.0, -0.4])
GOAL = np.array([-1.2, 0.3, 0.4, -1.0])
LIMITS = arm_robot().limits()


def reach(duration=1.0, n_steps=21, start=START, goal=GOAL):
    """A minimum-jerk reach."""
    zero = np.zeros(4)
    values = boundary_values((start, zero, zero), (goal, zero, zero), duration)
    s = np.linspace(0.0, 1.0, n_steps)
    q, v, a = (hermite_functions(s, d) @ values / duration**d for d in range(3))
    v[[0, -1]] = a[[0, -1]] = 0.0
    q[0], q[-1] = start, goal
    return Trajectory(JOINTS, duration * s, q, v, a)


def tightened(**values):
    """The arm's limits with those of its first joint overridden."""
    return arm_robot().limits({"shoulder1": values})


def peaks_of(quantity, trajectory):
    """The largest magnitudes on the grid, shape (n_joints,); of positions the largest."""
    fine = min(1e-3, trajectory.duration / 400)
    dense = interpolate(trajectory, fine if quantity == "effort" else 1e-3)
    if quantity == "position":
        return dense.q.max(axis=0)
    if quantity == "effort":
        return np.abs(arm_robot().inverse_dynamics(dense.q, dense.v, dense.a)).max(axis=0)
    values = {"velocity": dense.v, "acceleration": dense.a, "jerk": dense.jerk}[quantity]
    return np.abs(values).max(axis=0)


@pytest.mark.parametrize("quantity", ["position", "velocity", "acceleration", "jerk", "effort"])
@given(
    st.integers(2, 5),
    st.floats(-3.0, -0.3),
    st.floats(-4.0, 0.5),
    st.floats(-1e-3, 1e-3),
    st.integers(0, 2**32 - 1),
)
@settings(max_examples=300, deadline=None)
def test_limits_are_judged_as_on_the_whole_grid(
    quantity, n_points, log_step, log_size, excess, seed
):
    """However wild a motion is, and however near to the limits."""
    assume(abs(excess + LIMIT_NEAR) > 1e-9)
    rng = np.random.default_rng(seed)
    times = np.concatenate([[0.0], np.cumsum(10.0**log_step * rng.uniform(0.5, 1.5, n_points - 1))])
    size = 10.0**log_size * 10.0 ** (-log_step * np.arange(3))
    q, v, a = size[:, None, None] * rng.normal(size=(3, n_points, 4))
    trajectory = Trajectory(JOINTS, times, q, v, a)
    peaks = peaks_of(quantity, trajectory)
    # Without another end a range counts as 1 rad long.
    bounds = peaks - excess if quantity == "position" else peaks / (1.0 + excess)
    # Starts slightly outside have their own tests.
    assume(quantity != "position" or np.all(abs(q[0] - bounds) > START_TOLERANCE))
    limits = {name: {f"max_{quantity}": bound} for name, bound in zip(JOINTS, bounds, strict=True)}
    found = check_limits(trajectory, arm_robot(), JointLimits(JOINTS, limits)).touched
    assert len(found) == (4 if excess > -LIMIT_NEAR else 0)
    for violation in found:
        assert violation.quantity == quantity
        # The grid of the check may be evaluated in another order: one rounding error apart.
        peak = abs(peaks[JOINTS.index(violation.joint)])
        assert abs(violation.value) == pytest.approx(peak, rel=1e-15)


@pytest.mark.parametrize("duration", [1e-9, 1e-3, 2e-3, 0.1])
def test_a_leap_from_rest_to_rest_is_refused_however_short(duration):
    check = check_limits(reach(duration, 2), arm_robot(), LIMITS)
    assert {"velocity", "effort"} <= {violation.quantity for violation in check.violations}


def test_efforts_are_computed_not_believed():
    trajectory = reach()
    peak = peaks_of("effort", trajectory)[0]
    lying, limits = trajectory.with_efforts(np.zeros((21, 4))), tightened(max_effort=0.9 * peak)
    check = check_limits(lying, arm_robot(), limits)
    assert check.violations[0].quantity == "effort"
    assert check.worst_excess == pytest.approx(1.0 / 0.9 - 1.0, abs=1e-4)


@pytest.mark.parametrize("duration", [0.02, 0.09])
def test_efforts_of_short_motions_are_known_between_the_points(duration):
    random = np.random.default_rng(0)
    for _ in range(40):
        start, goal = random.uniform(-1.0, 1.0, (2, 4))
        trajectory = reach(duration, 1 + round(duration / 0.01), start, goal)
        dense = interpolate(trajectory, 1e-5)
        peak = np.abs(arm_robot().inverse_dynamics(dense.q, dense.v, dense.a)).max(axis=0)
        bounds = dict(zip(JOINTS, ({"max_effort": float(x)} for x in 0.9 * peak), strict=True))
        check = check_limits(trajectory, arm_robot(), arm_robot().limits(bounds))
        excess = [one.excess for one in check.touched if one.quantity == "effort"]
        np.testing.assert_allclose(excess, 1.0 / 0.9 - 1.0, atol=1e-4)
        assert len(excess) == 4


def test_a_motion_must_start_at_the_present_state_and_end_at_rest():
    trajectory, check = reach(), check_limits(reach(), arm_robot(), LIMITS)
    v = trajectory.velocities.copy()
    v[-1, 3] = 1e-17
    columns = trajectory.times, trajectory.positions, v, trajectory.accelerations
    moving, here = Trajectory(JOINTS, *columns), JointState(JOINTS, START)
    elsewhere = JointState(JOINTS, START + np.array([0, 1e-6, 0, 0]))
    fast = check_limits(reach(0.01), arm_robot(), LIMITS)
    for motion, judged, start, message in (
        (trajectory, check, elsewhere, "position of joint 'shoulder2'"),
        (trajectory, check, JointState(JOINTS[::-1], START[::-1]), "moves"),
        (moving, check, here, "ends with a velocity of 1e-17 of joint 'elbow'"),
        (reach(0.01), fast, here, ", limit "),
    ):
        with pytest.raises(TrajectoryError, match=message):
            check_executable(motion, judged, start)
    check_executable(moving, check, here, allow_nonzero_end_velocity=True)
    still = Trajectory(JOINTS, [0.0], START[None], np.zeros((1, 4)), np.zeros((1, 4)))
    check_executable(still, check_limits(still, arm_robot(), LIMITS), here)
    free = check_limits(reach(0.01), arm_robot(), JointLimits(JOINTS, {}))
    assert free.violations == () and free.worst_excess == 0.0


# Starts slightly outside the limits of position


def through(*positions, side):
    """Positions of the first joint relative to a limit at 0, 1 s apart and at rest at each."""
    q = np.tile(START, (len(positions), 1))
    q[:, 0] = side * np.array(positions)
    bounds = {"min_position": 0.0, "max_position": 2.0}
    if side < 0:
        bounds = {"min_position": -2.0, "max_position": 0.0}
    zero = np.zeros_like(q)
    trajectory = Trajectory(JOINTS, np.arange(float(len(q))), q, zero, zero)
    return check_limits(trajectory, arm_robot(), tightened(**bounds))


@pytest.mark.parametrize("side", [1, -1])
@given(outside=st.floats(1e-9, START_TOLERANCE), path=st.lists(st.floats(0.0, 1.0), min_size=1))
def test_motion_may_start_slightly_outside_and_lead_inwards(side, outside, path):
    check = through(-outside, *path, side=side)
    assert not check.violations and check.worst_excess <= 1e-9
    assert "'shoulder1' starts" in check.remark


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize(
    "path",
    [
        (-1.01 * START_TOLERANCE, 0.5),  # too far
        (-5e-4, -6e-4, 0.5),  # further out first
        (-5e-4, -2e-4, -3e-4, 0.5),  # in, and out again before it is inside
        (-5e-4, 0.5, -1e-4, 0.5),  # out again later
        (0.0, -1e-4, 0.5),  # out from within
        (0.5, -1e-4),
    ],
)
def test_motion_outside_the_limits_may_do_nothing_else(side, path):
    check = through(*path, side=side)
    (worst, *_) = check.violations
    assert (worst.quantity, worst.joint, worst.limit) == ("position", "shoulder1", 0.0)
    assert not check_limits(reach(), arm_robot(), LIMITS).remark


def test_start_outside_may_not_move_outwards():
    """A quadratic from -5e-4 that first falls by 1e-4."""
    times = np.linspace(0.0, 1.0, 101)
    q, v, a = (np.zeros((101, 4)) for _ in range(3))
    q[:, 0], v[:, 0], a[:, 0] = -5e-4 - 0.02 * times + times**2, -0.02 + 2.0 * times, 2.0
    check = check_limits(Trajectory(JOINTS, times, q, v, a), arm_robot(), tightened(min_position=0))
    assert check.violations[0].quantity == "position"
