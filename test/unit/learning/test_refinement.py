# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions are scaled and warped to less cost, within the limits, their ends untouched."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import trapezoid
from support.arm import JOINTS, arm_primitive, arm_robot
from support.patience import PATIENT
from support.worlds import ball_beside, least_distance

from mp_pca_planner.exceptions import LearningError, PlannerError, TrajectoryError
from mp_pca_planner.learning.refined_motion import (
    N_PARAMETERS,
    RefinedMotion,
    evaluate_warp,
    primitive_around,
)
from mp_pca_planner.learning.refinement import (
    MARGIN,
    Constraints,
    ExecutableMotions,
    refine,
)
from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState
from mp_pca_planner.motion.validation import check_limits
from mp_pca_planner.planning.motion import Motion
from mp_pca_planner.planning.planner import Planner

ROBOT = arm_robot()
LIMITS = ROBOT.limits()


def joined_motions(seed=0):
    """Two motions that are joined in a moving state."""
    rng = np.random.default_rng(seed)
    basis = arm_primitive().basis
    states = arm_primitive().boundary_states
    first, last = (JointState(JOINTS, states[i, j]) for i, j in ((0, 0), (1, 3)))
    middle = JointState(JOINTS, states[0, 3], 0.4 * rng.normal(size=4), rng.normal(size=4))
    weights = [0.5 * basis.scales * rng.normal(size=basis.n_weights) for _ in range(2)]
    return (
        Motion(first, middle, 1.1, basis, weights[0]),
        Motion(middle, last, 0.8, basis, weights[1]),
    )


def some_parameters(n_segments, seed=0, size=0.4):
    return size * np.random.default_rng(seed).uniform(-1, 1, (n_segments, N_PARAMETERS))


def planned(i=0, j=3):
    states = arm_primitive().boundary_states
    goal = JointGoal(JointState(JOINTS, states[j, 3]))
    plan = Planner(ROBOT, [arm_primitive()], LIMITS, PATIENT).plan(
        goal, JointState(JOINTS, states[i, 0])
    )
    assert plan.is_executable
    return plan


@pytest.mark.parametrize("n_segments", [2, 17])
def test_ends_are_kept_to_the_last_bit_whatever_the_durations(n_segments):
    there, back = joined_motions()
    segments = [(there, back)[i % 2] for i in range(n_segments)]
    for seed in range(20):
        motion = RefinedMotion(segments, some_parameters(n_segments, seed, 1.0))
        q, v, a = motion.evaluate(np.linspace(0.0, motion.duration, 7))
        for k, state in ((0, segments[0].start), (-1, segments[-1].goal)):
            np.testing.assert_array_equal(q[k], state.positions)
            np.testing.assert_array_equal(v[k], state.velocities)
            np.testing.assert_array_equal(a[k], state.accelerations)


@pytest.mark.parametrize("seed", range(2))
def test_segments_stay_joined_to_the_acceleration(seed):
    motion = RefinedMotion(joined_motions(seed), some_parameters(2, seed, 1.0))
    join, step = motion.durations[0], 1e-7
    before, at, after = (
        np.array(motion.evaluate(np.array([join + x])))[:, 0] for x in (-step, 0.0, step)
    )
    middle = motion.segments[1].start
    # The time of the join is rounded.
    wanted = [middle.positions, middle.velocities, middle.accelerations]
    np.testing.assert_allclose(at, wanted, atol=1e-9)
    rate = np.abs(np.array(motion.evaluate(np.linspace(0, motion.duration, 500)))).max()
    assert np.abs(before - at).max() < 1e3 * rate * step
    assert np.abs(after - at).max() < 1e3 * rate * step


