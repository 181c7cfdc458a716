# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Servos that lag and sag are no fault: goals in motion and stops neither jump nor are refused."""

import pytest

pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")

from campaigns.moving_robot import LAGS, SAGS, campaign


@pytest.mark.parametrize("sag", SAGS)
@pytest.mark.parametrize("lag", LAGS)
def test_goals_and_stops_of_a_robot_with_slow_servos_neither_jump_nor_are_refused(lag, sag):
    for result in campaign("ur5", n_events=10, seed=1, servos=(lag, sag)):
        assert not result.problems, (result.run.seed, result.run.events)
