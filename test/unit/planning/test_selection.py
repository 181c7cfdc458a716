# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Selection against scores computed one by one, and against what primitives were made from."""

import pytest
from support.arm import arm_demonstrations, arm_robot
from support.patience import PATIENT

from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.planning.context import Context
from mp_pca_planner.planning.options import PlannerOptions
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.resolve import choose
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.library import PrimitiveLibrary
from mp_pca_planner.robot.model import Robot


def context_of(robot: Robot, max_in_span_score: float = 0.0) -> Context:
    options = PlannerOptions(max_in_span_score=max_in_span_score)
    return Context(robot, robot.limits(), options, None, 600.0)


def library() -> PrimitiveLibrary:
    """Upward and downward motions apart, and a mixture."""
    motions = arm_demonstrations(24)
    rises = [m.positions[-1, 1] > m.positions[0, 1] for m in motions]
    parts = {
        "up": [m for m, up in zip(motions, rises, strict=True) if up],
        "down": [m for m, up in zip(motions, rises, strict=True) if not up],
        "mixed": list(motions),
    }
    options = PrimitiveOptions(n_components=3)
    return PrimitiveLibrary([build_primitive(part, name, options) for name, part in parts.items()])


def test_the_plan_is_the_cheapest_of_those_with_each_contender() -> None:
    robot, primitives = arm_robot(), library()
    planner = Planner(robot, primitives, robot.limits(), PATIENT)
    n_contested = 0
    for motion in arm_demonstrations(6, 9):
        start, goal = (JointState(robot.joint_names, q) for q in motion.positions[[0, -1]])
        contenders = choose(context_of(robot), primitives, start.positions, goal.positions)
        plan = planner.plan(JointGoal(goal), start)
        names = [primitive.name for primitive, _ in contenders]
        named = [planner.plan(JointGoal(goal, primitive=name), start) for name in names]
        cheapest = min(named, key=lambda one: one.solution.cost)
        assert plan.primitive == cheapest.primitive
        assert plan.solution.cost == pytest.approx(cheapest.solution.cost, rel=1e-6)
        n_contested += len(names) > 1
    assert n_contested


def test_primitives_that_are_too_far_are_chosen_only_if_all_are() -> None:
    primitives, robot = library(), arm_robot()
    for motion in arm_demonstrations(6, 9):
        ends = motion.positions[0], motion.positions[-1]
        least = min(one.model.predict(*ends).in_span_score for one in primitives)
        ((_, only),) = choose(context_of(robot, least + 1e-9), primitives, *ends)
        (_, first), *_ = choose(context_of(robot, 0.5 * least), primitives, *ends)
        for found in (only, first):
            assert found.in_span_score == pytest.approx(least)
