# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Sequences: joints, derivatives by finite differences, limits, and the command."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import trapezoid
from scipy.spatial.transform import Rotation
from support.arm import JOINTS, arm_demonstrations, arm_robot
from support.arm_plans import planner as arm_planner

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, SequenceGoal
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.context import Budget
from mp_pca_planner.planning.options import MODES, OPTIMAL, REAL_TIME
from mp_pca_planner.planning.plan import Plan
from mp_pca_planner.planning.planner import Planner
from mp_pca_planner.planning.program.compile import (
    Setting,
    compile_program,
    joined_motion,
    segment_basis,
)
from mp_pca_planner.planning.program.motion_program import MotionProgram
from mp_pca_planner.planning.resolve import resolve


def planner(max_solve_time: float = np.inf, **overrides: float) -> Planner:
    limits = dict.fromkeys(JOINTS, overrides) if overrides else {}
    return arm_planner(overrides=limits, max_solve_time=max_solve_time)


def configurations(n: int, seed: int = 0) -> list[np.ndarray]:
    """Ends of demonstrations, in any order."""
    ends = np.array([d.positions[k] for d in arm_demonstrations() for k in (0, -1)])
    return list(ends[np.random.default_rng(seed).choice(len(ends), n, replace=False)])


def request(n: int, times: tuple[float | None, ...] = ()) -> tuple[SequenceGoal, JointState]:
    """Through n configurations, from another one."""
    start, *targets = configurations(n + 1)
    return SequenceGoal(tuple(JointState(JOINTS, q) for q in targets), times), JointState(
        JOINTS, start
    )


def joints(plan: Plan) -> float:
    """Largest jump of position, velocity or acceleration between segments, from both sides."""
    jumps = []
    for before, after in pairwise(plan.motions):
        # Just inside of the ends, where polynomials are evaluated.
        tiny = 1e-13
        left = before.evaluate(np.array([before.duration * (1.0 - tiny)]))
        right = after.evaluate(np.array([after.duration * tiny]))
        jumps += [np.abs(x - y).max() for x, y in zip(left, right, strict=True)]
    return float(max(jumps))


@pytest.mark.parametrize("mode", MODES)
def test_motion_stops_where_asked_and_nowhere_else(mode: str) -> None:
    goal, start = request(4)
    goal = replace(goal, stops=(False, True, False, False))
    plan = planner().plan(goal, start, mode)
    assert plan.is_executable
    assert plan.mode == mode
    assert joints(plan) < 1e-9
    for number, motion in enumerate(plan.motions, start=1):
        rests = not np.any(motion.goal.velocities) and not np.any(motion.goal.accelerations)
        assert rests == (number in (2, 4))
    # After a stop, the past doesn't matter to what is joined without optimisation.
    half = SequenceGoal(goal.targets[2:])
    rest = planner().plan(half, JointState(JOINTS, goal.targets[1].positions), mode)
    if mode == REAL_TIME:
        for one, other in zip(plan.motions[2:], rest.motions, strict=True):
            np.testing.assert_allclose(one.goal.velocities, other.goal.velocities, atol=1e-9)
    passing = planner().plan(replace(goal, stops=()), start, mode)
    assert np.any(passing.motions[1].goal.velocities)


def test_optimal_takes_less_effort_in_the_same_time() -> None:
    goal, start = request(4)
    quick = planner().plan(goal, start, REAL_TIME)
    best = planner().plan(goal, start, OPTIMAL)
    assert best.trajectory.duration == pytest.approx(quick.trajectory.duration, rel=1e-9)
    assert best.effort_cost < quick.effort_cost
    efforts = best.trajectory.efforts
    assert efforts is not None
    integral = 0.5 * trapezoid(np.sum(efforts**2, axis=1), best.trajectory.times)
    assert best.effort_cost == pytest.approx(integral, rel=5e-3)


def chained(posed: bool, *, with_limits: bool) -> MotionProgram:
    """The program of a sequence with tight limits, bounded by them or not."""
    goal, start = with_poses() if posed else request(3)
    tight = planner(max_velocity=1.0, max_acceleration=4.0, max_jerk=20.0)
    context = tight._context
    (resolved,) = resolve(context, tight.primitives, goal, start, OPTIMAL, Budget(np.inf))
    bases = tuple(segment_basis(tight.options, resolved, one) for one in resolved.segments)
    joined = joined_motion(resolved, bases, [one.duration for one in resolved.segments])
    setting = Setting(bases, joined, resolved.naturalness, context.options.objectives)
    program = compile_program(context, resolved, setting)
    if with_limits:
        return program.constrained([[one.everywhere() for one in p] for p in program.constraints])
    return program.constrained([[] for _ in program.segments])


@pytest.mark.parametrize("posed", [False, True])
def test_derivatives_of_a_chain_agree_with_finite_differences(posed: bool) -> None:
    program = chained(posed, with_limits=True)
    rng, h = np.random.default_rng(0), 1e-5
    x = program.starts[0]
    x = x + 0.1 * rng.standard_normal(x.size)
    at = program.evaluate(x)
    every = np.arange(program.lower.size)
    for _ in range(5):
        step = rng.standard_normal(x.size)
        ahead, behind = (program.evaluate(x + sign * h * step) for sign in (1.0, -1.0))
        slope = (ahead.cost - behind.cost) / (2.0 * h)
        assert slope == pytest.approx(at.gradient @ step, rel=1e-4)
        slopes = (ahead.inequalities - behind.inequalities) / (2.0 * h)
        predicted = [at.inequalities_after(sign * h * step) for sign in (1.0, -1.0)]
        for found in (at.inequality_rows(every) @ step, (predicted[0] - predicted[1]) / (2.0 * h)):
            np.testing.assert_allclose(found, slopes, atol=1e-5 * np.abs(slopes).max())
        if posed:
            slopes = (ahead.equalities - behind.equalities) / (2.0 * h)
            np.testing.assert_allclose(at.equality_rows @ step, slopes, atol=1e-6)


