# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Errors of held-out motions."""

import numpy as np
import pytest
from arm import arm_demonstrations

from mp_pca_planner.primitives.alignment import ALIGNMENTS
from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.cross_validation import expected_motion, leave_one_out


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
    found = expected_motion(primitive, motions[0])
    np.testing.assert_allclose(found[[0, -1]], motions[0].positions[[0, -1]], atol=1e-9)