def test_velocities_and_accelerations_are_derivatives_of_the_positions():
    motion = RefinedMotion(joined_motions(), some_parameters(2))
    times, step = np.linspace(0.1, 0.9, 9) * motion.duration, 1e-5
    _, v, a = motion.evaluate(times)
    ahead, behind = motion.evaluate(times + step), motion.evaluate(times - step)
    np.testing.assert_allclose((ahead[0] - behind[0]) / (2 * step), v, rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose((ahead[1] - behind[1]) / (2 * step), a, rtol=1e-6, atol=1e-6)


@given(st.lists(st.floats(-3.0, 3.0), min_size=3, max_size=3).map(np.array))
@settings(max_examples=60, deadline=None)
def test_a_warp_increases_and_keeps_its_ends(c):
    s, rate, bend, _ = evaluate_warp(c, np.linspace(0.0, 1.0, 201))
    assert np.all(rate > 0.0) and np.all(np.diff(s) > 0.0)
    np.testing.assert_allclose(s[[0, -1]], [0.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(rate[[0, -1]], 1.0, atol=1e-10)
    np.testing.assert_allclose(bend[[0, -1]], 0.0, atol=1e-7)


def planned_stiffly():
    """A motion near the demonstrations, which refinement changes much."""
    states = arm_primitive().boundary_states
    options = replace(PATIENT, naturalness=1.0)
    planner = Planner(ROBOT, [arm_primitive()], LIMITS, options)
    return planner.plan(states[0, 3], states[0, 0])


def test_refining_keeps_clear_of_an_obstacle_that_it_would_meet_otherwise():
    plan = planned_stiffly()
    bare = refine(plan.motions, ROBOT, LIMITS)
    world = ball_beside(plan.trajectory, bare.trajectory)
    assert least_distance(world, bare.trajectory) < 0.0
    model = CollisionModel(ROBOT, world=world)
    found = refine(plan.motions, ROBOT, LIMITS, model)
    assert least_distance(world, found.trajectory) > 1e-3
    assert 0.0 < found.gain < bare.gain


def test_cost_is_the_integral_of_the_efforts():
    motion = RefinedMotion(joined_motions(), some_parameters(2))
    trajectory = motion.sample(ROBOT, 1e-3)
    effort = motion.effort(ROBOT)
    judge = ExecutableMotions(motion.segments, ROBOT, LIMITS, time_price=5.0)
    by_points = 0.5 * trapezoid(np.sum(trajectory.efforts**2, axis=1), trajectory.times)
    assert effort == pytest.approx(by_points, rel=1e-4)
    assert judge.cost(motion) == pytest.approx(effort + 5.0 * motion.duration, rel=1e-12)


def test_refining_lowers_the_cost_in_the_same_time_and_keeps_ends_and_limits():
    plan = planned()
    found = refine([plan.motion], ROBOT, LIMITS)
    assert found.cost < 0.95 * found.original_cost
    assert found.original_cost == pytest.approx(plan.solution.effort_cost, rel=1e-3)
    assert found.motion.duration == pytest.approx(plan.motion.duration, rel=1e-12)
    assert not check_limits(found.trajectory, ROBOT, LIMITS).violations
    np.testing.assert_array_equal(found.trajectory.positions[0], plan.motion.start.positions)
    np.testing.assert_array_equal(found.trajectory.positions[-1], plan.motion.goal.positions)
    assert np.all(found.trajectory.velocities[-1] == 0.0)


def test_limits_hold_that_the_free_optimum_breaks():
    plan = planned()
    free = refine([plan.motion], ROBOT, LIMITS)
    peak = np.abs(plan.trajectory.accelerations).max(axis=0)
    tight = ROBOT.limits(
        {name: {"max_acceleration": 1.02 * x} for name, x in zip(JOINTS, peak, strict=True)}
    )
    assert check_limits(free.trajectory, ROBOT, tight).violations
    found = refine([plan.motion], ROBOT, tight)
    assert not check_limits(found.trajectory, ROBOT, tight).violations
    assert found.original_cost > found.cost > free.cost


def test_time_that_costs_is_spared():
    plan = planned()
    cheap, dear = (refine([plan.motion], ROBOT, LIMITS, time_price=x) for x in (10.0, 300.0))
    assert dear.motion.duration < cheap.motion.duration
    assert dear.cost <= dear.original_cost
    # At an optimum inside of the bounds a longer duration gains as much as it costs.
    slower, faster = (
        motion.effort(ROBOT) + 10.0 * motion.duration
        for motion in (cheap.motion.lasting(x * cheap.motion.duration) for x in (1.01, 0.99))
    )
    assert abs(slower - faster) < 0.02 * 0.02 * cheap.cost


def test_what_is_not_executable_is_refused():
    plan = planned()
    tight = ROBOT.limits({JOINTS[0]: {"max_velocity": 1e-3}})
    with pytest.raises(TrajectoryError, match="velocity of joint"):
        refine([plan.motion], ROBOT, tight)
    with pytest.raises(LearningError, match="time_price must be a number of at least 0, got -1"):
        refine([plan.motion], ROBOT, LIMITS, time_price=-1.0)
    with pytest.raises(PlannerError, match="at least one segment"):
        RefinedMotion([])
    with pytest.raises(PlannerError, match="finite"):
        RefinedMotion([plan.motion], np.full(N_PARAMETERS, np.nan))


def test_family_expects_the_refined_motion_for_the_same_request():
    plan = planned()
    refined = RefinedMotion([plan.motion], [[0.3, 0.2, 0.4, -0.3, 0.2]])
    family = primitive_around(arm_primitive(), refined, "refined", {"why": "test"})
    expected = family.model.predict(
        plan.motion.start.positions, plan.motion.goal.positions, refined.duration
    )
    basis = family.paced_basis(
        plan.motion.start.positions, plan.motion.goal.positions, expected.pace
    )
    expects = Motion(plan.motion.start, plan.motion.goal, refined.duration, basis, expected.weights)
    times = np.linspace(0.0, refined.duration, 101)
    np.testing.assert_allclose(expects.evaluate(times)[0], refined.evaluate(times)[0], atol=2e-3)
    assert family.metadata["refined_from"] == {"name": arm_primitive().name, "why": "test"}


@pytest.mark.parametrize("n_segments", [1, 2])
def test_limits_and_their_slopes_are_those_of_differences(n_segments):
    segments = joined_motions()[:n_segments]
    limits = ROBOT.limits({name: {"max_jerk": 40.0, "max_acceleration": 9.0} for name in JOINTS})
    terms = Constraints(ExecutableMotions(segments, ROBOT, limits))
    x = some_parameters(n_segments, 4).ravel()
    values, slopes = terms.values(x), terms.jacobian(x)
    for k, e in enumerate(1e-6 * np.eye(x.size)):
        ahead, behind = (terms.values(x + s * e) for s in (1, -1))
        np.testing.assert_allclose((ahead - behind) / 2e-6, slopes[:, k], rtol=1e-4, atol=1e-3)
    # The least room for jerk is that of the motion itself, on a fine grid.
    motion, step = RefinedMotion(segments, x), 1e-5
    times = np.linspace(0.0, motion.duration, 4001)[1:-1]
    if n_segments == 1:
        jerk = np.subtract(*(motion.evaluate(times + h)[2] for h in (step, -step))) / (2 * step)
        assert values.min() == pytest.approx(1.0 - np.abs(jerk).max() / 40.0 - MARGIN, rel=0.05)
