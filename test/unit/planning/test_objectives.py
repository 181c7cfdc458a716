# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives and free unknowns: gradients against differences, values against quadrature."""

import numpy as np
import pytest
from arm import JOINTS, arm_robot
from scipy.integrate import trapezoid
from test_compiler import BASES

from mp_pca_planner.exceptions import GoalError, RobotError
from mp_pca_planner.motion.goal import JointState, Pose
from mp_pca_planner.planning.compiler import MotionProgram
from mp_pca_planner.planning.conditions import Condition, JointTarget, PoseTarget
from mp_pca_planner.planning.motion import Motion
from mp_pca_planner.planning.objectives import OBJECTIVES, objective_by_name
from mp_pca_planner.planning.unknowns import QuadratureTables, Unknowns

START = JointState(JOINTS, [-0.2, 0.1, 0.2, -0.6], [0.2, 0.1, -0.3, 0.1], [1.0, -1.0, 0.5, 2.0])
GOAL = JointState(JOINTS, [0.6, 0.4, -0.1, -1.4])


def compile_free(name="arm", seed=0, free_rows=(3,), **options):
    """A program of which everything is free, and unknowns at which nothing is 0."""
    basis = BASES[name]
    motion = Motion(START, GOAL, 0.9, basis, np.zeros(basis.n_weights))
    program = MotionProgram(
        arm_robot(),
        QuadratureTables(basis),
        Unknowns(
            basis.scales,
            motion.boundary,
            0.9,
            free_rows=free_rows,
            duration_is_free=True,
            n_places=sum(one.phase is None for one in options.get("conditions", ())),
        ),
        motion.weights,
        **options,
    )
    x = 0.3 * np.random.default_rng(seed).normal(size=program.scales.size)
    return program, x


def central_differences(function, x, step=1e-5):
    columns = [
        (function(x + step * e) - function(x - step * e)) / (2.0 * step) for e in np.eye(x.size)
    ]
    return np.stack(columns, axis=-1)


def motion_of(program, x, basis):
    goal = JointState(JOINTS, program.unknowns.boundary_at(x)[0][3])
    return Motion(START, goal, program.unknowns.duration_at(x), basis, program.unknowns.weights(x))


@pytest.mark.parametrize("basis", ["arm", "bspline"])
@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_jacobian_of_each_objective_equals_central_differences(name, basis):
    objective = objective_by_name(name, arm_robot())
    program, x = compile_free(basis, objectives=[(0.7, objective)], free_rows=range(6))
    found = program.linearise(x).jacobian
    wanted = central_differences(lambda x: program.linearise(x).residual, x)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())


def test_derivatives_of_states_and_efforts_by_every_unknown_equal_central_differences():
    program, x = compile_free(free_rows=range(6))
    here = program.linearise(x)
    for found, read in ((here.effort_jacobian.reshape(-1, x.size), lambda at: at.efforts.ravel()),):
        wanted = central_differences(lambda x, read=read: read(program.linearise(x)), x)
        np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())


def test_states_of_a_free_duration_and_goal_are_those_of_the_motion():
    program, x = compile_free()
    motion = motion_of(program, x, BASES["arm"])
    times = QuadratureTables(BASES["arm"]).phases * motion.duration
    np.testing.assert_allclose(program.states(x)[:3], motion.evaluate(times), atol=1e-10)


@pytest.mark.parametrize("name", OBJECTIVES)
def test_each_objective_is_its_integral_along_the_motion(name):
    robot = arm_robot()
    program, x = compile_free(objectives=[(1.0, objective_by_name(name, robot))])
    motion = motion_of(program, x, BASES["arm"])
    times = np.linspace(0.0, motion.duration, 20001)
    q, v, a = motion.evaluate(times)
    tau = robot.inverse_dynamics(q, v, a)
    points = robot.frame_positions(q, [robot.frame_names[-1]])[:, 0]
    line = robot.frame_positions(GOAL.positions[None], [robot.frame_names[-1]])[0, 0] - points[0]
    line /= np.linalg.norm(line)
    way = points - points[0]
    density = {
        "effort": 0.5 * np.sum(tau**2, axis=1),
        "energy": np.sum(np.sqrt((tau * v) ** 2 + 0.1**2) - 0.1, axis=1),
        "jerk": 0.5 * np.sum(np.gradient(a, times, axis=0, edge_order=2) ** 2, axis=1),
        "time": np.ones(times.size),
        "straightness": 0.5 * np.sum((way - np.outer(way @ line, line)) ** 2, axis=1),
    }[name]
    residual = program.linearise(x).residual
    assert 0.5 * residual @ residual == pytest.approx(trapezoid(density, times), rel=2e-3)


def test_a_sum_of_objectives_is_the_weighted_sum():
    robot = arm_robot()
    names = {"effort": 1.0, "jerk": 0.01, "time": 3.0}

    def cost(objectives):
        program, x = compile_free(objectives=objectives)
        residual = program.linearise(x).residual
        return 0.5 * residual @ residual

    parts = [(w, objective_by_name(name, robot)) for name, w in names.items()]
    alone = [w * cost([(1.0, objective)]) for w, objective in parts]
    assert cost(parts) == pytest.approx(sum(alone), rel=1e-12)


def test_conditions_have_the_derivatives_of_central_differences():
    robot = arm_robot()
    hand = robot.frame_names[-1]
    pose = Pose(hand, [0.3, 0.2, 0.1], np.array([0.1, 0.2, -0.4, 0.9]) / np.sqrt(1.02))
    conditions = [
        Condition(JointTarget(np.array([3, 0]), np.array([-1.0, 0.3]), 4), 0.4),
        Condition(PoseTarget(robot, Pose(hand, [0.1, 0.2, 0.3])), None, (0.4, 0.8)),
        Condition(PoseTarget(robot, pose), 1.0),
    ]
    program, x = compile_free(conditions=conditions)
    errors, rows = program.equations.residuals(x)
    assert errors.shape == (2 + 3 + 6,)
    wanted = central_differences(lambda x: program.equations.residuals(x)[0], x)
    np.testing.assert_allclose(rows, wanted, atol=1e-7)
    phases = program.equations.phases(x)
    assert phases[0] == 0.4 and 0.4 < phases[1] < 0.8 and phases[2] == 1.0


def test_an_unknown_objective_or_frame_is_refused_with_the_valid_names():
    with pytest.raises(GoalError, match="no objective is called 'effrt'.*'effort'"):
        objective_by_name("effrt", arm_robot())
    with pytest.raises(RobotError, match="no link is called 'tool'.*valid names"):
        objective_by_name("straightness", arm_robot(), "tool")
