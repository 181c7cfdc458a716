# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Inverse kinematics of whole trajectories against the joint angles that made the markers."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares
from support.arm import arm_robot

from mp_pca_planner.mocap.inverse_kinematics import (
    MarkerProblem,
    solve,
)
from mp_pca_planner.mocap.markers import MarkerPlacement
from mp_pca_planner.robot.model import Robot

PERIOD = 0.01
UNSMOOTHED = 0.0
ARM = (
    MarkerPlacement("elbow", "lower_arm", (0.0, 0.0, 0.0)),
    MarkerPlacement("upper", "upper_arm", (0.05, 0.0, -0.1)),
    MarkerPlacement("wrist", "wrist", (0.0, 0.0, 0.0)),
)


def motion(n_steps: int = 120) -> np.ndarray:
    t = np.linspace(0.0, 1.0, n_steps)[:, None]
    start, swing = np.array([-0.6, 0.2, 0.4, -1.2]), np.array([0.9, -0.5, 0.7, 0.8])
    return start + swing * np.sin(np.pi * t * np.array([1.0, 2.0, 1.5, 1.0])) * 0.8


@cache
def targets() -> np.ndarray:
    return places(arm_robot(), motion())


def places(robot: Robot, q: np.ndarray, markers: tuple[MarkerPlacement, ...] = ARM) -> np.ndarray:
    offsets = np.array([m.position for m in markers])
    return robot.attach_points([m.link for m in markers], offsets).positions_and_jacobians(q)[0]


@pytest.mark.parametrize("smoothness", [UNSMOOTHED, 1e-4])
def test_the_stated_sum_is_minimal_within_the_limits(smoothness: float) -> None:
    robot, limits, roots = arm_robot(), arm_robot().limits(), np.sqrt([1.0, 0.1, 0.5])
    markers = [replace(m, weight=float(x**2)) for m, x in zip(ARM, roots, strict=True)]
    noisy = targets()[:8] + 0.01 * np.random.default_rng(0).normal(size=(8, 3, 3))
    q = solve(MarkerProblem(robot, markers, noisy, smoothness), PERIOD)

    def stated(x: np.ndarray) -> np.ndarray:
        x = x.reshape(8, 4)
        errors = roots[:, None] * (places(robot, x) - noisy)
        accelerations = np.diff(x, n=2, axis=0) / PERIOD**2
        return np.concatenate([errors.ravel(), smoothness * accelerations.ravel()])

    bounds = np.tile(limits.lower, 8), np.tile(limits.upper, 8)
    oracle = least_squares(stated, motion()[:8].ravel(), bounds=bounds, xtol=1e-12, ftol=1e-12)
    np.testing.assert_allclose(q.ravel(), oracle.x, atol=1e-4)
    assert np.sum(stated(q.ravel()) ** 2) == pytest.approx(2.0 * oracle.cost, rel=1e-6)


def test_joint_limits_are_kept_where_markers_ask_for_more() -> None:
    robot = arm_robot()
    q_asked = motion()
    q_asked[40:80, 3] = 0.3  # an elbow bent the wrong way
    q = solve(MarkerProblem(robot, ARM, places(robot, q_asked)), PERIOD)
    limits = robot.limits()
    assert np.all(q >= limits.lower)
    assert np.all(q <= limits.upper)
    np.testing.assert_allclose(q[45:75, 3], limits.upper[3], atol=1e-6)
    np.testing.assert_allclose(q[:35], motion()[:35], atol=1e-2)


def test_frames_with_too_few_markers_are_gaps() -> None:
    seen = targets().copy()
    seen[20:25, 2] = np.nan  # nothing is left beyond the elbow
    seen[60] = np.nan
    seen[10:18, 1] = seen[90:95, 0] = np.nan  # the others fix the arm while it is bent
    q = solve(MarkerProblem(arm_robot(), ARM, seen, UNSMOOTHED), PERIOD)
    gaps = np.flatnonzero(np.isnan(q).any(axis=1))
    assert gaps.tolist() == [20, 21, 22, 23, 24, 60]
    np.testing.assert_allclose(np.delete(q, gaps, 0), np.delete(motion(), gaps, 0), atol=1e-6)


def test_turn_of_a_straight_arm_is_bridged_smoothly() -> None:
    # While the elbow is straight, elbow and wrist don't show shoulder3.
    q_true = np.tile([-0.6, 0.2, 0.0, 0.0], (60, 1))
    q_true[:, 2] = np.linspace(0.2, 0.8, 60)
    q_true[:20, 3] = q_true[40:, 3] = -0.8
    q_true[20:40, 3] = -1e-9
    robot, markers = arm_robot(), (ARM[0], ARM[2])
    q = solve(MarkerProblem(robot, markers, places(robot, q_true, markers)), PERIOD)
    np.testing.assert_allclose(q[:, 2], q_true[:, 2], atol=0.05)


def test_a_single_frame_and_two_are_solved() -> None:
    for n in (1, 2):
        q = solve(MarkerProblem(arm_robot(), ARM, targets()[:n]), PERIOD)
        np.testing.assert_allclose(q, motion()[:n], atol=1e-6)
