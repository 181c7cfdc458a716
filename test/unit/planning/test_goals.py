# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""What the planner can be asked: poses, durations, objectives, and more than the span."""

import runpy
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS, arm_primitive, arm_robot
from support.arm_plans import planner, request

from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointState, Pose, PoseGoal
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.plan import SOLVED

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


def test_the_example_of_an_own_objective_does_what_it_says(capsys):
    runpy.run_path(str(EXAMPLE), run_name="__main__")
    away = [float(line.split(": ")[1].split()[0]) for line in capsys.readouterr().out.splitlines()]
    assert len(away) == 3 and away == sorted(away, reverse=True) and away[-1] < 0.9 * away[0]


@pytest.mark.parametrize("coupling", ["arm", "joint"])
def test_splines_are_added_where_components_have_no_motion_within_the_limits(coupling):
    added = 0
    for i in range(6):
        goal, start = request(i)
        goal = replace(goal, duration=arm_primitive().durations[i])
        # The minimum-jerk motion takes 0.97 of these limits: splines hold it, components do not.
        way = np.abs(goal.state.positions - start.positions) / goal.duration / 0.97
        peaks = zip((1.875 * way).tolist(), (5.7735 * way / goal.duration).tolist(), strict=True)
        limits = [
            {"max_velocity": v, "max_acceleration": a, "max_effort": np.inf} for v, a in peaks
        ]
        overrides = dict(zip(JOINTS, limits, strict=True))
        plan = planner(overrides=overrides, coupling=coupling).plan(goal, start)
        assert plan.is_executable, plan.message
        assert plan.duration == goal.duration
        assert ("beyond the demonstrations" in plan.message) == (plan.facts["correction"] > 0.0)
        added += plan.facts["correction"] > 0.0
    assert added
