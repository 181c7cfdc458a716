# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Constraints on every configuration of a motion: a frame that is kept upright."""

import numpy as np
import pinocchio as pin
import pytest
from support.arm import JOINTS, arm_robot
from support.arm_plans import planner, request
from support.motion_programs import BASES, compile_motion

from mp_pca_planner.exceptions import GoalError, RobotError
from mp_pca_planner.files import config_file
from mp_pca_planner.motion.goal import JointState, Pose, SequenceGoal
from mp_pca_planner.planning.path_constraints import Upright, path_constraints
from mp_pca_planner.planning.plan import INFEASIBLE
from mp_pca_planner.planning.program.constraints import AlongPath

FRAME = "wrist"


def leaning(q, axis):
    """Angles between an axis of the wrist and the vertical, by plain calls of Pinocchio [rad]."""
    model = pin.buildModelFromUrdf(str(config_file("human_arm.urdf")))
    data, found = model.createData(), []
    index = [model.joints[model.getJointId(name)].idx_q for name in JOINTS]
    for one in np.atleast_2d(q):
        full = pin.neutral(model)
        full[index] = one
        pin.framesForwardKinematics(model, data, full)
        rotation = data.oMf[model.getFrameId(FRAME)].rotation
        found.append(np.arccos(np.clip((rotation @ axis)[2] / np.linalg.norm(axis), -1.0, 1.0)))
    return np.array(found)


def cone(start, goal, room):
    """The axis that is vertical at the start, and a cone that the goal leaves some room in."""
    model = pin.buildModelFromUrdf(str(config_file("human_arm.urdf")))
    data, full = model.createData(), pin.neutral(model)
    full[[model.joints[model.getJointId(name)].idx_q for name in JOINTS]] = start
    pin.framesForwardKinematics(model, data, full)
    axis = data.oMf[model.getFrameId(FRAME)].rotation.T @ [0.0, 0.0, 1.0]
    return Upright(FRAME, float(leaning(goal, axis)[0] + room), tuple(axis.tolist()))


@pytest.mark.parametrize("axis", [(0.0, 0.0, 1.0), (2.0, -1.0, 0.5)])
def test_values_are_those_of_the_cone_and_slopes_equal_central_differences(axis):
    robot, constraint = arm_robot(), Upright(FRAME, 0.7, axis)
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (6, 4))
    values, slopes = constraint.values(robot, q)
    angles = leaning(q, np.array(axis))
    expected = 1.0 - (1.0 - np.cos(angles)) / (1.0 - np.cos(0.7))
    np.testing.assert_allclose(values[:, 0], expected, atol=1e-12)
    for j, step in enumerate(1e-6 * np.eye(4)):
        ahead, behind = (constraint.values(robot, q + sign * step)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(slopes[:, :, j], (ahead - behind) / 2e-6, atol=1e-7)


@pytest.mark.parametrize("name", BASES)
def test_rows_of_the_program_equal_central_differences(name):
    segment, motion = compile_motion(BASES[name])
    ends, phases = (motion.start, None), np.linspace(0.0, 1.0, 9)
    upright = Upright(FRAME, 0.7)
    subject = AlongPath(arm_robot(), upright, segment.unknowns, segment.tables.basis, ends, phases)
    x = motion.weights / segment.unknowns.scales
    at = subject.at(segment.at(x))
    assert at.values.shape == subject.lower.shape == (8,)
    q, _, _ = motion.evaluate(motion.duration * phases[1:])
    np.testing.assert_allclose(at.values, upright.values(arm_robot(), q)[0][:, 0], atol=1e-12)
    rows = at.rows(np.arange(8), None)
    for k, step in enumerate(1e-6 * np.eye(x.size)):
        ahead, behind = (subject.at(segment.at(x + s * step)).values for s in (1.0, -1.0))
        np.testing.assert_allclose(rows[:, k], (ahead - behind) / 2e-6, atol=1e-6)


def test_a_motion_that_leans_too_far_is_planned_within_the_cone():
    tried = 0
    for i in range(40):
        goal, start = request(i)
        upright = cone(start.positions, goal.state.positions, 0.02)
        axis = np.array(upright.axis)
        usual = planner("joint").plan(goal, start)
        if leaning(usual.trajectory.positions, axis).max() < upright.angle + 0.005:
            continue
        tried += 1
        plan = planner("joint", constraints=(upright,)).plan(goal, start)
        assert plan.is_executable, plan.message
        assert leaning(plan.trajectory.positions, axis).max() <= upright.angle + 1e-5
        np.testing.assert_allclose(plan.trajectory.positions[-1], goal.state.positions, atol=1e-12)
    assert tried >= 3


def test_poses_and_sequences_keep_the_cone_too():
    goal, start = request(3)
    upright = cone(start.positions, goal.state.positions, 0.05)
    subject, axis = planner(constraints=(upright,)), np.array(upright.axis)
    place = arm_robot().frame_positions(goal.state.positions[None], [FRAME])[0, 0]
    for asked in (Pose(FRAME, place), SequenceGoal((goal.state, start))):
        plan = subject.plan(asked, start)
        assert plan.is_executable, plan.message
        assert leaning(plan.trajectory.positions, axis).max() <= upright.angle + 1e-5


def test_ends_outside_the_cone_are_rejected_and_impossible_cones_are_named():
    goal, start = request(3)
    narrow = cone(start.positions, goal.state.positions, -0.02)
    with pytest.raises(GoalError, match="the goal does not keep 'wrist' within .*° of upright"):
        planner(constraints=(narrow,)).plan(goal, start)
    with pytest.raises(GoalError, match="the start does not keep 'wrist' within"):
        planner(constraints=(narrow,)).plan(JointState(JOINTS, start.positions), goal.state)
    place = arm_robot().frame_positions(goal.state.positions[None], [FRAME])[0, 0]
    tight = Upright(FRAME, 2e-3, narrow.axis)
    plan = planner(constraints=(tight,)).plan(Pose(FRAME, place), start)
    assert plan.status == INFEASIBLE
    assert "that keeps 'wrist' within 0.115° of upright was found" in plan.message


def test_texts_are_read_and_wrong_ones_rejected():
    robot = arm_robot()
    assert path_constraints("", "--constraint", robot) == ()
    (found,) = path_constraints("upright = wrist, 30, 1, 0, 0", "--constraint", robot)
    assert found == Upright(FRAME, np.deg2rad(30.0), (1.0, 0.0, 0.0))
    for text, message in (
        ("level=wrist,3", "--constraint: no constraint is called 'level'.*'upright'"),
        ("upright=wrist", "--constraint 'upright=wrist': expected upright:FRAME:DEGREES"),
        ("upright=wrist,10,1", "expected upright:FRAME:DEGREES"),
        ("upright=wrist,0", "in degrees, must be a number from 0.1 to 170, got 0"),
        ("upright:wrist:400", "in degrees, must be a number from 0.1 to 170, got 400"),
        ("upright=wrist,10,0,0,0", "must not be 0"),
    ):
        with pytest.raises(GoalError, match=message):
            path_constraints(text, "--constraint", robot)
    with pytest.raises(RobotError, match="no link is called 'glass'"):
        path_constraints("upright=glass,10", "--constraint", robot)
    with pytest.raises(GoalError, match="constraints must be path constraints"):
        planner(constraints=("upright",))
