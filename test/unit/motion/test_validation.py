# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The one validator: limits of what the controller makes of the points, and its rules."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.interpolate import BPoly
from support.arm import JOINTS, arm_robot

from mp_pca_planner.exceptions import TrajectoryError
from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.interpolation import (
    BEZIER_POINTS,
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
from mp_pca_planner.robot.limits import JointLimits, merge_limits

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


def changed(trajectory, **fields):
    names = ("joint_names", "times", "positions", "velocities", "accelerations")
    return Trajectory(*(fields.get(name, getattr(trajectory, name)) for name in names))


def tightened(**values):
    """The arm's limits with those of its first joint overridden."""
    return arm_robot().limits({"shoulder1": values})


def judge(trajectory, limits=LIMITS, start=START, **options):
    check = check_limits(trajectory, arm_robot(), limits)
    check_executable(trajectory, check, JointState(JOINTS, start), **options)


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


@given(st.integers(0, 2**32 - 1), st.integers(0, 3))
def test_a_quintic_and_its_derivatives_lie_between_their_bezier_points(seed, order):
    ends = np.random.default_rng(seed).normal(size=6)
    points = BEZIER_POINTS[order, : 6 - order] @ ends
    curve = hermite_functions(np.linspace(0.0, 1.0, 101), order) @ ends
    assert points.min() - 1e-9 <= curve.min() and curve.max() <= points.max() + 1e-9
    # An independent library's curve through the same points.
    expected = BPoly(points[:, None], [0.0, 1.0])(np.linspace(0.0, 1.0, 101))
    np.testing.assert_allclose(curve, expected, atol=1e-9)


@pytest.mark.parametrize("duration", [1e-9, 1e-3, 2e-3, 0.1])
def test_a_leap_from_rest_to_rest_is_refused_however_short(duration):
    check = check_limits(reach(duration, 2), arm_robot(), LIMITS)
    assert {"velocity", "effort"} <= {violation.quantity for violation in check.violations}


def test_between_the_points_the_quintic_interpolation_is_judged():
    rng = np.random.default_rng(0)
    times = np.array([0.0, 0.11, 0.3, 0.35, 0.8])
    q, v, a = rng.normal(size=(3, 5, 4))
    dense = interpolate(Trajectory(JOINTS, times, q, v, a), 1e-3)
    assert np.diff(dense.times).max() <= 1e-3 + 1e-12
    # An independent library's polynomial through the same values and derivatives.
    curve = BPoly.from_derivatives(times, np.stack([q, v, a], axis=1))
    inner = ~np.isin(np.round(dense.times, 12), times)
    for order, found in enumerate((dense.q, dense.v, dense.a, dense.jerk)):
        expected = curve.derivative(order)(dense.times) if order else curve(dense.times)
        np.testing.assert_allclose(
            found[inner], expected[inner], atol=1e-9 * np.abs(expected).max()
        )


@pytest.mark.parametrize(
    ("limit", "closed_form"),
    [
        # Peaks of the minimum-jerk motion over distance D in time T.
        ("max_velocity", 1.875),
        ("max_acceleration", 10.0 / np.sqrt(3.0)),
        ("max_jerk", 60.0),
    ],
)
def test_peaks_are_found_to_be_those_of_the_closed_form(limit, closed_form):
    duration = 0.7
    power = {"max_velocity": 1, "max_acceleration": 2, "max_jerk": 3}[limit]
    peak = closed_form * abs(GOAL[0] - START[0]) / duration**power
    trajectory = reach(duration)
    for factor, accepted in ((1.0001, True), (0.999, False)):
        check = check_limits(trajectory, arm_robot(), tightened(**{limit: peak * factor}))
        assert (not check.violations) == accepted
        if not accepted:
            (violation,) = check.violations
            assert violation.joint == "shoulder1"
            assert limit.endswith(violation.quantity)
            assert check.worst_excess == pytest.approx(1.0 / factor - 1.0, abs=1e-4)


@pytest.mark.parametrize(("room", "touched"), [(1e-3, False), (1e-5, True)])
def test_a_limit_that_is_nearly_reached_is_told_but_not_broken(room, touched):
    # Minimum-jerk motions are fastest half-way, at 15/8 of the mean speed.
    fastest = 15.0 / 8.0 * abs(GOAL[0] - START[0])
    check = check_limits(reach(), arm_robot(), tightened(max_velocity=fastest * (1.0 + room)))
    assert not check.violations and check.worst_excess == 0.0
    found = [(one.quantity, one.joint) for one in check.touched]
    assert found == ([("velocity", "shoulder1")] if touched else [])


def test_a_limit_broken_only_between_the_points_is_seen():
    # Two points with opposite velocities: the motion bulges out between them.
    v = np.zeros((2, 4))
    v[:, 0] = 2.0, 0.0
    trajectory = Trajectory(JOINTS, [0.0, 0.5], np.tile(START, (2, 1)), v, np.zeros((2, 4)))
    highest = interpolate(trajectory).q[:, 0].max()
    assert highest > START[0] + 0.1
    limits = tightened(max_position=(START[0] + highest) / 2.0)
    (violation,) = check_limits(trajectory, arm_robot(), limits).violations
    assert violation.quantity == "position"
    assert violation.value == pytest.approx(highest)
    assert 0.0 < violation.time < 0.5


def test_efforts_are_computed_not_believed():
    trajectory = reach()
    lying = Trajectory(
        JOINTS,
        trajectory.times,
        trajectory.positions,
        trajectory.velocities,
        trajectory.accelerations,
        np.zeros((21, 4)),
    )
    dense = interpolate(trajectory)
    peak = np.abs(arm_robot().inverse_dynamics(dense.q, dense.v, dense.a)[:, 0]).max()
    check = check_limits(lying, arm_robot(), tightened(max_effort=0.9 * peak))
    assert check.violations[0].quantity == "effort"
    assert check.worst_excess == pytest.approx(1.0 / 0.9 - 1.0)


@pytest.mark.parametrize("duration", [0.02, 0.05, 0.09])
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


def test_the_present_state_must_be_the_first_point():
    with pytest.raises(TrajectoryError, match="present position of joint 'shoulder2'"):
        judge(reach(), start=START + np.array([0.0, 1e-6, 0.0, 0.0]))


def test_other_joints_than_those_of_the_state_are_refused():
    check = check_limits(reach(), arm_robot(), LIMITS)
    with pytest.raises(TrajectoryError, match="moves"):
        check_executable(reach(), check, JointState(JOINTS[::-1], START[::-1]))


def test_a_residue_of_velocity_at_the_end_is_refused_unless_allowed():
    trajectory = reach()
    v = trajectory.velocities.copy()
    v[-1, 3] = 1e-17
    with pytest.raises(TrajectoryError, match="ends with a velocity of 1e-17 of joint 'elbow'"):
        judge(changed(trajectory, velocities=v))
    judge(changed(trajectory, velocities=v), allow_nonzero_end_velocity=True)


def test_a_single_point_at_rest_passes_as_a_stop():
    judge(Trajectory(JOINTS, [0.0], START[None], np.zeros((1, 4)), np.zeros((1, 4))))


def test_without_limits_nothing_is_broken():
    check = check_limits(reach(0.01), arm_robot(), JointLimits(JOINTS, merge_limits()))
    assert check.violations == () and check.worst_excess == 0.0


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
