# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions and their running costs: exact ends, derivatives and integrals."""

import numpy as np
import pytest
from support.arm import JOINTS, arm_primitive

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.planning.motion import Motion, samples_of
from mp_pca_planner.primitives.basis import BSplineBasis


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
