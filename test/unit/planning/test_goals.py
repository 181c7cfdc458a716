# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the planner can be asked: poses, durations, objectives, and more than the span."""

import runpy
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog
from support.arm import JOINTS, arm_primitive, arm_robot
from support.arm_plans import planner, request

from mp_pca_planner.exceptions import GoalError
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointGoal, JointState, Pose, PoseGoal
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.configurations import configurations_at, starts_near
from mp_pca_planner.planning.objectives import effort, jerk, straightness, time
from mp_pca_planner.planning.plan import SOLVED
from mp_pca_planner.primitives.basis import BSplineBasis

HAND = "wrist"
EXAMPLE = Path(__file__).resolve().parents[3] / "examples/own_objective.py"


@cache
def model():
    """The arm as Pinocchio itself reads it."""
    return pin.buildModelFromUrdf(str(config_file("human_arm.urdf")))


def placement(q):
    """Position and quaternion of the hand."""
    data = model().createData()
    pin.framesForwardKinematics(model(), data, np.asarray(q))
    frame = data.oMf[model().getFrameId(HAND)]
    return frame.translation.copy(), pin.Quaternion(frame.rotation).coeffs()


def pose_at(q, *, full):
    position, orientation = placement(q)
    return Pose(HAND, position, orientation if full else None)


def kept(plan):
    return not check_limits(plan.trajectory, arm_robot(), arm_robot().limits()).violations


def test_a_robot_that_rests_at_its_goal_gets_no_motion():
    _, start = request(0)
    here, subject = start.positions, planner()
    there = JointState(JOINTS, here)
    near = JointState(JOINTS, here + 5e-5)
    aims = [there, near, {"elbow": here[3]}, pose_at(here, full=True), [there], [near, there]]
    for aim in aims:
        plan = subject.plan(aim, start)
        assert plan.status == "already_there" and "already there" in str(plan)
        assert plan.trajectory.positions.tolist() == [here.tolist()]
        assert not (plan.is_executable or plan.duration)
    moving = JointState(JOINTS, here, [0.0, 0.0, 0.0, 0.1])
    for aim, begin in ((JointState(JOINTS, here + 1e-3), start), (there, moving)):
        assert subject.plan(aim, begin).is_executable


@pytest.mark.parametrize("full", [True, False])
def test_a_pose_is_reached_to_1e_6_within_the_limits(full):
    subject = planner()
    for i in range(8):
        goal, start = request(i)
        pose = pose_at(goal.state.positions, full=full)
        plan = subject.plan(PoseGoal(pose), start)
        assert plan.is_executable, plan.message
        position, orientation = placement(plan.trajectory.positions[-1])
        assert np.abs(position - pose.position).max() <= 1e-6
        if full:
            assert abs(orientation @ pose.orientation) >= 1.0 - 1e-12
        assert plan.goal_error <= 1e-6
        assert np.all(plan.trajectory.velocities[-1] == 0.0)
        assert kept(plan)


def test_a_free_elbow_is_placed_for_less_cost_than_inverse_kinematics_alone_gives():
    subject = planner(naturalness=0.003)
    gains, score = [], arm_primitive().model.predict
    for i in range(4):
        goal, start = request(i)
        pose = pose_at(goal.state.positions, full=False)
        plan = subject.plan(PoseGoal(pose, duration=0.9), start)
        ends, robot = arm_primitive().boundary_states[:, 3], arm_robot()
        begins = [*starts_near(robot, pose, ends, 12), start.positions]
        found = configurations_at(robot, robot.limits(), pose, begins)
        scores = [score(start.positions, q, 0.9).in_span_score for q in found]
        natural = found[int(np.argmin(scores))]
        fixed = subject.plan(JointGoal(JointState(JOINTS, natural), 0.9), start)
        gains.append(plan.solution.cost / fixed.solution.cost)
    assert max(gains) < 0.999


def test_of_the_configurations_like_the_demonstrations_a_pose_takes_the_cheapest():
    subject, robot = planner(naturalness=1.0), arm_robot()
    ends, ratios = arm_primitive().boundary_states[:, 3], []
    for i in range(4):
        goal, start = request(i)
        pose = pose_at(goal.state.positions, full=False)
        plan = subject.plan(PoseGoal(pose), start)
        begins = [*starts_near(robot, pose, ends, 12), start.positions]
        found = configurations_at(robot, robot.limits(), pose, begins)
        fixed = [subject.plan(JointGoal(JointState(JOINTS, q)), start) for q in found]
        natural = [one.cost for one in fixed if one.in_span_score <= 3.0 and one.is_executable]
        assert len(natural) > 1 and plan.in_span_score <= 3.0
        ratios.append(plan.cost / min(natural))
    assert max(ratios) < 1.02


def test_a_pose_out_of_reach_is_refused_with_how_near_it_comes():
    _, start = request()
    with pytest.raises(
        GoalError, match="brings 'wrist' to the pose; the nearest one found is .* m"
    ):
        planner().plan(PoseGoal(Pose(HAND, [5.0, 0.0, 0.0])), start)


