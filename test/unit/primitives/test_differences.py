# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances between motions, and errors of held-out motions."""

import numpy as np
import pytest
from support.arm import arm_demonstrations

from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import (
    FINE_PHASES,
    minimum_jerk_motion,
    path_difference,
)
from mp_pca_planner.primitives.timing import ALIGNMENTS


def bow(phases, height=0.3):
    """A bow in the plane, from (0, 0) to (1, 0)."""
    return np.column_stack([phases, height * np.sin(np.pi * phases)])


def test_the_path_counts_and_not_its_timing():
    assert path_difference(bow(FINE_PHASES**1.5), bow(FINE_PHASES)) < 2e-3
    found = path_difference(bow(FINE_PHASES, 0.5), bow(FINE_PHASES, 0.3))
    # At the same phases only the height differs, by 0.2 sin: RMS over two joints 0.1.
    assert 0.05 < found <= 0.101


@pytest.mark.parametrize("method", ALIGNMENTS)
def test_left_out_motions_are_nearer_to_their_predictions_than_to_straight_ones(method):
    """The stated errors of left-out motions are those of primitives of the others."""
    motions, options = arm_demonstrations(), PrimitiveOptions(n_components=5, align=method)
    errors = []
    for i, motion in enumerate(motions):
        others = build_primitive([*motions[:i], *motions[i + 1 :]], "others", options)
        errors.append((float(others.errors([motion])[0]), straight_error(motion)))
    predicted, straight = np.sqrt(np.mean(np.square(errors), axis=0))
    assert predicted < 0.9 * straight
    if method == "linear":  # then the stated errors are those at equal shares of the time
        return
    facts = build_primitive(motions, "all", options).summary()
    assert facts["left_out_error"] == pytest.approx(predicted, rel=0.3)
    assert facts["minimum_jerk_error"] == pytest.approx(straight, rel=0.3)


def straight_error(motion):
    straight = minimum_jerk_motion(*motion.positions[[0, -1]])
    return path_difference(straight, motion.time_normalised(FINE_PHASES.size))
