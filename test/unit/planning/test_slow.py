# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Time is a budget, never a verdict: goals are served by slow motions where nothing else is found.

The deadline of these planners has always passed, or never passes: a busy machine changes nothing.
"""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.arm import JOINTS, arm_robot
from support.arm_plans import planner, request
from support.chain import ACROSS_BASE, chain, chain_planner

from mp_pca_planner.motion.collision import CollisionModel
from mp_pca_planner.motion.goal import JointGoal, JointState, SequenceGoal
from mp_pca_planner.motion.validation import check_executable, check_limits
from mp_pca_planner.planning.options import MODES
from mp_pca_planner.planning.plan import INFEASIBLE, STOPPED_EARLY

NO_TIME = 1e-9
# Hardly any jerk: no motion that is optimised without time keeps these limits.
TIGHT = {"max_velocity": 1.0, "max_acceleration": 2.0, "max_jerk": 8.0}
OVERRIDES = dict.fromkeys(JOINTS, TIGHT)
LIMITS = arm_robot().limits(OVERRIDES)
shares = st.lists(st.floats(0.02, 0.98), min_size=4, max_size=4).map(np.array)


def configuration(share: np.ndarray) -> np.ndarray:
    return LIMITS.lower + share * (LIMITS.upper - LIMITS.lower)


def fastest(way: np.ndarray) -> float:
    """Least duration of a minimum-jerk motion within the limits but for those of effort."""
    way = np.abs(way).max()
    return max(
        15 / 8 * way / TIGHT["max_velocity"],
        (10 / 3**0.5 * way / TIGHT["max_acceleration"]) ** 0.5,
        (60 * way / TIGHT["max_jerk"]) ** (1 / 3),
    )


def under_way(first: np.ndarray, second: np.ndarray, phase: float) -> JointState:
    """A state of a motion within the limits: minimum-jerk, a tenth slower than it must be."""
    way, s = second - first, phase
    duration = max(1.1 * fastest(way), 1e-3)
    return JointState(
        JOINTS,
        first + way * (10 * s**3 - 15 * s**4 + 6 * s**5),
        way * (30 * s**2 - 60 * s**3 + 30 * s**4) / duration,
        way * (60 * s - 180 * s**2 + 120 * s**3) / duration**2,
    )


def assert_serves(plan, start: JointState, overrides=OVERRIDES) -> None:
    """It may be executed, and the motion itself keeps the limits, too."""
    assert plan.is_executable, plan.message
    limits = arm_robot().limits(overrides)
    check = check_limits(plan.trajectory, arm_robot(), limits)
    check_executable(plan.trajectory, check, start)
    for field in ("positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(plan.trajectory, field)[0], getattr(start, field))
    if len(plan.motions) == 1:
        q, _, _ = plan.motion.evaluate(plan.trajectory.times)
        np.testing.assert_allclose(q, plan.trajectory.positions, atol=1e-12)


@given(shares, shares, shares, st.floats(0.0, 1.0), st.sampled_from(["demonstrated", "shortest"]))
def test_every_goal_is_served_from_rest_and_in_motion_without_any_time(
    first, second, third, phase, timing
):
    start = under_way(configuration(first), configuration(second), phase)
    goal = JointGoal(JointState(JOINTS, configuration(third)))
    overrides = dict.fromkeys(JOINTS, TIGHT | {"max_effort": np.inf})
    plan = planner(overrides=overrides, max_solve_time=NO_TIME, timing=timing).plan(goal, start)
    if plan.status == "already_there":
        np.testing.assert_allclose(start.positions, goal.state.positions, rtol=0.0, atol=1e-4)
        return
    assert_serves(plan, start, overrides)
    np.testing.assert_array_equal(plan.trajectory.positions[-1], goal.state.positions)


def replace_rates(state: JointState, rate: float) -> JointState:
    return JointState(JOINTS, state.positions, np.full(4, rate), np.full(4, -rate))


@given(st.floats(0.2, 3.0), st.booleans())
def test_fixed_duration_is_kept_or_refused(duration, moving):
    goal, start = request(1, duration=duration)
    start = replace_rates(start, 0.1) if moving else start
    subject = planner(overrides=OVERRIDES, max_solve_time=NO_TIME)
    plan = subject.plan(goal, start)
    if plan.is_executable:
        assert_serves(plan, start)
        assert plan.trajectory.duration == duration
        return
    assert "timing 'shortest' finds the shortest one" in plan.message


def test_slow_motion_in_collision_is_not_returned():
    start, goal = ACROSS_BASE
    model = CollisionModel(chain())
    plan = chain_planner(model, max_solve_time=NO_TIME).plan(JointGoal(goal), start)
    # The straight way leads through the base.
    assert not plan.is_executable or not model.collisions(plan.trajectory)
    straight = chain_planner(None, max_solve_time=NO_TIME).plan(JointGoal(goal), start)
    assert straight.is_executable and model.collisions(straight.trajectory)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("times", [(), (None, 9.0, None), (5.0, 9.5, 14.0)])
@pytest.mark.parametrize("moving", [False, True])
def test_sequences_rest_at_each_target_without_any_time(mode, times, moving):
    requests = [request(i) for i in range(3)]
    targets = tuple(goal.state for goal, _ in requests)
    start = requests[0][1]
    start = replace_rates(start, 0.1) if moving else start
    subject = planner(overrides=OVERRIDES, max_solve_time=NO_TIME)
    plan = subject.plan(SequenceGoal(targets, times), start, mode)
    assert_serves(plan, start)
    # Passing all targets without a rest keeps the limits only in the last of these times.
    rests = "rests at each target and keeps the limits" in plan.message
    assert rests == (None in (*times, None)[:2])
    if rests:
        assert plan.status == STOPPED_EARLY
        assert "time ran out (max_solve_time = 1e-09 s) before a motion" in plan.message
    ends = np.cumsum([motion.duration for motion in plan.motions])
    for end, time, target in zip(ends, times or [None] * 3, targets, strict=True):
        assert time is None or end == pytest.approx(time, abs=1e-9)
        row = int(np.abs(plan.trajectory.times - end).argmin())
        np.testing.assert_array_equal(plan.trajectory.positions[row], target.positions)
        assert not (rests and plan.trajectory.velocities[row].any())


@pytest.mark.parametrize("quantity", ["max_velocity", "max_acceleration", "max_jerk"])
@pytest.mark.parametrize("kind", ["optimal", "real_time", "single"])
def test_motions_that_would_take_too_long_are_rejected_before_they_are_sampled(quantity, kind):
    goal, start = request(1)
    via = JointState(JOINTS, start.positions + 0.1)
    target = goal if kind == "single" else SequenceGoal((via, goal.state))
    subject = planner(overrides={name: {quantity: 1e-9} for name in JOINTS}, max_solve_time=0.05)
    plan = subject.plan(target, start, kind if kind in MODES else "optimal")
    assert plan.status == INFEASIBLE
    assert plan.trajectory.n_steps < 10_000