def test_the_shortest_duration_is_feasible_and_clearly_shorter_ones_are_not():
    for i in range(2):
        goal, start = request(i)
        plan = planner(timing="shortest", demonstrated_margin=0.0).plan(goal, start)
        assert plan.status == SOLVED and kept(plan)
        shortest = plan.duration
        patient = planner(naturalness=0.01)
        assert patient.plan(request(i, duration=1.05 * shortest)[0], start).is_executable
        assert not patient.plan(request(i, duration=0.6 * shortest)[0], start).is_executable


def test_a_free_duration_is_where_the_cost_is_least():
    goal, start = request(3)
    free = planner(timing="free").plan(goal, start)
    assert free.status == SOLVED
    for factor in (0.97, 1.03):
        nearby = planner().plan(request(3, duration=factor * free.motion.duration)[0], start)
        assert free.solution.effort_cost <= nearby.solution.effort_cost * (1.0 + 1e-3)


def test_time_that_costs_makes_motions_shorter():
    goal, start = request(3)
    durations = [
        planner(timing="free", demonstrated_margin=0.0, objectives=((1.0, effort), (weight, time)))
        .plan(goal, start)
        .motion.duration
        for weight in (1e-3, 20.0, 200.0)
    ]
    assert durations == sorted(durations, reverse=True)
    assert durations[-1] < 0.8 * durations[0]


def test_each_objective_is_lowered_by_asking_for_it():
    goal, start = request(5)

    def hand_off_line(plan):
        points = np.array([placement(q)[0] for q in plan.trajectory.positions])
        line = (points[-1] - points[0]) / np.linalg.norm(points[-1] - points[0])
        way = points - points[0]
        return float(np.sqrt(np.mean((way - np.outer(way @ line, line)) ** 2)))

    def mean_jerk(plan):
        a = plan.trajectory.accelerations
        return float(np.mean(np.gradient(a, plan.trajectory.times, axis=0) ** 2))

    bold = partial(planner, naturalness=1e-3, demonstrated_margin=0.0)
    least_effort = bold().plan(goal, start)
    smooth = bold(objectives=((1.0, jerk),)).plan(goal, start)
    near_line = partial(straightness, frame=HAND)
    straight = bold(objectives=((1.0, near_line),)).plan(goal, start)
    assert mean_jerk(smooth) < mean_jerk(least_effort)
    assert hand_off_line(straight) < 0.5 * hand_off_line(least_effort)
    assert least_effort.solution.effort_cost < min(
        smooth.solution.effort_cost, straight.solution.effort_cost
    )


def test_the_example_of_an_own_objective_does_what_it_says(capsys):
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    away = [float(line.split(": ")[1].split()[0]) for line in capsys.readouterr().out.splitlines()]
    assert len(away) == 3 and away == sorted(away, reverse=True) and away[-1] < 0.9 * away[0]


@pytest.mark.slow
@settings(max_examples=25)
@given(
    i=st.integers(0, 19),
    shares=st.lists(st.floats(0.8, 1.5), min_size=8, max_size=8),
    naturalness=st.sampled_from([0.0, 1.0]),
    coupling=st.sampled_from(["arm", "joint"]),
)
def test_whatever_splines_can_do_is_done(i, shares, naturalness, coupling):
    goal, start = request(i)
    goal = replace(goal, duration=arm_primitive().durations[i])
    way = np.abs(goal.state.positions - start.positions) / goal.duration
    peaks = np.concatenate([1.875 * way, 5.7735 * way / goal.duration])
    limits = np.maximum(np.multiply(shares, peaks), 0.05).reshape(2, -1)
    overrides = {
        name: {"max_velocity": v, "max_acceleration": a, "max_effort": np.inf}
        for name, v, a in zip(JOINTS, *limits.tolist(), strict=True)
    }
    least = least_share_with_splines(start.positions, goal, limits)
    # The planner leaves a margin of 5e-4.
    if least <= 0.999:
        plan = planner(
            overrides=overrides,
            coupling=coupling,
            naturalness=naturalness,
        ).plan(goal, start)
        assert plan.is_executable, (least, plan.message)


def least_share_with_splines(start: np.ndarray, goal: JointGoal, limits: np.ndarray) -> float:
    """Least share of limits of velocity and acceleration that a motion of splines takes.

    What these are is linear in the weights, so linear programs, one for each joint, tell it.
    """
    basis, t = BSplineBasis(1), np.linspace(0.0, 1.0, 401)
    functions = [basis.functions(t, order)[:, 0] / goal.duration**order for order in (1, 2)]
    least = 0.0
    for j, way in enumerate(goal.state.positions - start):
        minimum_jerk = [
            way / goal.duration**order * values
            for order, values in (
                (1, 30 * t**2 - 60 * t**3 + 30 * t**4),
                (2, 60 * t - 180 * t**2 + 120 * t**3),
            )
        ]
        rows = np.vstack(
            [sign * f / limits[k, j] for k, f in enumerate(functions) for sign in (1, -1)]
        )
        bounds = np.concatenate(
            [-sign * f / limits[k, j] for k, f in enumerate(minimum_jerk) for sign in (1, -1)]
        )
        found = linprog(
            np.append(np.zeros(basis.n_weights), 1.0),
            A_ub=np.hstack([rows, -np.ones((len(rows), 1))]),
            b_ub=bounds,
            bounds=(None, None),
        )
        least = max(least, found.fun)
    return least
