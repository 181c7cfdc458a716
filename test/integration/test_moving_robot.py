# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Robots that move, and goals that come in any rhythm: a short campaign in virtual time.

`test/campaigns/moving_robot.py` runs a long one.
"""

from __future__ import annotations

import pytest

pytest.importorskip("example_robot_data", reason="example-robot-data is not installed")

from campaigns.moving_robot import campaign

SEED = 0


@pytest.mark.slow
@pytest.mark.parametrize("name", ["panda", "ur5"])
def test_campaign_of_random_events_finds_no_problem(name):
    for result in campaign(name, n_events=30, seed=SEED):
        assert not result.problems, (name, result.run.seed, result.run.events)


def test_short_campaign_finds_no_problem():
    for result in campaign("panda", n_events=3, seed=SEED):
        assert not result.problems, (result.run.seed, result.run.events)
