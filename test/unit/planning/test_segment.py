# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions and their running costs: exact ends, derivatives and integrals."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from support.arm import JOINTS, arm_primitive, arm_robot
from support.motion_programs import BASES, compile_motion

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.planning.motion import Motion, samples_of
from mp_pca_planner.primitives.basis import BSplineBasis


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


@pytest.fixture(params=["pca", "bspline"])
def motion(request):
    rng = np.random.default_rng(0)
    basis = arm_primitive().basis if request.param == "pca" else BSplineBasis(4)
    start, goal = (JointState(JOINTS, *rng.normal(size=(3, 4))) for _ in range(2))
    return Motion(start, goal, 0.83, basis, basis.scales * rng.normal(size=basis.n_weights))


def test_velocities_and_accelerations_are_time_derivatives(motion):
    times, step = np.linspace(0.01, 0.82, 40), 1e-6
    ahead, behind = motion.evaluate(times + step), motion.evaluate(times - step)
    _, v, a = motion.evaluate(times)
    for found, k in ((v, 0), (a, 1)):
        difference = (ahead[k] - behind[k]) / (2.0 * step)
        np.testing.assert_allclose(found, difference, atol=1e-6 * np.abs(found).max())


@pytest.mark.parametrize("period", [0.01, 0.03, 0.83, 5.0, 0.83 / 7])
def test_samples_cover_the_motion_evenly_and_no_wider_than_asked(motion, period):
    times, states = samples_of(motion, period)
    assert times[0] == 0.0 and times[-1] == motion.duration
    steps = np.diff(times)
    assert steps.max() <= period * (1.0 + 1e-9)
    np.testing.assert_allclose(steps, steps[0])
    assert len(steps) == 1 or steps[0] > 0.5 * period
    np.testing.assert_allclose(states, motion.evaluate(times), rtol=1e-9, atol=1e-12)
