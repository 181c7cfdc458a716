# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The words and bars of the page."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.motion.trajectory import Trajectory
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.robot.limits import JointLimits
from mp_pca_planner.view.content import first_ends

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view.planning import (
    PlanAnswer,
    ViewRequest,
    answer_html,
    limit_shares,
)

START, GOAL = first_ends(arm_primitive(), arm_robot().limits())


def answer(**changes) -> PlanAnswer:
    plan = Planner(arm_robot(), [arm_primitive()]).plan(GOAL, JointState(JOINTS, START))
    whole = PlanAnswer(ViewRequest(START, GOAL), GOAL, plan, "", 0.01)
    return replace(whole, **changes)


def test_text_from_files_is_no_markup():
    shown = answer_html(answer(problem="<script>alert(1)</script>\u202e"))
    assert "<script>" not in shown and "\u202e" not in shown


def test_shares_of_limits():
    limits = JointLimits(
        ["a", "b"],
        {
            "a": {
                "min_position": -1.0,
                "max_position": 3.0,
                "max_velocity": 3.0,
                "max_jerk": 120.0,
            },
            "b": {"max_velocity": 4.0, "max_effort": 8.0},
        },
    )
    # Minimum jerk in 1 s: its speed is 15/8 in the middle, its jerk 60 at the ends.
    rest = np.zeros((2, 2))
    moved = Trajectory(
        ["a", "b"], [0.0, 1.0], [[1.0, 0.0], [2.0, 9.0]], rest, rest, [[0.0, 6.0], [0.0, -2.0]]
    )
    shares = limit_shares(moved, limits)
    np.testing.assert_allclose(shares["position"], [0.5, 0.0])
    np.testing.assert_allclose(shares["velocity"], np.array([1.0, 9.0]) * 15 / 8 / [3.0, 4.0])
    np.testing.assert_allclose(shares["jerk"], [0.5, 0.0])
    np.testing.assert_allclose(shares["torque"], [0.0, 0.75])
    assert set(shares) == {"position", "velocity", "jerk", "torque"}
