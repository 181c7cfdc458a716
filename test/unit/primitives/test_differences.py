# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances between motions, and errors of held-out motions."""

import numpy as np
import pytest
from support.arm import arm_demonstrations

from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import (
    FINE_PHASES,
    differences,
    expected_motion,
    leave_one_out,
)
from mp_pca_planner.primitives.timing import ALIGNMENTS


def bow(phases, height=0.3):
    """A bow in the plane, from (0, 0) to (1, 0)."""
    return np.column_stack([phases, height * np.sin(np.pi * phases)])


def test_timing_counts_in_time_alone():
    in_time, aligned, in_path = differences(bow(FINE_PHASES**1.5), bow(FINE_PHASES))
    assert in_time > 0.05
    assert aligned < 2e-3
    assert in_path < 2e-3


def test_another_way_counts_in_all():
    found = differences(bow(FINE_PHASES, 0.5), bow(FINE_PHASES, 0.3))
    # At the same phases only the height differs, by 0.2 sin: RMS over two joints 0.1.
    assert found[0] == pytest.approx(0.1, rel=0.01)
    assert np.all((found[1:] > 0.05) & (found[1:] <= 0.101))


def test_nothing_is_nearer_than_the_best_alignment():
    rng = np.random.default_rng(3)
    for _ in range(5):
        a, b = (bow(FINE_PHASES ** rng.uniform(0.6, 1.6), rng.uniform(0, 0.5)) for _ in range(2))
        in_time, aligned, _ = differences(a, b)
        assert aligned <= in_time + 1e-12


def test_a_motion_does_not_differ_from_itself():
    np.testing.assert_allclose(differences(bow(FINE_PHASES), bow(FINE_PHASES)), 0.0, atol=1e-12)


@pytest.mark.parametrize("method", ALIGNMENTS)
def test_more_knowledge_means_smaller_errors(method):
    options = PrimitiveOptions(n_components=5, align=method)
    minimum_jerk, mean_shape, expected = leave_one_out(arm_demonstrations(), options).rms()
    assert np.all(expected < 0.9 * minimum_jerk)
    assert np.all(expected[1:] < mean_shape[1:])


def test_motions_to_leave_out_can_be_chosen():
    motions = arm_demonstrations()[:8]
    options = PrimitiveOptions(n_components=2)
    all_errors = leave_one_out(motions, options)
    chosen = leave_one_out(motions, options, left_out=[4, 1])
    for prediction in ("minimum_jerk", "mean_shape", "expected"):
        np.testing.assert_array_equal(
            getattr(chosen, prediction), getattr(all_errors, prediction)[[4, 1]]
        )


def test_the_expected_motion_goes_from_end_to_end():
    motions = arm_demonstrations()
    primitive = build_primitive(motions[1:], "others")
    found = expected_motion(primitive, *motions[0].positions[[0, -1]], motions[0].duration)
    np.testing.assert_allclose(found[[0, -1]], motions[0].positions[[0, -1]], atol=1e-9)
