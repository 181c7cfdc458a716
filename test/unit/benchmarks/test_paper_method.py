# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The paper's own method."""

import numpy as np
from paper_method import (
    DEGREE,
    N_COMPONENTS,
    angle_components,
    paper_basis,
    paper_method,
)
from scipy.optimize import minimize
from support.arm import arm_demonstrations, arm_robot

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


def test_the_effort_is_the_least_that_another_optimiser_finds():
    robot = arm_robot()
    found = paper_method(robot, 5)(MOTION, MOTIONS[1:])
    basis = paper_basis(angle_components(MOTIONS[1:]), START, GOAL)
    effort = effort_of(basis.shape, robot)
    starts = (np.zeros(basis.n_weights), np.full(basis.n_weights, 0.5))
    assert found.effort <= min(minimize(effort, x, method="BFGS").fun for x in starts) * 1.01
    assert found.solve_time > 0.0
