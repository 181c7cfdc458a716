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
    in_span_words,
    limit_shares,
)
from mp_pca_planner.view.stage import BAD, GOOD, WARNING, part

START, GOAL = first_ends(arm_primitive(), arm_robot().limits())


def answer(**changes) -> PlanAnswer:
    plan = Planner(arm_robot(), [arm_primitive()]).plan(GOAL, JointState(JOINTS, START))
    whole = PlanAnswer(ViewRequest(START, GOAL), GOAL, plan, "", 0.01)
    return replace(whole, **changes)


def test_scores_get_worse_words_as_they_grow():
    words = [in_span_words(score) for score in (0.5, 1.0, 2.0, 10.0)]
    assert words[0] == words[1] == "like the demonstrations"
    assert "edge" in words[2] and "unlike" in words[3]


def test_a_plan_states_its_figures_and_a_refusal_its_reason():
    good = answer()
    assert f"{good.plan.duration:.2f} s" in answer_html(good) and GOOD in answer_html(good)
    refused = answer_html(answer(problem="the goal is in the wall"))
    assert "the goal is in the wall" in refused and BAD in refused and GOOD not in refused


def test_a_goal_out_of_reach_says_how_far_the_motion_ends_from_it():
    shown = answer_html(answer(distance=0.123))
    assert "Out of reach" in shown and "123 mm" in shown and WARNING in shown
    assert "orientation" in answer_html(answer(distance=1e-9))


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


def test_a_bar_fills_up_to_its_share_and_is_red_beyond_the_limit():
    assert "width:25%" in part("bar", 0.25) and GOOD in part("bar", 0.25)
    assert "width:100%" in part("bar", 1.7) and BAD in part("bar", 1.7)
