# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Counts and times of goals."""

import pytest

from mp_pca_planner.execution.server import GoalStatistics
from mp_pca_planner.motion.goal import JointGoal, SequenceGoal


def test_fast_goals_do_not_make_slow_ones_seem_fast() -> None:
    statistics = GoalStatistics()
    assert statistics.expected_latency(JointGoal) > 0.0
    assert statistics.solve_time_percentiles() == {}
    statistics.served(SequenceGoal, 1.0, 1.0)
    for _ in range(200):
        statistics.served(JointGoal, 0.01, 0.01)
    assert statistics.expected_latency(SequenceGoal) >= 1.0
    assert statistics.expected_latency(JointGoal) < 0.1


def test_percentiles_are_those_of_the_solve_times() -> None:
    statistics = GoalStatistics()
    for k in range(101):
        statistics.served(JointGoal, k / 100, k / 50)
    assert statistics.solve_time_percentiles() == {
        "solve_time_p50_s": pytest.approx(0.5),
        "solve_time_p90_s": pytest.approx(0.9),
        "solve_time_p99_s": pytest.approx(0.99),
    }
