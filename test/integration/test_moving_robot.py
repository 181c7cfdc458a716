# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots that move, and goals that come in any rhythm: a short campaign in virtual time.

`test/campaigns/moving_robot.py` runs a long one.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip("example_robot_data", reason="example-robot-data is not installed")

from campaigns.moving_robot import ARRIVED, FINEST, campaign, scene_and_model
from support.referee import judge
from support.virtual_node import VirtualNode

from mp_pca_planner.motion.goal import JointGoal, JointState

RATES = (1.0, 5.0, 20.0, 50.0)
DRIFT = 0.1  # [rad/s]
SEED = 0


def n_goals(rate):
    """For some seconds, and no more than a test has time for."""
    return min(round(4.0 * rate), 12)


@cache
def panda():
    return scene_and_model("panda")


class Robot:
    """A panda at the start of a demonstration, and its node."""

    def __init__(self, seed=0, *, stamp_trajectories=True, **options):
        scene, model = panda()
        settings = replace(model.settings, stamp_trajectories=stamp_trajectories)
        self.model = replace(model, settings=settings)
        self.ends = np.array([m.positions[[0, -1]] for m in scene.demonstrations]).reshape(-1, 7)
        self.node = VirtualNode(self.model, self.ends[0], seed=seed, **options)
        self.faults = self.node.robot.faults
        self.n_goals = 0
        self.run(0.3)

    def send(self, positions, joints=None):
        self.n_goals += 1
        names = self.model.robot.joint_names[:joints]
        self.node.goal(JointGoal(JointState(names, positions)), self.n_goals)

    def run(self, duration):
        self.node.run(duration)

    @property
    def record(self):
        return self.node.robot.record

    def time_at(self, goal, since):
        """When the robot is commanded to stay at the goal, since a time [s]."""
        away = np.abs(self.record.q - goal).max(axis=1) > ARRIVED
        return float(self.record.times[np.flatnonzero(away)[-1] + 1] - since)

    def verdict(self):
        limits, record = self.model.limits, self.record
        names = ("lower", "upper", "velocity", "acceleration", "jerk")
        bounds = {name: getattr(limits, name) for name in names}
        taken = [tick for tick, _ in self.node.robot.taken]
        return judge(
            record.q,
            record.clock,
            bounds,
            time=record.times,
            cuts=record.cuts,
            joins=[tick for tick in taken if record.scaling[tick] < 1.0],
            finest=FINEST,
        )

    def assert_clean(self):
        """No limit is exceeded, nothing jumps, and every goal and motion has one report."""
        verdict = self.verdict()
        assert verdict.is_clean, verdict
        names = [report.name for report in self.node.plan_reports]
        assert sorted(names) == list(range(1, self.n_goals + 1))
        served = [r.name for r in self.node.plan_reports if r.status == "served"]
        assert sorted(r.goal for _, r in self.node.execution_reports) == served

    def assert_rests_at(self, goal):
        np.testing.assert_allclose(self.record.q[-1], goal, atol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_campaign_of_random_events_finds_no_problem(name):
    for result in campaign(name, n_events=30, seed=SEED):
        assert not result.problems, (name, result.run.seed, result.run.events)


def test_short_campaign_finds_no_problem():
    for result in campaign("panda", n_events=3, seed=SEED):
        assert not result.problems, (result.run.seed, result.run.events)


@cache
def time_of_a_single_goal():
    robot = Robot()
    began = robot.node.now
    robot.send(robot.ends[3])
    robot.run(8.0)
    return robot.time_at(robot.ends[3], began)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.campaign
def test_same_goal_again_and_again_arrives_as_soon_as_a_single_one(rate):
    robot = Robot()
    began, goal = robot.node.now, robot.ends[3]
    for _ in range(round(3.0 * rate)):
        robot.send(goal)
        robot.run(1.0 / rate)
    robot.run(3.0)
    assert robot.time_at(goal, began) <= 1.1 * time_of_a_single_goal()
    robot.assert_clean()


def drift(rate):
    """Follow a goal that drifts; the robot, the last goal, and its distance after each goal."""
    robot = Robot()
    robot.send(robot.ends[3])
    robot.run(6.0)
    displacement = robot.ends[4] - robot.ends[3]
    displacement *= DRIFT / np.abs(displacement).max()
    away = []
    for k in range(1, n_goals(rate)):
        goal = robot.ends[3] + displacement * k / rate
        robot.send(goal)
        robot.run(1.0 / rate)
        away.append(np.abs(robot.record.q[-1] - goal).max())
    return robot, goal, np.array(away)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.campaign
def test_drifting_goal_is_met(rate):
    robot, goal, _ = drift(rate)
    robot.run(8.0)
    robot.assert_rests_at(goal)
    robot.assert_clean()


@pytest.mark.parametrize("rate", [5.0, 20.0, 50.0])
@pytest.mark.campaign
def test_drifting_goal_is_followed(rate):
    _, _, away = drift(rate)
    assert away.max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("rate", RATES)
def test_alternating_goals_end_at_the_last_one(rate):
    robot = Robot()
    for k in range(n_goals(rate)):
        robot.send(robot.ends[3 + k % 2])
        robot.run(1.0 / rate)
    robot.run(8.0)
    robot.assert_rests_at(robot.ends[3 + k % 2])
    robot.assert_clean()


@pytest.mark.slow
def test_sag_of_a_payload_is_not_learned_anew_with_every_goal():
    robot = Robot()
    rest = robot.ends[3]
    robot.send(rest)
    robot.run(8.0)
    robot.faults.payload = 3.0
    robot.run(1.0)
    sag = np.abs(robot.node.robot.measured_state()[0] - rest).max()
    assert sag > 1e-3
    for k in range(12):
        robot.send([rest[0] + 0.2 * (-1) ** k], joints=1)
        robot.run(3.0)
    np.testing.assert_array_equal(robot.record.q[-1, 1:], rest[1:])
    robot.assert_clean()


@pytest.mark.slow
@pytest.mark.parametrize("scaling", [0.1, 0.5, 1.0])
def test_goals_in_motion_are_served_without_a_jump_at_any_speed(scaling):
    robot = Robot()
    robot.faults.speed_scaling = scaling
    robot.run(1.0)
    for k in range(4):
        robot.send(robot.ends[3 + k % 2])
        robot.run(0.5 + 0.3 / scaling)
    robot.run(6.0 / scaling)
    assert [r.status for r in robot.node.plan_reports] == ["served"] * 4
    assert robot.verdict().largest_jump <= 2e-4
    robot.assert_rests_at(robot.ends[4])
    robot.assert_clean()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("delay", "may_stamp"), [(0.1, True), (0.3, True), (0.1, False), (0.4, False), (0.8, False)]
)
def test_motion_from_rest_that_starts_late_is_not_said_to_have_never_started(delay, may_stamp):
    robot = Robot(stamp_trajectories=may_stamp)
    for k in range(3):
        robot.faults.delay = delay
        robot.send(robot.ends[3 + k])
        robot.run(1.0)
        robot.faults.delay = 0.0
        robot.run(6.0)
        robot.assert_rests_at(robot.ends[3 + k])
    assert [report.outcome for _, report in robot.node.execution_reports] == ["arrived"] * 3


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_drifting_goal_is_met_by_a_robot_whose_node_or_states_stall(seed):
    random = np.random.default_rng(seed)
    robot = Robot(seed)
    robot.node.has_velocities, robot.node.is_split = False, seed % 2 == 1
    robot.send(robot.ends[3])
    robot.run(6.0)
    displacement = robot.ends[4] - robot.ends[3]
    displacement *= DRIFT / np.abs(displacement).max()
    for k in range(1, 12):
        if k % 4 == 0:
            robot.node.stall(random.uniform(0.3, 1.0), of_states=bool(random.random() < 0.5))
        goal = robot.ends[3] + displacement * k / 5.0
        robot.send(goal)
        robot.run(0.2)
    robot.run(8.0)
    robot.assert_rests_at(goal)
    robot.assert_clean()
