# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Limits as constraints of a motion program."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import minimize
from support.arm import JOINTS, arm_robot
from support.motion_programs import BASES, compile_motion

from mp_pca_planner.motion.goal import JointState
from mp_pca_planner.planning.motion import N_LIMIT_POINTS, limit_phases
from mp_pca_planner.planning.program.constraints import QUANTITIES, Limits
from mp_pca_planner.planning.program.motion_program import MotionProgram
from mp_pca_planner.planning.solver import solve

FAR_FROM_LIMITS = [JointState(JOINTS, [0.0, 0.0, 0.0, -1.0])]


def bounded(segment, bounds, rho=0.0):
    """The problem of a segment with limits."""
    segment.precision = rho * np.eye(segment.expected.size)
    return MotionProgram([segment], [[bounds]])


def constrained(name, overrides, seed=0, rho=0.0):
    """A problem with limits, a motion of it, and the limits."""
    segment, motion = compile_motion(BASES[name], seed)
    limits = arm_robot().limits(overrides)
    bounds = Limits(arm_robot(), segment.tables, segment.unknowns, limits, FAR_FROM_LIMITS)
    return bounded(segment, bounds, rho), motion, limits


def weights_of(program, motion):
    return motion.weights / program.segments[0].unknowns.scales


def groups_of(program):
    return np.repeat(program.constraints[0][0].groups, N_LIMIT_POINTS)


@pytest.mark.parametrize("name", BASES)
def test_values_bound_the_quantities_as_shares_of_their_limits(name):
    bounds = {"elbow": {"max_acceleration": 7.0, "max_jerk": 70.0}}
    program, motion, limits = constrained(name, bounds)
    values = program.evaluate(weights_of(program, motion)).inequalities
    phases = limit_phases()
    assert phases[0] == 1e-6 and phases[-1] == 1.0 - 1e-6 and phases.size == N_LIMIT_POINTS
    times = phases * motion.duration
    q, v, a = motion.evaluate(times)
    step = 1e-6 * motion.duration
    jerk = (motion.evaluate(times + step)[2] - motion.evaluate(times - step)[2]) / (2.0 * step)
    tau = arm_robot().inverse_dynamics(q, v, a)
    half = (limits.upper - limits.lower) / 2.0
    # Only the elbow has limits of acceleration and jerk here.
    for group in np.unique(groups_of(program)):
        quantity, joint = divmod(int(group), 4)
        expected = (q / half, v / limits.velocity, a / 7.0, jerk / 70.0, tau / limits.effort)
        found = values[groups_of(program) == group]
        # Between the nodes of a spline's piece efforts are those of a polynomial through them.
        tolerance = {"jerk": 1e-4, "effort": 5e-4}.get(QUANTITIES[quantity], 1e-9)
        course = expected[quantity][:, joint]
        vertices = course.copy()
        for i in range(1, course.size - 1):
            near = phases[i - 1 : i + 2] - phases[i]
            curvature = np.polyfit(near, course[i - 1 : i + 2], 2)[0]
            # The vertex of a parabola half-way to a neighbour.
            vertices[i] -= curvature * (0.5 * np.abs(near).max()) ** 2
        np.testing.assert_allclose(found, vertices, atol=tolerance)
    assert np.unique(groups_of(program)).size == 4 + 4 + 1 + 1 + 4


@pytest.mark.parametrize("name", BASES)
def test_gradient_and_rows_are_the_derivatives(name):
    bounds = {"elbow": {"max_acceleration": 7.0, "max_jerk": 70.0}}
    program, motion, _ = constrained(name, bounds, rho=0.1)
    x, step = weights_of(program, motion), 1e-6
    at = program.evaluate(x)
    rows = at.inequality_rows(np.arange(len(program.upper)))
    for k in range(0, x.size, 3):
        ends = [program.evaluate(x + sign * step * np.eye(x.size)[k]) for sign in (1.0, -1.0)]
        difference = (ends[0].inequalities - ends[1].inequalities) / (2.0 * step)
        np.testing.assert_allclose(rows[:, k], difference, atol=1e-6 * (1 + np.abs(rows).max()))
        slope = (ends[0].cost - ends[1].cost) / (2.0 * step)
        assert at.gradient[k] == pytest.approx(slope, rel=1e-5, abs=1e-6 * at.cost)


@pytest.mark.parametrize("name", ["arm", "joint"])
@pytest.mark.parametrize("seed", range(3))
def test_the_constrained_optimum_is_kept_and_scipy_finds_nothing_better(name, seed):
    free, motion, _ = constrained(name, {}, seed, rho=1e-3)
    start = 0.0 * motion.weights
    # Limits that the free optimum breaks, though the start does not.
    fastest = []
    for x in (solve(free, start).unknowns, start):
        weights = x * free.segments[0].unknowns.scales
        _, v, _ = replace(motion, weights=weights).evaluate(np.linspace(0.0, motion.duration, 500))
        fastest.append(np.abs(v).max(axis=0))
    tight = {
        joint: {"max_velocity": max(0.9 * optimal, 1.05 * before)}
        for joint, optimal, before in zip(JOINTS, *fastest, strict=True)
    }
    program, _, _ = constrained(name, tight, seed, rho=1e-3)
    solution = solve(program, start)
    assert solution.converged and solution.infeasibility <= 1e-7

    def objective(x):
        at = program.evaluate(x)
        return at.cost, at.gradient

    def room(x):
        values = program.evaluate(x).inequalities
        return np.concatenate([program.upper - values, values - program.lower])

    def room_rows(x):
        rows = program.evaluate(x).inequality_rows(np.arange(len(program.upper)))
        return np.concatenate([-rows, rows])

    better = minimize(
        objective,
        solution.unknowns,
        jac=True,
        method="SLSQP",
        constraints={"type": "ineq", "fun": room, "jac": room_rows},
        options={"ftol": 1e-9},
    )
    if room(better.x).min() > -1e-7:
        assert solution.cost <= better.fun * 1.001
