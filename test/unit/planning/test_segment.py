# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The motion program: its integral and its gradient."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from support.arm import arm_robot
from support.motion_programs import BASES, compile_motion

from mp_pca_planner.planning.motion import cost_of
from mp_pca_planner.planning.objectives import effort


@pytest.mark.parametrize("name", BASES)
def test_the_chosen_nodes_integrate_the_effort_as_adaptive_quadrature_does(name):
    robot = arm_robot()
    for seed in range(5):
        program, motion = compile_motion(BASES[name], seed)

        def power(t, motion=motion):
            tau = robot.inverse_dynamics(*motion.evaluate(np.array([t])))
            return 0.5 * np.sum(tau**2)

        exact, _ = quad_vec(power, 0.0, 0.9, epsrel=1e-9, points=motion.basis.breakpoints * 0.9)
        found = program.at(motion.weights / program.unknowns.scales)[1].cost
        assert found == pytest.approx(exact, rel=1e-3)


def test_running_costs_are_those_of_the_motion_and_naturalness_is_zero_at_the_expected_weights():
    program, motion = compile_motion(BASES["joint"])
    z = motion.weights / program.unknowns.scales
    objectives = [(1.0, effort)]
    cost = cost_of(arm_robot(), motion, program.tables, objectives)
    assert program.at(z)[1].cost == pytest.approx(cost, rel=1e-12)
    assert program.effort(z) == pytest.approx(cost, rel=1e-12)
    program.precision = np.eye(z.size)
    assert program.naturalness(program.expected).cost == 0.0
    assert program.naturalness(program.expected + 2.0).cost == pytest.approx(2.0 * z.size)
