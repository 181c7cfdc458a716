# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Objectives and free unknowns: gradients against differences, values against quadrature."""

import numpy as np
import pytest
from scipy.integrate import trapezoid
from support.arm import JOINTS, arm_robot
from support.motion_programs import BASES

from mp_pca_planner.motion.goal import JointState, Pose
from mp_pca_planner.planning.motion import Motion, Tables
from mp_pca_planner.planning.objectives import OBJECTIVES, QUANTITIES, objective_by_name
from mp_pca_planner.planning.program.constraints import PoseTarget
from mp_pca_planner.planning.program.segment import SegmentProgram, Unknowns

START = JointState(JOINTS, [-0.2, 0.1, 0.2, -0.6], [0.2, 0.1, -0.3, 0.1], [1.0, -1.0, 0.5, 2.0])
GOAL = JointState(JOINTS, [0.6, 0.4, -0.1, -1.4])


def compile_free(name="arm", seed=0, free_orders=((), (0,)), **options):
    """A program of which everything is free, and unknowns at which nothing is 0."""
    basis = BASES[name]
    motion = Motion(START, GOAL, 0.9, basis, np.zeros(basis.n_weights))
    program = SegmentProgram(
        arm_robot(),
        Tables(basis),
        Unknowns(
            basis.scales,
            motion.boundary,
            0.9,
            free_orders=free_orders,
            duration_is_free=True,
        ),
        motion.weights,
        **options,
    )
    x = 0.3 * np.random.default_rng(seed).normal(size=program.unknowns.scales.size)
    return program, x


def central_differences(function, x, step=1e-5):
    columns = [
        (function(x + step * e) - function(x - step * e)) / (2.0 * step) for e in np.eye(x.size)
    ]
    return np.stack(columns, axis=-1)


def motion_of(program, x, basis):
    goal = JointState(JOINTS, program.unknowns.boundary_at(x)[3])
    return Motion(START, goal, program.unknowns.duration_at(x), basis, program.unknowns.weights(x))


@pytest.mark.parametrize("basis", ["arm", "bspline"])
@pytest.mark.parametrize("name", OBJECTIVES)
def test_the_gradient_of_each_objective_equals_central_differences(name, basis):
    objective = objective_by_name(name, arm_robot())
    program, x = compile_free(
        basis, objectives=[(0.7, objective)], free_orders=(range(3), range(3))
    )
    found = program.at(x).gradient
    wanted = central_differences(lambda x: np.array(program.at(x).cost), x)
    np.testing.assert_allclose(found, wanted, atol=1e-6 * np.abs(wanted).max())


@pytest.mark.parametrize("quantity", QUANTITIES)
def test_derivatives_of_states_and_efforts_by_every_unknown_equal_central_differences(quantity):
    program, x = compile_free(free_orders=(range(3), range(3)))
    found = program.at(x).slopes[quantity].reshape(-1, x.size)
    wanted = central_differences(lambda x: getattr(program.at(x).nodes, quantity).ravel(), x)
    np.testing.assert_allclose(found, wanted, atol=1e-7 * np.abs(wanted).max())


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
    assert program.at(x).cost == pytest.approx(trapezoid(density, times), rel=2e-3)


def test_equations_of_a_pose_have_the_derivatives_of_central_differences():
    robot = arm_robot()
    orientation = np.array([0.1, 0.2, -0.4, 0.9]) / np.sqrt(1.02)
    pose = Pose(robot.frame_names[-1], [0.3, 0.2, 0.1], orientation)
    program, x = compile_free()
    target = PoseTarget(robot, program.tables, program.unknowns, pose)
    errors, rows = target.equations(x)
    assert errors.shape == (6,)
    np.testing.assert_allclose(
        rows, central_differences(lambda at: target.equations(at)[0], x), atol=1e-7
    )
