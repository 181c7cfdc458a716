# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots that move, and goals that come in any rhythm: a short campaign in virtual time.

`test/campaigns/moving_robot.py` runs a long one.
"""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("example_robot_data", reason="example-robot-data is not installed")

from campaigns.moving_robot import ARRIVED, campaign, scene_and_model
from support.served_arm import Node

SEED = 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_campaign_of_random_events_finds_no_problem(name):
    for result in campaign(name, n_events=30, seed=SEED):
        assert not result.problems, (name, result.run.seed, result.run.events)


def test_short_campaign_finds_no_problem():
    for result in campaign("panda", n_events=3, seed=SEED):
        assert not result.problems, (result.run.seed, result.run.events)


def time_to_arrive(rate: float, seconds: float) -> float:
    """When a robot that gets the same goal at a rate is commanded to stay there [s]."""
    scene, model = scene_and_model("panda")
    start, goal = scene.demonstrations[0].positions[0], scene.demonstrations[1].positions[-1]
    node = Node(model, start, seed=SEED, planning_time=(0.005, 0.05))
    began = node.now
    for _ in range(round(seconds * rate)):
        node.ask(goal, model.robot.joint_names)
        node.run(1.0 / rate)
    node.run(5.0)
    node.assert_smooth()
    assert len(node.plan_reports) == node.n_goals
    record = node.robot.record
    away = np.abs(record.q - goal).max(axis=1) > ARRIVED
    return float(record.times[np.flatnonzero(away)[-1] + 1] - began)


@pytest.mark.campaign
def test_same_goal_again_and_again_arrives_as_soon_as_a_single_one():
    single = time_to_arrive(0.2, 5.0)
    for rate in (1.0, 5.0, 20.0, 50.0):
        assert time_to_arrive(rate, 3.0) <= 1.1 * single
