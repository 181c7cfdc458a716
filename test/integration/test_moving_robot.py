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

from campaigns.moving_robot import ARRIVED, campaign, scene_and_model
from support.served_arm import Node

RATES = (1.0, 5.0, 20.0, 50.0)
DRIFT = 0.1  # [rad/s]
SEED = 0


class Panda(Node):
    """A panda at the start of a demonstration, and its node."""

    def __init__(self, seed=0, *, stamp_trajectories=True):
        scene, model = scene_and_model("panda")
        settings = replace(model.settings, stamp_trajectories=stamp_trajectories)
        self.ends = np.array([m.positions[[0, -1]] for m in scene.demonstrations]).reshape(-1, 7)
        model = replace(model, settings=settings)
        super().__init__(model, self.ends[0], seed=seed, planning_time=(0.005, 0.05))

    def ask(self, positions):
        super().ask(positions, self.model.robot.joint_names)

    def time_at(self, goal, since):
        """When the robot is commanded to stay at the goal, since a time [s]."""
        record = self.robot.record
        away = np.abs(record.q - goal).max(axis=1) > ARRIVED
        return float(record.times[np.flatnonzero(away)[-1] + 1] - since)

    def assert_clean(self):
        """No limit is exceeded, nothing jumps, and every goal and motion has one report."""
        self.assert_smooth()
        names = [report.name for report in self.plan_reports]
        assert sorted(names) == list(range(1, self.n_goals + 1))
        served = [r.name for r in self.plan_reports if r.status == "served"]
        assert sorted(r.goal for _, r in self.execution_reports) == served


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
    node = Panda()
    began = node.now
    node.ask(node.ends[3])
    node.run(8.0)
    return node.time_at(node.ends[3], began)


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.campaign
def test_same_goal_again_and_again_arrives_as_soon_as_a_single_one(rate):
    node = Panda()
    began, goal = node.now, node.ends[3]
    for _ in range(round(3.0 * rate)):
        node.ask(goal)
        node.run(1.0 / rate)
    node.run(3.0)
    assert node.time_at(goal, began) <= 1.1 * time_of_a_single_goal()
    node.assert_clean()


@pytest.mark.parametrize("rate", RATES)
@pytest.mark.campaign
def test_drifting_goal_is_followed_and_met(rate):
    node = Panda()
    node.ask(node.ends[3])
    node.run(6.0)
    displacement = node.ends[4] - node.ends[3]
    displacement *= DRIFT / np.abs(displacement).max()
    for k in range(1, min(round(4.0 * rate), 12)):
        goal = node.ends[3] + displacement * k / rate
        node.ask(goal)
        node.run(1.0 / rate)
        assert rate < 20.0 or np.abs(node.robot.record.q[-1] - goal).max() < 0.1
    node.run(8.0)
    node.assert_rests_at(goal, 1e-4)
    node.assert_clean()
