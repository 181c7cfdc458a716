# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Motions left out, and how near methods come to them."""

import numpy as np
import pytest
from calibration import calibration
from naturalness import relative_to_demonstrated
from support.arm import arm_demonstrations, arm_robot

from mp_pca_planner.evaluation.naturalness import (
    BSPLINES,
    EXPECTED,
    MINIMUM_JERK,
    QUANTITIES,
    Comparison,
    Prediction,
    compare,
    planned,
)
from mp_pca_planner.exceptions import PrimitiveError
from mp_pca_planner.primitives.build import PrimitiveOptions
from mp_pca_planner.primitives.differences import FINE_PHASES, leave_one_out, minimum_jerk_motion

MOTIONS = arm_demonstrations()[:9]


@pytest.fixture(scope="module")
def comparison():
    return compare(
        MOTIONS,
        robot=arm_robot(),
        tip="wrist",
        rhos=(0.0, 1e4),
        more={"oracle": lambda motion, _: Prediction(motion.time_normalised(FINE_PHASES.size))},
    )


def test_more_naturalness_costs_effort_and_comes_nearer_to_what_is_expected(comparison):
    rhos = (0.0, 1.0, 1e4)
    efforts = np.array([comparison.column(planned(rho), "effort") for rho in rhos])
    deviations = np.array([comparison.rms(planned(rho), "deviation") for rho in rhos])
    assert np.all(np.diff(efforts, axis=0) > -1e-3 * efforts[0])
    assert deviations[0] > deviations[1]
    np.testing.assert_allclose(
        comparison.column(planned(1e4), "path"), comparison.column(EXPECTED, "path"), atol=1e-3
    )


def test_bsplines_have_the_least_effort(comparison):
    least = comparison.column(BSPLINES, "effort")
    assert np.all(least <= comparison.column(planned(0.0), "effort") * 1.001)


def test_a_method_that_knows_the_motion_makes_no_errors(comparison):
    for quantity in ("time", "aligned", "path", "tip", "peak"):
        assert comparison.rms("oracle", quantity) < 1e-9
    assert comparison.rms("oracle", "deviation") > 0.0


def test_errors_are_those_of_leaving_one_out(comparison):
    errors = leave_one_out(MOTIONS, PrimitiveOptions())
    for i, quantity in enumerate(("time", "aligned", "path")):
        found = comparison.column(EXPECTED, quantity)
        np.testing.assert_allclose(found, errors.expected[:, i], rtol=1e-9)


def test_the_effort_of_positions_is_that_of_the_planner(comparison):
    # ρ → ∞ is the expected motion, whose effort is found from its positions alone.
    np.testing.assert_allclose(
        comparison.column(EXPECTED, "effort"), comparison.column(planned(1e4), "effort"), rtol=0.01
    )


def test_the_interval_shows_which_is_better(comparison):
    low, high = comparison.interval(BSPLINES, "path")
    assert 0.0 < low < high
    assert comparison.interval(comparison.reference, "path") == (0.0, 0.0)
    assert comparison.interval("oracle", "path")[1] < 0.0


def test_the_interval_of_many_motions_is_that_of_the_normal_approximation():
    rng = np.random.default_rng(3)
    ours = rng.uniform(1.0, 2.0, size=(400, 1)) * np.ones(len(QUANTITIES))
    other = ours + rng.normal(0.05, 0.3, size=(400, 1))
    found = Comparison(MOTIONS[:1] * 400, {"ours": ours, "other": other}, "ours")
    low, high = found.interval("other", "path")
    rms = [found.rms(name, "path") for name in ("other", "ours")]
    # The delta method: the error of a root of a mean of squares.
    gains = other[:, 0] ** 2 / (2 * rms[0]) - ours[:, 0] ** 2 / (2 * rms[1])
    error = 1.96 * gains.std() / np.sqrt(400)
    np.testing.assert_allclose([low, high], rms[0] - rms[1] + error * np.array([-1, 1]), rtol=0.1)


def test_motions_of_a_group_teach_nothing_of_it():
    groups = ["a"] * 4 + ["b"] * 5
    seen = []

    def spy(motion, others):
        seen.append({groups[MOTIONS.index(m)] for m in (motion, *others)})
        assert groups[MOTIONS.index(motion)] not in {groups[MOTIONS.index(m)] for m in others}
        return Prediction(minimum_jerk_motion(motion))

    found = compare(MOTIONS, groups, more={"spy": spy})
    assert len(seen) == len(MOTIONS)
    np.testing.assert_array_equal(found.results["spy"], found.results[MINIMUM_JERK])
    assert np.isnan(found.column(MINIMUM_JERK, "effort")).all()


def test_too_few_motions_are_refused():
    with pytest.raises(PrimitiveError, match="at least 3 motions of 2 groups, got 9 of 1"):
        compare(MOTIONS, ["a"] * 9)


def test_predicted_deviations_describe_the_errors_of_motions_left_out() -> None:
    few, more = calibration(
        arm_demonstrations(16), PrimitiveOptions(), sizes=(5, 12, 20), n_draws=6
    )
    assert (few.n_demonstrations, more.n_demonstrations) == (5, 12)
    for one in (few, more):
        assert one.within[0] < one.within[1] <= one.within[2]
        assert one.within[0] > 0.5 and one.within[1] > 0.85
        assert one.in_span > 0.9
        assert 0.3 < one.error_ratio < 1.5


def test_jerk_at_the_ends_is_relative_to_the_largest_demonstrated() -> None:
    comparison = compare(arm_demonstrations(8))
    straight = [
        60.0 * np.abs(motion.positions[-1] - motion.positions[0]).max() / motion.duration**3
        for motion in comparison.motions
    ]
    np.testing.assert_allclose(comparison.column(MINIMUM_JERK, "jerk"), straight, rtol=1e-2)
    assert 0.0 < relative_to_demonstrated(comparison, EXPECTED, "jerk") < 3.0
