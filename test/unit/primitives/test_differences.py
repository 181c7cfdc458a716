# Copyright 2026 mp_pca_planner developers
# SPDX-License-Identifier: Apache-2.0
"""Distances between motions, and errors of held-out motions."""

from dataclasses import replace

import numpy as np
import pytest
from support.arm import arm_demonstrations

from mp_pca_planner.primitives.build import PrimitiveOptions, build_primitive
from mp_pca_planner.primitives.differences import (
    FINE_PHASES,
    expected_motion,
    minimum_jerk_motion,
    path_difference,
)
from mp_pca_planner.primitives.timing import ALIGNMENTS


def bow(phases, height=0.3):
    """A bow in the plane, from (0, 0) to (1, 0)."""
    return np.column_stack([phases, height * np.sin(np.pi * phases)])


def test_timing_does_not_count():
    assert path_difference(bow(FINE_PHASES**1.5), bow(FINE_PHASES)) < 2e-3
    assert path_difference(bow(FINE_PHASES), bow(FINE_PHASES)) < 1e-12


def test_another_path_counts():
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


@pytest.mark.parametrize("method", ALIGNMENTS)
def test_noise_of_the_accelerations_at_the_ends_does_not_change_predictions(method):
    motions, noise = arm_demonstrations(), np.random.default_rng(3)
    options = PrimitiveOptions(n_components=5, align=method)
    before = build_primitive(motions[1:], "x", options).errors(motions[:1])
    noisy = []
    for motion in motions[1:]:
        accelerations = motion.accelerations.copy()
        accelerations[[0, -1]] += noise.normal(0.0, 5.0, (2, len(motion.joint_names)))
        noisy.append(replace(motion, accelerations=accelerations))
    after = build_primitive(noisy, "x", options).errors(motions[:1])
    np.testing.assert_allclose(after, before, rtol=1e-2)


def straight_error(motion):
    straight = minimum_jerk_motion(*motion.positions[[0, -1]])
    return path_difference(straight, motion.time_normalised(FINE_PHASES.size))


def test_the_expected_motion_goes_from_end_to_end():
    motions = arm_demonstrations()
    primitive = build_primitive(motions[1:], "others")
    found = expected_motion(primitive, *motions[0].positions[[0, -1]], motions[0].duration)
    np.testing.assert_allclose(found[[0, -1]], motions[0].positions[[0, -1]], atol=1e-9)
