# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots that move, and goals that come in any rhythm: a short campaign in virtual time.

`test/campaigns/moving_robot.py` runs a long one.
"""

from __future__ import annotations

import pytest

pytest.importorskip("example_robot_data", reason="example-robot-data is not installed")

from campaigns.moving_robot import LAGS, SAGS, campaign

SEED = 0


@pytest.mark.campaign
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_campaign_of_random_events_finds_no_problem(name):
    for result in campaign(name, n_events=30, seed=SEED):
        assert not result.problems, (name, result.run.seed, result.run.events)


def test_short_campaign_finds_no_problem():
    for result in campaign("panda", n_events=3, seed=SEED):
        assert not result.problems, (result.run.seed, result.run.events)


@pytest.mark.parametrize("sag", SAGS)
@pytest.mark.parametrize("lag", LAGS)
def test_goals_and_stops_of_a_robot_with_slow_servos_neither_jump_nor_are_refused(lag, sag):
    """Servos that lag and sag are no fault."""
    for result in campaign("ur5", n_events=10, seed=1, servos=(lag, sag)):
        assert not result.problems, (result.run.seed, result.run.events)