def test_jerk_limits_are_kept_by_optimal_sequences() -> None:
    limits = {"max_velocity": 1.5, "max_acceleration": 8.0, "max_jerk": 80.0}
    for seed in range(4):
        start, *targets = (JointState(JOINTS, q) for q in configurations(4, seed))
        plan = planner(**limits).plan(SequenceGoal(tuple(targets)), start)
        assert (plan.status, plan.mode) == ("solved", OPTIMAL)
        assert not check_limits(plan.trajectory, arm_robot(), planner(**limits).limits).violations


def test_targets_where_the_robot_is_already_are_passed() -> None:
    goal, start = request(2)
    expected = planner().plan(replace(goal, stops=(True, False)), start)
    near = JointState(JOINTS, start.positions + 0.005)
    part = JointState(["elbow"], [start.positions[3]])
    here = wrist_pose(start.positions)
    stops = False, False, False, True, False
    plan = planner().plan(SequenceGoal((near, part, here, *goal.targets), stops=stops), start)
    assert np.array_equal(plan.trajectory.positions, expected.trajectory.positions)
    assert "targets 1 to 3 are left out" in plan.message
    with pytest.raises(GoalError, match="target 2 of the sequence is where the robot is"):
        planner().plan(SequenceGoal((near, near, *goal.targets), (None, 1.0, 2.0, 3.0)), start)
    there = goal.targets[0]
    with pytest.raises(GoalError, match="targets 2 and 3 of the sequence are the same"):
        planner().plan(SequenceGoal((near, there, there, goal.targets[1])), start)
    with pytest.raises(GoalError, match="target 2 position of joint 'elbow'"):
        planner().plan(SequenceGoal((near, JointState(["elbow"], [9.0]))), start)
    # A single one is a goal like any other.
    (one, same) = (
        planner().plan(goal, start)
        for goal in (SequenceGoal((there,), (2.0,)), JointGoal(there, 2.0))
    )
    assert np.array_equal(one.trajectory.positions, same.trajectory.positions)
    assert one.in_span_score == same.in_span_score


def wrist_pose(q: np.ndarray, *, turned: bool = False) -> Pose:
    """Where a configuration has the wrist."""
    points = arm_robot().attach_points(["wrist"] * 4, np.vstack([np.zeros(3), np.eye(3)]))
    (corners,), _ = points.positions_and_jacobians(q[None])
    axes = Rotation.from_matrix((corners[1:] - corners[0]).T)
    return Pose("wrist", corners[0], axes.as_quat() if turned else None)


def with_poses(*, turned: bool = False) -> tuple[SequenceGoal, JointState]:
    """Pose, configuration, pose, pose."""
    start, *ends = configurations(5, seed=3)
    first, last, final = (wrist_pose(ends[k], turned=turned) for k in (0, 2, 3))
    targets = (first, JointState(JOINTS, ends[1]), last, final)
    return SequenceGoal(targets, (None, 2.0, None, None)), JointState(JOINTS, start)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("turned", [False, True])
def test_poses_are_reached_on_the_way_and_at_the_end(mode: str, turned: bool) -> None:
    goal, start = with_poses(turned=turned)
    plan = planner().plan(goal, start, mode)
    assert plan.is_executable, plan.message
    assert plan.mode == mode
    assert joints(plan) < 1e-9
    assert max(plan.facts["via_error"], plan.goal_error) < 1e-6
    times = np.cumsum([motion.duration for motion in plan.motions])
    assert times[1] == pytest.approx(2.0, abs=1e-9)
    for target, moment in zip(goal.targets, times, strict=True):
        row = int(np.abs(plan.trajectory.times - moment).argmin())
        q = plan.trajectory.positions[row]
        if isinstance(target, Pose):
            reached = wrist_pose(q, turned=turned)
            np.testing.assert_allclose(reached.position, target.position, atol=1e-6)
            if turned:
                ways = Rotation.from_quat([reached.orientation, target.orientation])
                assert (ways[0].inv() * ways[1]).magnitude() < 1e-6
        else:
            assert np.array_equal(q, target.positions)


def test_bodies_that_meet_between_poses_are_found_and_avoided() -> None:
    robot, (start, *ends) = arm_robot(), configurations(3)
    goal = SequenceGoal(tuple(wrist_pose(q + 0.1) for q in ends))
    meets, careful = arm_planner(), arm_planner(collision=CollisionModel(robot))
    referee = CollisionModel(robot)
    assert referee.collisions(meets.plan(goal, start).trajectory)
    plan = careful.plan(goal, start)
    assert plan.is_executable and not referee.collisions(plan.trajectory)


def test_beyond_the_range_of_durations_no_pose_is_reached() -> None:
    program = chained(True, with_limits=False)
    for change in (-1e3, 1e3):
        x = program.starts[0] + change
        assert np.isnan(program.evaluate(x).cost)
        assert np.abs(program.equalities_at(x)).sum() == np.inf
