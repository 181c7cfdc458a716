# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""A plan is plain values with a headline; a budget bounds its time."""

import pickle
import re
import time
from dataclasses import fields

import numpy as np
import pytest
from support.arm import arm_demonstrations, arm_primitive, arm_robot
from support.arm_plans import planner, request

import mp_pca_planner as mp
from mp_pca_planner.motion.interpolation import interpolate


def test_the_headline_says_duration_likeness_clearance_and_efforts():
    shown = arm_demonstrations(12, 7)[3]
    robot, middle = arm_robot(), shown.positions[len(shown.positions) // 2]
    place = robot.frame_positions(middle[None], ["wrist"])[0, 0] + [0.25, 0.0, 0.0]
    world = mp.World([mp.Obstacle("box", [mp.Box((0.1, 0.1, 0.1), place)])])
    options = mp.PlannerOptions(max_solve_time=60.0)
    subject = mp.Planner(robot, arm_primitive(), options=options, world=world)
    plan = subject.plan(shown.positions[-1], shown.positions[0])
    assert plan.is_executable, plan.message
    pattern = r"([\d.]+) s, .* \(score ([\d.]+)\), (\d+) mm clear of 'box', (\d+) % of the torque"
    match = re.match(pattern, plan.message)
    assert match is not None, plan.message
    duration, score, millimetres, percent = map(float, match.groups())
    # The oracles: distances and efforts of the whole motion on a grid of 1 ms.
    dense, model = interpolate(plan.trajectory), subject.collision
    assert model is not None
    near = model.near(dense.q, 1.0)
    boxes = [model.pairs[pair][1] == "box" for pair in near.pairs]
    assert millimetres == pytest.approx(1e3 * near.distances[boxes].min(), abs=2.0)
    tau = robot.inverse_dynamics(dense.q, dense.v, dense.a)
    assert percent == pytest.approx(100.0 * np.max(np.abs(tau) / robot.limits().effort), abs=1.0)
    assert duration == pytest.approx(plan.duration, abs=0.05)
    assert score == pytest.approx(plan.in_span_score, abs=0.05)


def test_a_budget_ends_planning_by_time_or_when_it_is_cancelled():
    subject = planner(naturalness=0.0, n_starts=5)
    free = subject.plan(*request(3))
    assert free.status == "solved"
    late = subject.plan(*request(3), budget=mp.Budget(1e-6))
    assert late.status == "stopped_early" and "time ran out" in late.message
    asked = []

    def is_cancelled():
        asked.append(time.perf_counter())
        return True

    stopped = subject.plan(*request(3), budget=mp.Budget(is_cancelled=is_cancelled))
    assert asked and stopped.iterations < free.iterations
    # Time is kept for a check as long as the longest so far, in any part of a budget.
    kept = mp.Budget(60.0)
    kept.part(0.5).whole.longest_check = 50.0
    assert not kept.is_late() and kept.is_late(ahead=20.0)
    with pytest.raises(mp.PlannerError, match="time for planning.*-1"):
        mp.Budget(-1.0)


def test_a_plan_survives_pickling_without_its_planner():
    plan = planner().plan(*request(3))
    content = pickle.dumps(plan)
    assert len(fields(plan)) <= 14 and len(content) < 30_000
    again = pickle.loads(content)
    assert again.summary() == plan.summary() and str(again) == str(plan)
    times = plan.trajectory.times
    np.testing.assert_array_equal(again.motion.evaluate(times), plan.motion.evaluate(times))
