# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions are no faster than the demonstrations unless that is asked for."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.arm_plans import planner, request

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.demonstrated import demonstrated_limits


def far_goal() -> tuple[JointGoal, JointState]:
    """A goal from rest to rest that no demonstration is like."""
    low, high = arm_robot().limits().lower, arm_robot().limits().upper
    start, goal = low + 0.05 * (high - low), low + 0.9 * (high - low)
    return JointGoal(JointState(JOINTS, goal)), JointState(JOINTS, start)


@pytest.mark.parametrize("case", [far_goal, lambda: request(3)])
@pytest.mark.parametrize("naturalness", [None, 1e-3])
def test_no_joint_is_faster_than_it_was_demonstrated(case, naturalness):
    goal, start = case()
    options = {"naturalness": naturalness}
    plan = planner(demonstrated_margin=1.1, **options).plan(goal, start)
    assert plan.is_executable, plan.message
    _, v, a = plan.trajectory.states
    careful, _ = demonstrated_limits(arm_robot(), [arm_primitive()], arm_robot().limits(), 1.1)
    for values, bound in ((v, careful.velocity), (a, careful.acceleration)):
        assert np.all(np.abs(values) <= bound * (1.0 + 1e-4))
    free = planner(demonstrated_margin=0.0, **options).plan(goal, start)
    assert free.duration <= plan.duration * (1.0 + 1e-9)


def test_shortest_keeps_demonstrated_accelerations_only_where_there_is_no_limit():
    goal, start = request(3)
    _, usual = demonstrated_limits(arm_robot(), [arm_primitive()], arm_robot().limits(), 1.2)
    plan = planner(timing="shortest").plan(goal, start)
    peaks = np.abs(plan.trajectory.accelerations).max(axis=0)
    assert np.all(peaks <= usual.acceleration * (1.0 + 1e-4))
    own = {name: {"max_acceleration": 100.0} for name in JOINTS}
    quicker = planner(timing="shortest", overrides=own)
    assert quicker.default_accelerations == {}
    assert quicker.plan(goal, start).duration < plan.duration
    asked = JointGoal(goal.state, 0.8 * plan.duration)
    assert planner().plan(asked, start).duration == pytest.approx(0.8 * plan.duration)
