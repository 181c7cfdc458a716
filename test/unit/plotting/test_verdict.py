# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""The verdict of the report: planted weaknesses are found, and nothing is claimed without."""

import numpy as np
import pytest
from support.arm import arm_primitive, arm_robot

from mp_pca_planner.plotting.arm import arm_figure
from mp_pca_planner.plotting.report import goals_in_span, verdict_on
from mp_pca_planner.plotting.style import styled_figure
from mp_pca_planner.primitives.differences import HeldOutErrors

N = len(arm_primitive().durations)
GOALS = arm_primitive().boundary_states[:, 3]


def errors(expected: np.ndarray, straight: float = 0.1) -> HeldOutErrors:
    """Errors of all motions, the same in all measures."""
    rows = [np.full(N, straight), np.full(N, straight), expected]
    return HeldOutErrors(*(np.repeat(row[:, None], 3, axis=1) for row in rows))


def test_region_of_weak_goals_is_named_with_its_counts() -> None:
    cut = float(np.quantile(GOALS[:, 1], 0.8))
    is_weak = GOALS[:, 1] > cut
    _, weak, is_found = verdict_on(
        arm_primitive(), errors(np.where(is_weak, 0.05, 0.01)), range(N), arm_robot()
    )
    np.testing.assert_array_equal(is_found, is_weak)
    (sentence,) = (text for text in weak if "off by over" in text)
    n = int(is_weak.sum())
    assert sentence.startswith("goals with shoulder2 above ")
    edges = np.rad2deg([GOALS[~is_weak, 1].max(), GOALS[is_weak, 1].min()])
    assert edges[0] - 1 <= float(sentence.split()[4]) <= edges[1] + 1
    assert f"{n} of {n} motions there" in sentence and f"0 of {N - n} elsewhere" in sentence
    assert "1.15 deg (twice the median)" in sentence  # 0.02 rad


def test_weak_goals_without_a_region_are_counted() -> None:
    # Alternate motions along every feature: no half-space separates them.
    order = np.argsort(GOALS[:, 0])
    expected = np.full(N, 0.01)
    expected[order[[0, N // 2, N - 1]]] = 0.05
    _, weak, _ = verdict_on(arm_primitive(), errors(expected), range(N))
    assert any(f"3 of {N} motions" in text for text in weak)


def test_ranges_are_those_of_the_goals_that_are_predicted_well() -> None:
    expected = np.full(N, 0.01)
    expected[GOALS[:, 0].argmin()] = 0.05
    good, _, _ = verdict_on(arm_primitive(), errors(expected), range(N))
    low, high = np.rad2deg([np.sort(GOALS[:, 0])[1], GOALS[:, 0].max()])
    assert f"shoulder1 {low:.0f} to {high:.0f} deg" in good[-1]


def test_prediction_no_better_than_minimum_jerk_is_no_good() -> None:
    few, worse, _ = verdict_on(arm_primitive(), errors(np.full(N, 0.2)), range(N))
    better, _, _ = verdict_on(arm_primitive(), errors(np.full(N, 0.05)), range(N))
    assert any("no nearer than by minimum-jerk" in text for text in worse)
    assert "50% nearer than by minimum-jerk" in better[0]
    assert len(few) == len(better) - 1


def test_nothing_is_said_of_errors_that_are_unknown() -> None:
    good, weak, is_weak = verdict_on(arm_primitive(), None, [])
    assert not is_weak.any()
    assert not any("left-out" in text for text in [*good, *weak])


def test_goals_in_span_are_as_near_as_the_demonstrations() -> None:
    primitive = arm_primitive()
    ends = primitive.boundary_states[:, [0, 3]]
    goals = goals_in_span(primitive)
    assert len(goals) > 500
    # By the covariance of the goals alone: the squared distance can only be less than with starts,
    # which is at most the largest of the demonstrations.
    own = ends.reshape(N, -1)
    covariance = np.linalg.inv(primitive.model.request_precision)

    def squared(x: np.ndarray, of: np.ndarray, entries: slice) -> np.ndarray:
        away = x - of.mean(axis=0)
        return np.sum(away * np.linalg.solve(covariance[entries, entries], away.T).T, axis=1)

    largest = squared(own, own, slice(8)).max() * (1 + 1e-6)
    assert squared(goals, ends[:, 1], slice(4, 8)).max() <= largest
    # They reach beyond the demonstrated goals.
    assert np.any(goals.min(axis=0) < ends[:, 1].min(axis=0))


def test_figure_of_goals_shows_every_one_in_both_views() -> None:
    pytest.importorskip("matplotlib", reason="matplotlib is not installed")
    rng = np.random.default_rng(0)
    goals = {name: rng.normal(size=(n, 3)) for name, n in (("a", 30), ("b", 7), ("c", 0))}
    chain = arm_robot().chain_positions(GOALS[:5], "wrist")
    with styled_figure() as figure:
        arm_figure(figure, {"": chain}, "", "wrist", goals)
        figure.draw_without_rendering()
    box = figure.legends[0].get_window_extent()
    assert box.x0 >= 0.0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1
    for axes, horizontal in zip(figure.axes, (1, 0), strict=True):
        assert axes.get_aspect() == 1.0
        for line, places in zip(axes.lines, goals.values(), strict=False):
            np.testing.assert_array_equal(line.get_xdata(), places[:, horizontal])
            np.testing.assert_array_equal(line.get_ydata(), places[:, 2])
