# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the planner chooses where nothing like a request was demonstrated."""

import numpy as np
import pytest
from support.arm import arm_primitive, arm_robot
from support.patience import EVER
from support.problems import random_ends

from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.plan import SOLVED
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.recordings.synthetic import generate_motions


def planned(ends, collision=None, duration=None, **options):
    robot = arm_robot()
    options = PlannerOptions(**{"max_solve_time": EVER, **options})
    subject = Planner(robot, [arm_primitive()], None, options, collision)
    return subject.plan(ends[1], ends[0], duration=duration)


def unlike(i=0):
    """Ends far from the demonstrations."""
    robot = arm_robot()
    start, goal, _ = random_ends(robot, robot.limits(), np.random.default_rng([7, i]))
    return start, goal


def like(i=0):
    motion = generate_motions(20, 123)[i]
    return motion.positions[[0, -1]]


@pytest.mark.parametrize("i", range(3))
def test_requests_like_the_demonstrations_are_planned_as_those_were_shown(i):
    plan = planned(like(i))
    shown = planned(like(i), naturalness=1.0, timing="demonstrated")
    assert plan.in_span_score < 3.0
    np.testing.assert_array_equal(plan.trajectory.positions, shown.trajectory.positions)


@pytest.mark.parametrize("i", range(3))
def test_other_requests_get_less_effort_in_no_more_time(i):
    plan = planned(unlike(i))
    shown = planned(unlike(i), naturalness=1.0, timing="demonstrated")
    assert plan.status == SOLVED and plan.in_span_score > 3.0
    assert plan.facts["naturalness"] == pytest.approx((3.0 / plan.in_span_score) ** 3)
    assert plan.effort_cost < shown.effort_cost
    assert plan.trajectory.duration <= shown.trajectory.duration * (1.0 + 1e-9)
