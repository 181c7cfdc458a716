# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Servos that lag and sag are no fault: goals in motion and stops neither jump nor are refused."""

import pytest

pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")

from campaigns.moving_robot import GOOD_ENDS, LAGS, LARGEST_JUMP, SAGS, run_servos
from support.virtual_node import scene_and_model


@pytest.fixture(scope="module")
def ur5():
    return scene_and_model("ur5")


@pytest.mark.parametrize("sag", SAGS)
@pytest.mark.parametrize("lag", LAGS)
def test_goals_and_stops_of_a_robot_with_slow_servos_neither_jump_nor_are_refused(ur5, lag, sag):
    verdict, statuses, outcomes = run_servos(*ur5, lag, sag, n_events=12)
    assert verdict.largest_jump <= LARGEST_JUMP and not verdict.exceeded
    assert statuses.keys() <= {"served", "under_way", "overtaken"}
    assert outcomes.keys() <= {*GOOD_ENDS}
