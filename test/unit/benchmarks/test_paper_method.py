# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's own method."""

import numpy as np
import pytest
from paper_method import (
    DEGREE,
    N_COMPONENTS,
    angle_components,
    bsplines,
    n_agreeing,
    paper_basis,
    paper_method,
)
from prediction import plan_like
from scipy.interpolate import BSpline
from scipy.optimize import minimize
from support.arm import arm_demonstrations, arm_robot

from mp_pca_planner.primitives.build import build_primitive
from mp_pca_planner.primitives.differences import FINE_PHASES

MOTIONS = arm_demonstrations()
MOTION = MOTIONS[0]
START, GOAL = MOTION.positions[[0, -1]]


def effort_of(states, robot):
    """Effort of a motion to be optimised, whose states are functions of the unknowns."""
    x, w = np.polynomial.legendre.leggauss(40)

    def effort(unknowns):
        q, v, a = (states(unknowns, (x + 1) / 2, d) / MOTION.duration**d for d in range(3))
        tau = robot.inverse_dynamics(q, v, a)
        return 0.25 * MOTION.duration * float(w @ np.sum(tau**2, axis=1))

    return effort


def test_every_choice_of_weights_is_of_the_fourth_order_and_meets_the_end_points():
    basis = paper_basis(angle_components(MOTIONS[1:]), START, GOAL)
    assert basis.n_weights == 4 * (N_COMPONENTS - 2)
    assert basis.mean_coefficients.shape[1] == DEGREE + 1 == 5
    for weights in np.random.default_rng(1).normal(size=(5, basis.n_weights)):
        found = basis.shape(weights, np.array([0.0, 1.0]))
        np.testing.assert_allclose(found, [START, GOAL], atol=1e-9)


def test_between_ends_of_the_mean_motion_the_mean_is_likeliest():
    components = angle_components(MOTIONS)
    mean = np.array([found.mean for found in components]).T
    basis = paper_basis(components, mean[0], mean[-1])
    deviation = basis.shape(np.zeros(basis.n_weights), FINE_PHASES[::10]) - mean
    assert np.abs(deviation).max() < 0.05


def test_the_effort_is_the_least_that_another_optimiser_finds():
    robot = arm_robot()
    found = paper_method(robot, 5)(MOTION, MOTIONS[1:])
    basis = paper_basis(angle_components(MOTIONS[1:]), START, GOAL)
    effort = effort_of(basis.shape, robot)
    starts = (np.zeros(basis.n_weights), np.full(basis.n_weights, 0.5))
    assert found.effort <= min(minimize(effort, x, method="BFGS").fun for x in starts) * 1.01
    assert found.solve_time > 0.0


def test_bsplines_with_free_ends_take_the_least_effort_that_another_optimiser_finds():
    robot = arm_robot()
    found = bsplines(robot, 5, free_ends=True)(MOTION, ())
    np.testing.assert_allclose(found.positions[[0, -1]], [START, GOAL], atol=1e-9)
    # All clamped splines of 12 control points, of which the first and the last are given.
    degree, n_free = 5, 10
    inner = np.linspace(0.0, 1.0, n_free + 2 - degree + 1)
    knots = np.concatenate([np.zeros(degree), inner, np.ones(degree)])

    def states(free, phases, order):
        points = np.vstack([START, free.reshape(n_free, -1), GOAL])
        return BSpline(knots, points, degree)(phases, order)

    straight = np.linspace(START, GOAL, n_free + 2)[1:-1]
    least = minimize(effort_of(states, robot), straight.ravel(), method="BFGS").fun
    assert found.effort <= least * 1.01


def test_bsplines_at_rest_are_those_of_the_planner():
    robot = arm_robot()
    planned = plan_like(MOTION, build_primitive(MOTIONS[1:], "others"), robot, "bspline", 0.0)
    found = bsplines(robot, 5, free_ends=False)(MOTION, ())
    assert found.starts[0, 0] == pytest.approx(planned.effort, rel=1e-3)
    assert found.effort <= planned.effort


def test_starts_follow_until_two_agree_on_the_least_effort():
    efforts = np.array([8.718, 8.718, 7.275, 9.0, 7.28])
    starts = np.column_stack([efforts, np.ones(5)])
    assert [n_agreeing(starts[:n]) for n in (1, 2, 3, 5)] == [1, 2, 1, 2]
    assert [n_agreeing(starts, n) for n in (2, 3, None)] == [0, 1, 2]
    found = paper_method(arm_robot(), 2)(MOTION, MOTIONS[1:])
    assert len(found.starts) in (2, 4, 6)
    assert len(found.starts) == 6 or n_agreeing(found.starts) > 1
