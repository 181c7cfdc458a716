# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Servos that lag and sag are no fault: goals in motion and stops neither jump nor are refused."""

import pytest

pytest.importorskip("example_robot_data", reason="extra 'example' is not installed")

from campaigns.slow_servos import LAGS, LARGEST_JUMP, SAGS, Run
from support.virtual_node import scene_and_model


@pytest.fixture(scope="module")
def ur5():
    return scene_and_model("ur5")


@pytest.mark.parametrize("sag", SAGS)
@pytest.mark.parametrize("lag", LAGS)
def test_goals_and_stops_of_a_robot_with_slow_servos_neither_jump_nor_are_refused(ur5, lag, sag):
    run = Run(*ur5, lag, sag, n_events=12)
    assert run.largest_jump <= LARGEST_JUMP and not run.exceeded
    assert run.statuses.keys() <= {"served", "under_way", "overtaken"}
    assert run.outcomes.keys() <= {"arrived", "replaced", "stopped"}
