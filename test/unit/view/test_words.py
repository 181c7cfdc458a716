# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The words of the page."""

from dataclasses import replace

import pytest
from support.arm import JOINTS, arm_primitive, arm_robot

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.view.content import first_ends

pytest.importorskip("viser", reason="the extra 'view' is not installed")
from mp_pca_planner.view.planning import PlanAnswer, ViewRequest, answer_html

START, GOAL = first_ends(arm_primitive(), arm_robot().limits())


def answer(**changes) -> PlanAnswer:
    plan = Planner(arm_robot(), [arm_primitive()]).plan(GOAL, JointState(JOINTS, START))
    whole = PlanAnswer(ViewRequest(START, GOAL), GOAL, plan, "", 0.01)
    return replace(whole, **changes)


def test_text_from_files_is_no_markup():
    shown = answer_html(answer(problem="<script>alert(1)</script>\u202e"))
    assert "<script>" not in shown and "\u202e" not in shown
