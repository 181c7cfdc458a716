# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Selection against scores computed one by one, and against what primitives were made from."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_primitive, arm_robot
from support.patience import PATIENT

from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal
from mp_pca_planner.planning import selection
from mp_pca_planner.planning.motion import Motion, Tables, cost_of, rank_of
from mp_pca_planner.planning.objectives import effort
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.selection import Selector
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.primitive import MovementPrimitive


def library() -> list[MovementPrimitive]:
    """Upward and downward motions apart, and a mixture."""
    motions = arm_demonstrations(24)
    rises = [m.positions[-1, 1] > m.positions[0, 1] for m in motions]
    parts = {
        "up": [m for m, up in zip(motions, rises, strict=True) if up],
        "down": [m for m, up in zip(motions, rises, strict=True) if not up],
        "mixed": list(motions),
    }
    options = PrimitiveOptions(n_components=3)
    return [build_primitive(part, name, options) for name, part in parts.items()]


def scores_of(primitives: list[MovementPrimitive], *ends: np.ndarray) -> np.ndarray:
    """In-span scores, one by one."""
    return np.array([one.model.predict(*ends).in_span_score for one in primitives])


def test_the_least_score_is_that_of_the_nearest_primitive() -> None:
    primitives = library()
    selector = Selector(arm_robot(), primitives)
    for motion in arm_demonstrations(6, 9):
        start, goal = motion.positions[[0, -1]]
        single = [one.model.predict(start, goal, 0.4).in_span_score for one in primitives]
        assert selector.least_score(start, goal, 0.4) == pytest.approx(min(single), rel=1e-9)


def test_primitives_whose_demonstrations_are_far_away_are_not_compiled() -> None:
    primitives, compared = library(), 0
    selector = Selector(arm_robot(), primitives)
    requests = [motion.positions[[0, -1]] for motion in arm_demonstrations(10, 9)]
    requests += [one.model.mean[:8].reshape(2, 4) for one in primitives]  # score 0
    for ends in requests:
        scores = scores_of(primitives, *ends)
        compiled, _ = selector.choose(*ends)
        limit = max(1.25 * scores.min(), 1.0)
        assert len(compiled) == np.count_nonzero(scores <= limit)
        assert all(c.expected.in_span_score <= limit for c in compiled)
        compared += len(compiled) > np.count_nonzero(scores <= 1.25 * scores.min())
    assert compared


def test_those_considered_are_in_the_order_of_their_expected_effort() -> None:
    robot = arm_robot()
    selector = Selector(robot, library())
    n_several = 0
    for motion in arm_demonstrations(10, 9):
        start, goal = motion.positions[[0, -1]]
        found, _ = selector.choose(start, goal)
        if len(found) == 1:
            continue
        n_several += 1
        ends = JointState(robot.joint_names, start), JointState(robot.joint_names, goal)
        efforts = []
        for one in found:
            basis, expected = one.primitive.basis, one.expected
            motion = Motion(*ends, expected.duration, basis, expected.weights)
            efforts.append(cost_of(robot, motion, Tables(basis), [(1.0, effort)]))
        assert efforts == sorted(efforts)
        assert [c.cost for c in found] == pytest.approx(efforts, rel=1e-9)
    assert n_several


def test_contenders_are_those_whose_expected_costs_are_near_the_least(monkeypatch) -> None:
    n_close = []
    for usual_error in (0.0, 0.01, 0.5):
        monkeypatch.setattr(selection, "_USUAL_ERROR", usual_error)
        selector = Selector(arm_robot(), library())
        start, goal = arm_demonstrations(10, 9)[0].positions[[0, -1]]
        compiled, contenders = selector.choose(start, goal)
        costs = [one.cost for one in compiled]
        near = [cost for cost in costs if cost <= (1.0 + usual_error) * costs[0]]
        assert [one.cost for one in contenders] == near[:5]
        n_close.append(len(near))
    assert n_close[0] == 1
    assert n_close[-1] > 1


def test_the_plan_is_the_cheapest_of_those_with_each_contender() -> None:
    robot, primitives = arm_robot(), library()
    planner = Planner(robot, primitives, robot.limits(), PATIENT)
    n_contested = 0
    for motion in arm_demonstrations(6, 9):
        start, goal = (JointState(robot.joint_names, q) for q in motion.positions[[0, -1]])
        _, contenders = Selector(robot, primitives).choose(start.positions, goal.positions)
        plan = planner.plan(JointGoal(goal), start)
        names = [c.primitive.name for c in contenders]
        named = [planner.plan(JointGoal(goal, primitive=name), start) for name in names]
        cheapest = min(named, key=lambda one: one.solution.cost)
        assert plan.primitive == cheapest.primitive
        assert plan.solution.cost == pytest.approx(cheapest.solution.cost, rel=1e-6)
        n_contested += len(names) > 1
    assert n_contested


def test_a_pose_and_the_shortest_duration_are_planned_with_the_first_alone() -> None:
    robot, primitives = arm_robot(), library()
    start, goal = arm_demonstrations(6, 9)[4].positions[[0, -1]]
    here = JointState(robot.joint_names, start)
    pose = Pose("wrist", robot.frame_positions(goal[None], ["wrist"])[0, 0])
    shortest = replace(PATIENT, timing="shortest")
    for request, options in (
        (PoseGoal(pose), PATIENT),
        (JointGoal(JointState(robot.joint_names, goal)), shortest),
    ):
        plan = Planner(robot, primitives, robot.limits(), options).plan(request, here)
        _, (first, *_) = Selector(robot, primitives).choose(start, plan.motion.goal.positions)
        assert plan.is_executable and plan.primitive == first.primitive.name


def test_the_only_primitive_is_not_compiled_to_be_chosen() -> None:
    robot = arm_robot()
    motion = arm_demonstrations(6, 9)[0]
    start, goal = (JointState(robot.joint_names, q) for q in motion.positions[[0, -1]])
    (one,), _ = Selector(robot, [arm_primitive()]).choose(start.positions, goal.positions)
    assert np.isnan(one.cost)


def test_score_does_not_depend_on_whole_turns_of_a_joint_that_turns_without_end() -> None:
    robot = arm_robot()
    robot.continuous = np.array([True, False, False, False])
    selector = Selector(robot, library())
    motion = arm_demonstrations(6, 9)[0]
    turn = np.array([2.0 * np.pi, 0.0, 0.0, 0.0])
    here = selector.least_score(motion.positions[0], motion.positions[-1])
    there = selector.least_score(motion.positions[0] + turn, motion.positions[-1] + turn)
    assert there == pytest.approx(here, rel=1e-9)


def test_costs_that_are_not_numbers_come_last_in_a_ranking() -> None:
    assert sorted([np.nan, 2.0, 1.0, np.inf], key=rank_of)[:2] == [1.0, 2.0]


def test_primitives_that_are_too_far_are_chosen_only_if_all_are() -> None:
    primitives, robot = library(), arm_robot()
    for motion in arm_demonstrations(10, 9):
        ends = motion.positions[0], motion.positions[-1]
        scores = scores_of(primitives, *ends)
        strict = Selector(robot, primitives, max_score=float(scores.min()) + 1e-9)
        (only,), _ = strict.choose(*ends)
        assert only.expected.in_span_score == pytest.approx(scores.min())
        none = Selector(robot, primitives, max_score=0.5 * float(scores.min()))
        (first, *_), _ = none.choose(*ends)
        assert first.expected.in_span_score == pytest.approx(scores.min())
