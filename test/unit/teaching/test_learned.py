# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What demonstrations teach: left-out errors, covered motions, and those that are least known."""

from __future__ import annotations

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_robot

from mp_pca_planner.exceptions import PlannerError
from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.differences import leave_one_out
from mp_pca_planner.recordings.demonstration import Demonstration
from mp_pca_planner.teaching.dialogue import Learned, remaining_covariance


def motion(goal: float, start: float = 0.0) -> Demonstration:
    """A motion of one joint from rest to rest, with a detour that depends on its goal."""
    s = np.linspace(0.0, 1.0, 101)
    q = start + (goal - start) * (10 * s**3 - 15 * s**4 + 6 * s**5) + goal * (s - s**2) ** 3
    v = np.gradient(q, s)
    curves = (q[:, None], v[:, None], np.gradient(v, s)[:, None])
    return Demonstration(("a",), s, *curves, recording="made up", start_time=0.0, end_time=1.0)


def test_errors_are_those_of_left_out_motions() -> None:
    motions = arm_demonstrations(6)
    learned = Learned.of(motions)
    expected = leave_one_out(motions, PrimitiveOptions()).rms()
    assert (learned.straight_error, learned.error) == (expected[0, 0], expected[2, 0])


def test_the_least_known_motion_is_in_the_gap_between_the_demonstrations() -> None:
    goals = [1.0, 1.1, 1.2, 1.3, 2.2, 2.3, 2.4, 2.5]
    learned = Learned.of([motion(goal) for goal in goals])
    np.testing.assert_allclose([learned.low, learned.high], [[1.0], [2.5]], atol=1e-12)
    (start,), (goal,) = learned.suggested[0]
    assert start == 0.0
    assert 1.5 < goal < 2.0
    assert not np.array_equal(learned.suggested[0], learned.suggested[1])


def test_more_demonstrations_cover_more() -> None:
    shares = [Learned.of(arm_demonstrations(n)).covered for n in (2, 6, 12)]
    assert 0.0 <= shares[0] < shares[1] < shares[2] <= 1.0


def test_suggested_goals_are_within_the_limits() -> None:
    robot, motions = arm_robot(), arm_demonstrations(6)
    limits = robot.limits()
    for _, goal in Learned.of(motions, limits).suggested:
        assert np.all((limits.lower <= goal) & (goal <= limits.upper))
    # No goal, demonstrated or new, flexes the elbow as much.
    tight = robot.limits({"elbow": {"max_position": float(limits.lower[3]) + 0.01}})
    assert Learned.of(motions, tight).suggested.shape == (0, 2, 4)


def test_one_motion_teaches_nothing_that_can_be_checked() -> None:
    with pytest.raises(PlannerError, match="there is no demonstration"):
        Learned.of(arm_demonstrations(1))


def test_remaining_covariance_is_that_of_the_joint_distribution() -> None:
    rng = np.random.default_rng(3)
    demonstrated, requests = rng.normal(size=(5, 4)), rng.normal(size=(3, 4))
    every = np.concatenate([demonstrated, requests])
    lengths = np.linalg.norm(every[:, None] - every, axis=2) / np.sqrt(every.var(axis=0).sum())
    r = np.sqrt(5.0) * lengths
    joint = (1.0 + r + r**2 / 3.0) * np.exp(-r) + np.diag([0.02] * 5 + [0.0] * 3)
    # The covariance of some, given the others, is the inverse of their block of the precision.
    expected = np.linalg.inv(np.linalg.inv(joint)[5:, 5:])
    found = remaining_covariance(demonstrated, requests)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_least_remains_at_a_demonstration_and_nearly_all_far_from_them() -> None:
    demonstrated = np.random.default_rng(4).normal(size=(6, 4))
    far = np.full((1, 4), 40.0)
    near, away = np.diag(remaining_covariance(demonstrated, np.vstack([demonstrated[:1], far])))
    assert 0.0 < near < 0.03
    assert 0.7 < away <= 1.0
